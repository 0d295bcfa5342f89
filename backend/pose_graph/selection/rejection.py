"""Rejection of edges that contradict the others, and the solution from the rest."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.errors import BackendError
from backend.pose_graph.chi_square import edge_limit
from backend.pose_graph.gauge_fixed_problem import (
    GaugeFixedProblem,
    GraphFit,
    least_squares_fit,
)
from backend.pose_graph.initialize import tree_edges
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import recheck_rejected
from backend.pose_graph.selection.chains import chain_members
from backend.pose_graph.selection.doubts import doubtful_odometry, odometry_dispute, rejection_dispute
from backend.pose_graph.selection.evidence import LinearizedSet, log_unit_volumes
from backend.pose_graph.selection.gnc import gnc_inliers
from backend.pose_graph.selection.growth import coarse_solver, grow_from_odometry
from backend.pose_graph.selection.prediction import noise_scale, sample_posterior
from backend.pose_graph.selection.swap import swap_loops

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_ROUNDS = 4
_MANY_LOOPS = 5000
"""Loops beyond which the growth from odometry takes many minutes: a round accepts at most 150 of them."""


@dataclass(frozen=True)
class Selection:
    """A set of consistent edges and its fit."""

    kept: Mask
    """(m,)."""
    fit: GraphFit
    innovation_sigma: Array
    """(m,) innovations of the rejected edges, and residuals of the kept ones, in standard deviations."""
    is_complete: bool = True
    """False if the growth of the consistent set was cut off."""
    disputed_odometry: tuple[str, ...] = ()
    """Sentences about rejected loops that agree with each other, against odometry or with it."""


def reject_outliers(gauge_fixed: GaugeFixedProblem, fit: GraphFit | None) -> Selection:
    """Return the consistent edges and their fit.

    ``fit`` is that of all edges; without it odometry must connect all poses.
    """
    problem, trusted = gauge_fixed.problem, gauge_fixed.problem.trusted
    if fit is not None and not fit.test.passed and np.count_nonzero(~trusted) > _MANY_LOOPS:
        # A few false loops among many stand out of the fit of all edges.
        few = _refit(gauge_fixed, np.ones_like(trusted), fit.w_T, ~trusted)
        if few.fit.test.passed:
            return few
    found = None
    if fit is None or has_loops_on_odometry(problem):
        found = _without_wrong_steps(gauge_fixed, _select(gauge_fixed))
        if fit is None or found.fit.test.passed or not _outliers(problem, found, trusted).any():
            return found
    # Odometry may be wrong too: then all edges are trusted alike.
    everything = np.ones_like(trusted)
    kept, at = _gnc(gauge_fixed, fit.w_T, everything)
    other = _refit(gauge_fixed, kept, at, everything)
    if found is None or _is_more_probable(gauge_fixed, other, found):
        return other
    return found


def _select(gauge_fixed: GaugeFixedProblem) -> Selection:
    """Select the loops that agree with the trusted edges."""
    grown, trusted = grow_from_odometry(gauge_fixed), gauge_fixed.problem.trusted
    found = _swap(gauge_fixed, _refit(gauge_fixed, grown.kept, grown.w_T, ~trusted))
    if not (found.kept & ~trusted).any():
        # Odometry that drifts far predicts no loop sharply. All loops at once may still have one consistent
        # fit. That of fewer than half of them may be false loops that are consistent with each other.
        kept, w_T = _gnc(gauge_fixed, found.fit.w_T, ~trusted)
        other = _refit(gauge_fixed, kept, w_T, ~trusted)
        agreeing = np.count_nonzero(other.kept & ~trusted)
        if 2 * agreeing >= np.count_nonzero(~trusted) and _is_more_probable(gauge_fixed, other, found):
            found = other
    return replace(found, is_complete=grown.is_complete)


def _gnc(gauge_fixed: GaugeFixedProblem, w_T: Array, candidate: Mask) -> tuple[Mask, Array]:
    options = gauge_fixed.options
    return gnc_inliers(
        gauge_fixed.problem, gauge_fixed.priors, w_T, candidate, options.on_step, options.deadline
    )


def _without_wrong_steps(gauge_fixed: GaugeFixedProblem, found: Selection) -> Selection:
    """Select again without the step of odometry that is most in doubt, as long as the evidence grows."""
    doubting, lost, believed = gauge_fixed, "", ""
    while time.monotonic() < gauge_fixed.options.deadline:
        step = doubtful_odometry(doubting.problem, found.kept)
        if step is None:
            break
        trusted = doubting.problem.trusted & ~step
        doubting = replace(gauge_fixed, problem=replace(gauge_fixed.problem, trusted=trusted))
        if not has_loops_on_odometry(doubting.problem):
            break
        try:
            other = _select(doubting)
        except BackendError:
            # Without that step too little is known: it stays.
            break
        if not _is_more_probable(gauge_fixed, other, found):
            agreeing = other.kept & ~found.kept & ~gauge_fixed.problem.trusted
            if other.fit.test.passed:
                believed = odometry_dispute(gauge_fixed.problem, step, agreeing)
            break
        if found.fit.test.passed:
            loops = found.kept & ~gauge_fixed.problem.trusted
            lost = rejection_dispute(gauge_fixed.problem, step, loops, other.kept) or lost
        found = other
    return replace(found, disputed_odometry=tuple(each for each in (lost, believed) if each))


def _is_more_probable(gauge_fixed: GaugeFixedProblem, other: Selection, found: Selection) -> bool:
    """Return whether the other selection has the higher evidence, each rejected edge at its prior odds."""
    problem = gauge_fixed.problem
    volumes = log_unit_volumes(problem, found.fit.w_T)
    here, there = (
        LinearizedSet.of(problem, gauge_fixed.graph, each.kept, each.fit.w_T, volumes)
        for each in (found, other)
    )
    if here is None or there is None:
        return here is None
    return there.evidence(here.odds) > here.evidence(here.odds)


def has_loops_on_odometry(problem: Problem) -> bool:
    """Return whether loops exist beside chains of odometry, which have at least as many edges as joints."""
    trusted = np.count_nonzero(problem.trusted)
    return bool(len(chain_members(problem)) <= trusted < len(problem.trusted))


def _outliers(problem: Problem, found: Selection, among: Mask) -> Mask:
    off = np.linalg.norm(problem.residuals(found.fit.w_T), axis=1)
    return np.asarray(among & (off > edge_limit(problem)))


def _swap(gauge_fixed: GaugeFixedProblem, found: Selection) -> Selection:
    def out_of_time() -> bool:
        return time.monotonic() > gauge_fixed.options.deadline

    kept, w_T = swap_loops(
        gauge_fixed.problem,
        gauge_fixed.graph,
        coarse_solver(gauge_fixed),
        found.kept,
        found.fit.w_T,
        out_of_time,
    )
    if np.array_equal(kept, found.kept):
        return found
    # The search counts places, not loops: it may lose true loops of a place that it takes for one.
    other = _refit(gauge_fixed, kept, w_T, ~gauge_fixed.problem.trusted)
    return other if _is_more_probable(gauge_fixed, other, found) else found


def _connected(problem: Problem, kept: Mask, w_T: Array) -> Mask:
    """Return kept edges, plus the best of the others that are needed to keep the graph connected."""
    cost = np.where(kept, 1e-9, 1) * (1 + (problem.residuals(w_T) ** 2).sum(axis=1))
    tree = tree_edges(problem.count, problem.i, problem.j, cost)
    return kept | np.isin(np.arange(len(kept)), tree)


def _refit(gauge_fixed: GaugeFixedProblem, kept: Mask, w_T: Array, candidate: Mask) -> Selection:
    """Fit the kept edges; restore edges that the prediction's uncertainty explains, and drop outliers."""
    problem, limit = gauge_fixed.problem, edge_limit(gauge_fixed.problem)
    banned, kept = np.zeros_like(kept), _connected(problem, kept, w_T)
    for remaining in reversed(range(_ROUNDS)):
        fit = least_squares_fit(gauge_fixed, kept, w_T)
        w_T = fit.w_T
        sigma = np.linalg.norm(problem.residuals(w_T), axis=1)
        outliers = np.zeros_like(kept)
        if not fit.test.passed:
            outliers = kept & candidate & (sigma > limit * max(1.0, noise_scale(problem, kept, w_T)))
        samples = sample_posterior(gauge_fixed.graph(kept), fit.minimum.values, problem.dof)
        back = np.zeros_like(kept)
        if samples is not None:
            back, innovation = recheck_rejected(problem, kept, w_T, samples)
            back &= ~banned
            sigma = np.where(kept, sigma, innovation)
        if remaining == 0 or not (back.any() or outliers.any()):
            break
        banned |= outliers
        kept = _connected(problem, (kept | back) & ~outliers, w_T)
    return Selection(kept, fit, sigma)


