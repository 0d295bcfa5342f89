"""The fit of all edges as the answer, where a selection loses most of the loops.

A selection predicts loops by odometry to first order. Where the deviations of turns add up to a radian and
more, no prediction holds, and true loops look false. Where all deviations are stated too small by one factor,
all loops disagree with odometry. In both cases one explanation needs no false loop at all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from backend.pose_graph.chi_square import SIGNIFICANCE
from backend.pose_graph.elimination import elimination_exceeds
from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, GraphFit, damped_fit, initial_poses
from backend.pose_graph.marginals import posterior
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.own_noise import are_selective
from backend.pose_graph.selection.swap_search import removal_gains
from backend.quantiles import f_limit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_CHEAP = 1e8
"""Floating-point operations of an elimination: a descent of a hundred of them takes seconds."""


def loses_most_loops(problem: Problem, kept: Mask) -> bool:
    """Return whether fewer than half of the loops are kept (m,)."""
    loops = ~problem.trusted
    return bool(2 * np.count_nonzero(kept & loops) < np.count_nonzero(loops))


def lowest_fit(gauge_fixed: GaugeFixedProblem, fit: GraphFit, *starts: Array) -> GraphFit:
    """Return the lowest of the fit of all edges and of damped descents from other starts (n, 4, 4).

    Large graphs keep the first fit: a descent among false loops takes many steps.
    """
    problem = gauge_fixed.problem
    if fit.test.passed or elimination_exceeds(_CHEAP, problem.count, problem.i, problem.j, problem.dof):
        return fit
    for start in (*starts, initial_poses(problem)):
        if gauge_fixed.options.out_of_time():
            break
        try:
            other = damped_fit(gauge_fixed, start)
        except BackendError:
            continue
        fit = min(fit, other, key=lambda each: each.minimum.error)
        if fit.test.passed:
            break
    return fit


def one_factor_explains(gauge_fixed: GaugeFixedProblem, fit: GraphFit, maps: Sequence[Array]) -> bool:
    """Return whether a fit of all edges is one of true edges whose deviations are off by one factor.

    No edge may stand out from the noise that the others show without it (F test). A false loop that no other
    one checks, and a wrong step under all loops, spread over all edges of their cycles: each of these stands
    out, or leaves nothing that shows the noise. Deviations times that factor have to tell a false loop from a
    true one in all ``maps`` of poses (n, 4, 4), unless the stated ones do so in none: false loops may have
    pulled a map together or apart, and a loop tells less in a smaller one.
    """
    test, problem = fit.test, gauge_fixed.problem
    if test.passed:
        return True
    rest = test.dof - problem.dof
    graph = gauge_fixed.graph(np.ones(len(problem.i), dtype=bool))
    predictions = posterior(graph, fit.minimum.values, (), gauge_fixed.edges).predictions
    if rest <= 0 or not np.isfinite(predictions).all():
        return False
    gain = float(removal_gains(problem.residuals(fit.w_T), predictions).max())
    # Compared without a quotient: where nothing else shows noise, it would be infinite.
    of_others = max((test.statistic - gain) / rest, 0.0)
    if gain / problem.dof > f_limit(SIGNIFICANCE / len(problem.i), problem.dof, rest) * of_others:
        return False
    scaled = problem.with_noise(float(np.sqrt(test.statistic / test.dof)))
    return all(are_selective(scaled, w_T) for w_T in maps) or not are_selective_in_any(problem, maps)


def are_selective_in_any(problem: Problem, maps: Sequence[Array]) -> bool:
    """Return whether the stated deviations tell a false loop from a true one in one of the maps."""
    return any(are_selective(problem, w_T) for w_T in maps)
