"""Rejection of edges that contradict the others, and the solution from the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from backend.pose_graph.chi_square import SIGNIFICANCE, chi_square_gate
from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, GraphFit, least_squares_fit
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import MAX_HYPOTHESES, recheck_rejected, tail_inflation
from backend.pose_graph.selection.all_edges import (
    are_selective_in_any,
    loses_most_loops,
    lowest_fit,
    one_factor_explains,
)
from backend.pose_graph.selection.chains import chain_members, connected
from backend.pose_graph.selection.doubts import agreement_is_lost, doubtful_odometry, odometry_dispute
from backend.pose_graph.selection.draw import draw_loops
from backend.pose_graph.selection.evidence import LinearizedSet, log_unit_volumes
from backend.pose_graph.selection.gnc import gnc_inliers
from backend.pose_graph.selection.growth import coarse_solver, grow_from_odometry
from backend.pose_graph.selection.places import ROW_LENGTH, place_pairs
from backend.pose_graph.selection.prediction import noise_scale, sample_posterior
from backend.pose_graph.selection.reweighted import reweighted_fit
from backend.pose_graph.selection.selected import Selection
from backend.pose_graph.selection.step_support import may_be_wrong
from backend.pose_graph.selection.swap import swap_loops

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_ROUNDS = 7
"""Largest number of judgements of a selection: each but the last drops edges or takes some back."""
_MANY_LOOPS = MAX_HYPOTHESES
"""Loops beyond which a few false ones are looked for first: the growth from odometry takes many rounds."""
_FEW = 0.1
"""Largest share of rejected edges among loops that are a few. Among more, false loops may outvote true ones:
the growth trusts none at first."""


def reject_outliers(gauge_fixed: GaugeFixedProblem, fit: GraphFit | None, noise: float) -> Selection:
    """Return the consistent edges and their fit.

    ``fit`` is that of all edges; without it odometry must connect all poses. ``noise`` is the factor of the
    edges' noise over the stated one: with it they are judged, and their fit is that of the stated one.
    """
    judged = replace(gauge_fixed, problem=gauge_fixed.problem.with_noise(noise))
    found = _selected(judged, fit)
    if noise != 1:
        found = replace(found, fit=least_squares_fit(gauge_fixed, found.kept, found.fit.w_T))
    if fit is None or not loses_most_loops(gauge_fixed.problem, found.kept):
        return found
    return _without_false_loops(gauge_fixed, fit, found)


def _without_false_loops(gauge_fixed: GaugeFixedProblem, fit: GraphFit, found: Selection) -> Selection:
    """Return all edges where these need no false loop, and the selection that loses most loops otherwise."""
    problem = gauge_fixed.problem
    lowest = lowest_fit(gauge_fixed, fit, found.fit.w_T)
    maps = lowest.w_T, found.fit.w_T
    if not one_factor_explains(gauge_fixed, lowest, maps):
        return found
    everything = Selection.of(problem, np.ones_like(found.kept), lowest)
    if lowest.test.passed or not are_selective_in_any(problem, maps):
        return everything
    return everything if _is_more_probable(gauge_fixed, everything, found) else found


def _selected(gauge_fixed: GaugeFixedProblem, fit: GraphFit | None) -> Selection:
    """Select the consistent edges at the stated noise."""
    problem, trusted = gauge_fixed.problem, gauge_fixed.problem.trusted
    if fit is not None and not fit.test.passed and np.count_nonzero(~trusted) > _MANY_LOOPS:
        few = _without_few(gauge_fixed, fit)
        if few is not None:
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


def _without_few(gauge_fixed: GaugeFixedProblem, fit: GraphFit) -> Selection | None:
    """Return all edges but a few that stand out of a fit in which those far off lose their weight.

    The result is None where the others contradict each other too, or where these are more than a few.
    """
    problem = gauge_fixed.problem
    loops, found = ~problem.trusted, reweighted_fit(gauge_fixed, fit.w_T)
    for candidate in (loops, np.ones_like(loops)):
        few = _refit(gauge_fixed, ~candidate | found.agreeing, found.w_T, candidate)
        if few.fit.test.passed and np.count_nonzero(~few.kept) <= _FEW * np.count_nonzero(loops):
            return few
    return None


def _select(gauge_fixed: GaugeFixedProblem) -> Selection:
    """Select the loops that agree with the trusted edges.

    Of very many, some are drawn first, and the others are judged against the solution from these.
    """
    problem = gauge_fixed.problem
    drawn = draw_loops(problem, gauge_fixed.options.seed)
    if drawn.all():
        return _select_from_all(gauge_fixed)
    some = _select_from_all(replace(gauge_fixed, problem=problem.with_edges(drawn)))
    kept = np.zeros_like(drawn)
    kept[drawn] = some.kept
    return replace(_refit(gauge_fixed, kept, some.fit.w_T, ~problem.trusted), is_complete=some.is_complete)


def _select_from_all(gauge_fixed: GaugeFixedProblem) -> Selection:
    """Grow the selection from odometry, exchange loops, and take back those that agree."""
    grown, trusted = grow_from_odometry(gauge_fixed), gauge_fixed.problem.trusted
    # The exchange comes before loops are taken back: those that a bent map takes back would hold it bent.
    swapped = _swap(gauge_fixed, _fitted(gauge_fixed, grown.kept, grown.w_T))
    found = _refit(gauge_fixed, swapped.kept, swapped.fit.w_T, ~trusted)
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
    """Select again without the step of odometry that is most in doubt, as long as the evidence grows.

    Loops that agreed with the step speak for it, and those that are gained without it speak against it: if
    more are lost than by chance, and they and the step itself are as many witnesses as the gained ones, the
    step stays. Loops in a row are one witness. Where nothing is gained, or the rejected loops over the step
    agree with each other no better than the kept ones do, nothing speaks against the step.
    """
    problem, doubting = gauge_fixed.problem, gauge_fixed
    while not gauge_fixed.options.out_of_time():
        step = doubtful_odometry(doubting.problem, found.kept)
        if step is None or not may_be_wrong(doubting, step, found.kept, found.fit.w_T):
            break
        trusted = doubting.problem.trusted & ~step
        doubting = replace(gauge_fixed, problem=replace(problem, trusted=trusted))
        if not has_loops_on_odometry(doubting.problem):
            break
        try:
            other = _select(doubting)
        except BackendError:
            # Without that step too little is known: it stays.
            break
        if np.array_equal(other.kept, found.kept):
            break
        loops = ~problem.trusted
        against = other.kept & ~found.kept & loops
        lost = found.kept & ~other.kept & loops
        is_supported = (
            found.fit.test.passed
            and agreement_is_lost(found.kept & loops, other.kept)
            and _rows(problem, lost) + 1 >= _rows(problem, against)
            and bool((step & ~other.kept).any() or not against.any())
        )
        is_probable = _is_more_probable(gauge_fixed, other, found)
        if is_probable and not is_supported:
            found = other
            continue
        said = odometry_dispute(problem, step, against, is_probable) if other.fit.test.passed else ""
        return replace(found, disputed_odometry=(said,) if said else ())
    return found


def _rows(problem: Problem, loops: Mask) -> int:
    """Return the number of rows that some loops (m,) form."""
    return len(np.unique(place_pairs(problem.i[loops], problem.j[loops], ROW_LENGTH)))


def _is_more_probable(gauge_fixed: GaugeFixedProblem, other: Selection, found: Selection) -> bool:
    """Return whether the other selection has the higher evidence, each rejected edge at its prior odds."""
    return _evidence_gain(gauge_fixed, other, found) > 0


def _evidence_gain(
    gauge_fixed: GaugeFixedProblem, other: Selection, found: Selection, with_tails: bool = False
) -> float:
    """Return how much higher the log evidence (nats) of the other selection is.

    Each has its own noise; ``with_tails`` both have that of the found one times `tail_inflation`. A true edge
    lies in the tail, beyond its gate without that factor, once in a thousand.
    """
    problem = gauge_fixed.problem
    volumes = log_unit_volumes(problem, found.fit.w_T)
    here, there = (
        LinearizedSet.of(problem, gauge_fixed.graph, each.kept, each.fit.w_T, volumes)
        for each in (found, other)
    )
    if here is None or there is None:
        return np.inf if here is None else -np.inf
    log_prior = 0.0
    if with_tails:
        scale = here.scale * tail_inflation(here.scale * problem.noise)
        here, there = replace(here, scale=scale), replace(there, scale=scale)
        in_tail = other.kept & ~found.kept & (found.innovation_sigma > _edge_limit(problem))
        log_prior = float(np.log(SIGNIFICANCE)) * np.count_nonzero(in_tail)
    return there.evidence(here.odds) - here.evidence(here.odds) + log_prior


def has_loops_on_odometry(problem: Problem) -> bool:
    """Return whether loops exist beside chains of odometry, which have at least as many edges as joints."""
    trusted = np.count_nonzero(problem.trusted)
    return bool(len(chain_members(problem)) <= trusted < len(problem.trusted))


def _edge_limit(problem: Problem) -> float:
    """Return the norm of whitened residuals that a true edge exceeds once in a thousand."""
    return float(np.sqrt(chi_square_gate(problem.dof)))


def _outliers(problem: Problem, found: Selection, among: Mask) -> Mask:
    off = np.linalg.norm(problem.residuals(found.fit.w_T), axis=1)
    return np.asarray(among & (off > _edge_limit(problem)))


def _swap(gauge_fixed: GaugeFixedProblem, found: Selection) -> Selection:
    kept, w_T = swap_loops(
        gauge_fixed.problem,
        gauge_fixed.graph,
        coarse_solver(gauge_fixed),
        found.kept,
        found.fit.w_T,
        gauge_fixed.options.out_of_time,
    )
    if np.array_equal(kept, found.kept):
        return found
    # The search counts places, not loops: it may lose true loops of a place that it takes for one.
    other = _fitted(gauge_fixed, kept, w_T)
    return other if _gain_by_places(gauge_fixed, other, found) > 0 else found


def _gain_by_places(
    gauge_fixed: GaugeFixedProblem, other: Selection, found: Selection, with_tails: bool = False
) -> float:
    """Return `_evidence_gain` where a row of loops counts as one loop."""
    problem = gauge_fixed.problem
    pair = thinned(problem, other, found), thinned(problem, found, other)
    return _evidence_gain(gauge_fixed, *pair, with_tails)


def thinned(problem: Problem, found: Selection, beside: Selection) -> Selection:
    """Return a selection with one loop for each pair of places where the one beside it has none.

    False loops of a row agree with each other as true ones do: only the nearest is evidence for the row.
    """
    place, loops = place_pairs(problem.i, problem.j, ROW_LENGTH), ~problem.trusted
    own = np.flatnonzero(found.kept & loops & ~np.isin(place, place[beside.kept & loops]))
    own = own[np.argsort(np.linalg.norm(problem.residuals(found.fit.w_T)[own], axis=1))]
    kept = found.kept.copy()
    kept[own] = False
    kept[own[np.unique(place[own], return_index=True)[1]]] = True
    return replace(found, kept=connected(problem, kept, found.kept, found.fit.w_T))


def _fitted(gauge_fixed: GaugeFixedProblem, kept: Mask, w_T: Array) -> Selection:
    kept = connected(gauge_fixed.problem, kept, np.ones_like(kept), w_T)
    fit = least_squares_fit(gauge_fixed, kept, w_T)
    return Selection.of(gauge_fixed.problem, kept, fit)


def _refit(gauge_fixed: GaugeFixedProblem, kept: Mask, w_T: Array, candidate: Mask) -> Selection:
    """Fit the kept edges; restore edges that the prediction's uncertainty explains, and drop outliers.

    Edges are restored only if that raises the evidence: together they may bend the map until they agree.
    """
    found = _fitted(gauge_fixed, kept, w_T)
    banned = np.zeros_like(kept)
    for remaining in reversed(range(_ROUNDS)):
        back, found = _judged(gauge_fixed, found)
        outliers, back = _misfits(gauge_fixed.problem, found, candidate), back & ~banned
        if remaining == 0 or not (back.any() or outliers.any()):
            break
        if outliers.any():
            banned |= outliers
            found = _fitted(gauge_fixed, found.kept & ~outliers, found.fit.w_T)
        else:
            banned |= back
            found = _taken_back(gauge_fixed, found, back)
    return found


def _taken_back(gauge_fixed: GaugeFixedProblem, found: Selection, back: Mask) -> Selection:
    """Add the edges ``back`` (m,) to a selection, without their worst quarter until the evidence grows.

    They agreed at a noise with tails, and are judged by the same.
    """
    while back.any():
        other = _fitted(gauge_fixed, found.kept | back, found.fit.w_T)
        if _gain_by_places(gauge_fixed, other, found, with_tails=True) > 0:
            return other
        back = back & (found.innovation_sigma < np.quantile(found.innovation_sigma[back], 0.75))
    return found


def _judged(gauge_fixed: GaugeFixedProblem, found: Selection) -> tuple[Mask, Selection]:
    """Return which rejected edges (m,) agree with the others, and the selection with their innovations."""
    problem, kept, fit = gauge_fixed.problem, found.kept, found.fit
    samples = sample_posterior(gauge_fixed.graph(kept), fit.minimum.values, problem.dof)
    if samples is None:
        return np.zeros_like(kept), found
    back, innovation = recheck_rejected(problem, kept, fit.w_T, samples)
    return back, replace(found, innovation_sigma=np.where(kept, found.innovation_sigma, innovation))


def _misfits(problem: Problem, found: Selection, candidate: Mask) -> Mask:
    """Return the ``candidate`` edges (m,) beyond their limit at the noise of a fit that fails its test."""
    if found.fit.test.passed:
        return np.zeros_like(candidate)
    scale = max(1.0, noise_scale(problem, found.kept, found.fit.w_T))
    return np.asarray(found.kept & candidate & (found.innovation_sigma > _edge_limit(problem) * scale))
