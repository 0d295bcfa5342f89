"""Connected parts of a solved graph, each as a problem of its own."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.problem import Problem
from backend.pose_graph.solution import Solution

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def solved_parts(problem: Problem, solution: Solution, edges: Mask) -> Iterator[tuple[Problem, Array, Mask]]:
    """Yield each connected part as a problem of its own, its poses, and which ``edges`` (m,) it has."""
    for number in range(int(solution.component.max(initial=-1)) + 1):
        members = np.flatnonzero(solution.component == number)
        inside = edges & (solution.component[problem.i] == number)
        yield problem.with_edges(inside).restricted(members), solution.w_T_b[members], inside