def reasons(problem: Problem, kept: Mask, w_T: Array, sigma: Array) -> tuple[str, ...]:
    """Return why each rejected edge was: ``disagrees by 7.3 sigma (limit 4.1): 1.2 m, 14 deg``.

    The result is (m,), empty strings for the ``kept`` edges; ``sigma`` (m,) holds the innovations.
    """
    rejected, limit = np.flatnonzero(~kept), edge_limit(problem)
    i, j = problem.i[rejected], problem.j[rejected]
    off = se3.log(se3.inverse(problem.ij_T[rejected]) @ se3.inverse(w_T[i]) @ w_T[j])
    lengths, degrees = np.linalg.norm(off[:, 3:], axis=1), np.degrees(np.linalg.norm(off[:, :3], axis=1))
    messages = [""] * len(kept)
    for e, length, angle in zip(rejected.tolist(), lengths.tolist(), degrees.tolist(), strict=True):
        if sigma[e] <= limit:
            messages[e] = (
                f"agrees, but too little is known of where it lies to trust it: {sigma[e]:.1f} sigma"
            )
        else:
            messages[e] = (
                f"disagrees by {sigma[e]:.1f} sigma (limit {limit:.1f}): {length:.2g}"
                f" {problem.length_unit}, {angle:.2g} deg"
            )
    return tuple(messages)
