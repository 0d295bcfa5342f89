"""Redundancy of a solved pose graph: cycles of accepted edges, and the size of their residuals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from backend.gauge import format_keys
from backend.pose_graph.problem import Problem
from backend.pose_graph.solution import Solution

_SIGNIFICANCE = 1e-3
_FAR_BELOW = 0.1
"""Ratio of a chi-square to its degrees of freedom below which the stated covariances are questioned."""


def unchecked_components(problem: Problem, solution: Solution) -> list[str]:
    """Return a sentence for each connected component whose accepted edges form a tree.

    A tree fits its edges exactly, whether they are right or wrong. Parallel edges count once: they check each
    other, and nothing else. Two fixed vertices also check the edges between them.
    """
    i, j = np.minimum(problem.i, problem.j), np.maximum(problem.i, problem.j)
    component = solution.component
    fixed = np.bincount(
        [component[a.k] for a in problem.unary_factors if component[a.k] >= 0], minlength=len(component) + 1
    )
    sentences = []
    for number in range(int(component.max(initial=-1)) + 1):
        members = np.flatnonzero(component == number)
        inside = component[problem.i] == number
        kept = inside & solution.edge_kept
        pairs = len(np.unique(np.column_stack([i[kept], j[kept]]), axis=0))
        if len(members) < 2 or pairs >= len(members) or fixed[number] > 1:
            continue
        sentences.append(_sentence(problem, members.tolist(), int((inside & ~kept).sum()), kept))
    return sentences


def _sentence(problem: Problem, members: list[int], rejected: int, kept: NDArray[np.bool_]) -> str:
    who = format_keys(members, problem.name)
    base = "odometry alone" if problem.trusted[kept].all() else "a tree of edges alone"
    why = f": {rejected} edges were rejected, and" if rejected else ", and"
    return f"{who} rest on {base}{why} no loop is left that checks it"


def small_residuals_warning(problem: Problem, solution: Solution) -> list[str]:
    """Return one warning if the chi-square is far below its degrees of freedom; else an empty list."""
    kept = solution.edge_kept
    placed = int((solution.component >= 0).sum()) - (int(solution.component.max(initial=-1)) + 1)
    dof = problem.dof * (int(kept.sum()) - placed)
    if dof <= 0:
        return []
    statistic = float((solution.edge_residual[kept] ** 2).sum())
    if statistic >= min(_FAR_BELOW * dof, float(chi2.ppf(_SIGNIFICANCE, dof))):
        return []
    return [
        f"the edges agree far better than their covariances state (chi-square {statistic:.3g} for {dof}"
        " degrees of freedom): the covariances are too large, and so are the standard deviations given here,"
        " or the edges were computed from each other"
    ]
