"""Second maps of a graph: rejected loops that agree with each other, and odometry bent until it fits them.

Over many steps odometry allows what no single step of it does. If odometry and a group of rejected loops pass
their chi-square test together, the graph has two maps, and the loops of one of them are false. How many loops
either has then tells little, because those of one common cause are false together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.errors import BackendError
from backend.pose_graph.checks.improbability import Improbability, MovedRivals
from backend.pose_graph.checks.solved_parts import gauge_fixed_part
from backend.pose_graph.chi_square import ChiSquare, chi_square
from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, GraphFit, least_squares_fit
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.chains import connected
from backend.pose_graph.selection.prediction import innovations, noise_scale, sample_posterior
from backend.pose_graph.selection.rival_loops import LEAST_LOG_ODDS

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_MOST_MAPS = 3
"""Groups that are solved with the odometry, those of most loops first: each takes three solves."""


def rival_maps(
    improbability: Improbability, groups: Sequence[MovedRivals], deadline: float = math.inf
) -> list[MovedRivals]:
    """Return the rejected and the kept loops of the maps that groups of at least two rejected loops make.

    The groups are those of `rival_groups`. Only those are solved whose loops alone are no clear minority, and
    none after the ``deadline`` on the clock of ``time.monotonic``.
    """
    loops = ~improbability.problem.trusted
    sides = [(each.rejected[loops[each.rejected]], each.kept[loops[each.kept]]) for each in groups]
    likely = [
        group
        for group, against in sides
        if len(group) > 1 and improbability.log_odds_of_loops(against, group) < LEAST_LOG_ODDS
    ]
    gauge_fixed = gauge_fixed_part(improbability.problem, improbability.w_T, deadline)
    found: list[MovedRivals] = []
    for group in sorted(likely, key=len, reverse=True)[:_MOST_MAPS]:
        if gauge_fixed.options.out_of_time():
            break
        rivals = _rivals(gauge_fixed, improbability, group)
        found += [] if rivals is None else [rivals]
    return found


def _rivals(gauge_fixed: GaugeFixedProblem, improbability: Improbability, group: Index) -> MovedRivals | None:
    """Return what the map of odometry and a group of loops contradicts; None if there is no such map."""
    problem, loops = improbability.problem, ~improbability.problem.trusted
    try:
        found = _second_map(gauge_fixed, improbability, group)
    except BackendError:
        return None
    if found is None:
        return None
    kept, fit = found
    first_kept, first_w_T = improbability.kept, improbability.w_T
    gained, lost = (np.flatnonzero(each & loops) for each in (kept & ~first_kept, first_kept & ~kept))
    if len(lost) == 0:
        return None
    statistic = float((problem.residuals(first_w_T)[first_kept] ** 2).sum())
    first_test = chi_square(problem.with_edges(first_kept), statistic)
    scale = min(noise_scale(problem, first_kept, first_w_T), 1.0)
    strain = (_excess(fit.test) - _excess(first_test)) / 2 / scale**2
    log_odds = improbability.log_odds_of_loops(lost, gained) + strain
    return MovedRivals(gained, lost, log_odds, *_apart(first_w_T, fit.w_T, np.union1d(gained, lost), problem))


def _excess(test: ChiSquare) -> float:
    """Return by how much a chi-square exceeds what noise alone makes of it on average."""
    return test.statistic - test.dof


def _second_map(
    gauge_fixed: GaugeFixedProblem, improbability: Improbability, group: Index
) -> tuple[Mask, GraphFit] | None:
    """Return the edges (m,) that agree with odometry and a group, and their fit; None if these disagree."""
    problem, loops = improbability.problem, ~improbability.problem.trusted
    kept = improbability.kept & ~loops
    kept[group] = True
    kept = connected(problem, kept, improbability.kept, improbability.w_T)
    fit = least_squares_fit(gauge_fixed, kept, improbability.w_T)
    if not fit.test.passed:
        return None
    samples = sample_posterior(gauge_fixed.graph(kept), fit.minimum.values, problem.dof)
    if samples is None:
        return None
    others = np.flatnonzero(loops & ~kept)
    agreeing = innovations(problem, fit.w_T, samples, others, noise_scale(problem, kept, fit.w_T)).agrees()
    more = kept.copy()
    more[others[agreeing]] = True
    wider = least_squares_fit(gauge_fixed, more, fit.w_T)
    # What agrees with the group one by one may contradict it together.
    return (more, wider) if wider.test.passed else (kept, fit)


def _apart(w_T: Array, other: Array, loops: Index, problem: Problem) -> tuple[float, float]:
    """Return root mean squares of distance and angle (degrees) between two maps at later ends of loops."""
    ends = np.unique(np.maximum(problem.i, problem.j)[loops])
    apart = se3.inverse(w_T[ends]) @ other[ends]
    angle = np.linalg.norm(se3.log(apart)[:, :3], axis=1)
    length = np.linalg.norm(apart[:, :3, 3], axis=1)
    return float(np.sqrt((length**2).mean())), float(np.degrees(np.sqrt((angle**2).mean())))
