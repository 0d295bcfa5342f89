"""Connected parts of a solved graph, each as a problem of its own."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, Options
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.prediction import sample_posterior
from backend.pose_graph.solution import Solution
from backend.pose_graph.unary_factors import fixed

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def solved_parts(problem: Problem, solution: Solution, edges: Mask) -> Iterator[tuple[Problem, Array, Mask]]:
    """Yield each connected part as a problem of its own, its poses, and which ``edges`` (m,) it has."""
    for number in range(int(solution.component.max(initial=-1)) + 1):
        members = np.flatnonzero(solution.component == number)
        inside = edges & (solution.component[problem.i] == number)
        yield problem.with_edges(inside).restricted(members), solution.w_T_b[members], inside


def gauge_fixed_part(part: Problem, w_T: Array, deadline: float = math.inf) -> GaugeFixedProblem:
    """Fix the gauge of a part: its first pose is fixed where no unary factor places it.

    ``deadline`` on the clock of ``time.monotonic`` ends its fits.
    """
    priors = part.unary_factor_graph()
    if not part.unary_factors:
        priors.push_back(fixed(0, w_T[0], part.dimension).factor)
    return GaugeFixedProblem(part, priors, Options(deadline=deadline))


def posterior_samples(part: Problem, kept: Mask, w_T: Array) -> Array | None:
    """Draw (n, d, s) samples of a part's poses by its ``kept`` edges (m,); None if the system is singular."""
    return sample_posterior(gauge_fixed_part(part, w_T).graph(kept), part.values(w_T), part.dof)
