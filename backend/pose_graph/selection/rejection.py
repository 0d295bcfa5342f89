"""Rejection of edges that contradict the others, and the solution from the rest."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.errors import BackendError
from backend.gauge import format_keys
from backend.pose_graph.chi_square import edge_limit
from backend.pose_graph.gauge_fixed_problem import (
    GaugeFixedProblem,
    GraphFit,
    initial_poses,
    least_squares_fit,
)
from backend.pose_graph.initialize import spanning_tree, tree_edges
from backend.pose_graph.minimise import OptimizationResult, gauss_newton, levenberg_marquardt
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import Solve, grow_consistent_set, recheck_rejected
from backend.pose_graph.selection.chains import Chain, chain_members, join_chains
from backend.pose_graph.selection.evidence import LinearizedSet, log_unit_volumes
from backend.pose_graph.selection.gnc import gnc_inliers
from backend.pose_graph.selection.odometry_faults import doubtful_odometry
from backend.pose_graph.selection.prediction import noise_scale, sample_posterior, white_noise
from backend.pose_graph.selection.swap import swap_loops
from backend.pose_graph.selection.swap_search import SwapSearch
from backend.pose_graph.unary_factors import aligned, fixed

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_ROUNDS = 4
_SUSPECTS = 100
"""Loops of the largest residuals that are examined one by one."""
_FEW, _COARSE = 8, 1e-3
"""Steps and tolerance of the intermediate solves."""


def reject_outliers(gauge_fixed: GaugeFixedProblem, fit: GraphFit | None) -> tuple[Mask, GraphFit, Array]:
    """Return consistent edges (m,), their fit, and the innovations of the rejected ones in sigmas (m,).

    ``fit`` is that of all edges; without it odometry must connect all poses.
    """
    problem, trusted = gauge_fixed.problem, gauge_fixed.problem.trusted
    found = None
    if fit is None or has_loops_on_odometry(problem):
        found = _without_wrong_steps(gauge_fixed, _select(gauge_fixed))
        if fit is None or found[1].test.passed or not _outliers(problem, found, trusted).any():
            return found
    # Odometry may be wrong too: then all edges are trusted alike.
    everything = np.ones_like(trusted)
    kept, at = gnc_inliers(
        problem,
        gauge_fixed.priors,
        fit.w_T,
        everything,
        gauge_fixed.options.on_step,
        gauge_fixed.options.deadline,
    )
    other = _refit(gauge_fixed, kept, at, everything)
    if found is None or _is_more_probable(gauge_fixed, other, found):
        return other
    return found


def _select(gauge_fixed: GaugeFixedProblem) -> tuple[Mask, GraphFit, Array]:
    """Select the loops that agree with the trusted edges."""
    found = _refit(gauge_fixed, *_grow_set(gauge_fixed), ~gauge_fixed.problem.trusted)
    return _swap(gauge_fixed, found)


def _without_wrong_steps(
    gauge_fixed: GaugeFixedProblem, found: tuple[Mask, GraphFit, Array]
) -> tuple[Mask, GraphFit, Array]:
    """Select again without the step of odometry that is most in doubt, as long as the evidence grows."""
    doubting = gauge_fixed
    while time.monotonic() < gauge_fixed.options.deadline:
        step = doubtful_odometry(doubting.problem, found[0])
        if step is None:
            break
        trusted = doubting.problem.trusted.copy()
        trusted[step] = False
        doubting = replace(gauge_fixed, problem=replace(gauge_fixed.problem, trusted=trusted))
        if not has_loops_on_odometry(doubting.problem):
            break
        try:
            other = _select(doubting)
        except BackendError:
            # Without that step too little is known: it stays.
            break
        if not _is_more_probable(gauge_fixed, other, found):
            break
        found = other
    return found


def _is_more_probable(
    gauge_fixed: GaugeFixedProblem, other: tuple[Mask, GraphFit, Array], found: tuple[Mask, GraphFit, Array]
) -> bool:
    """Return whether the other selection has the higher evidence, each rejected edge at its prior odds."""
    problem = gauge_fixed.problem
    volumes = log_unit_volumes(problem, found[1].w_T)
    here, there = (
        LinearizedSet.of(problem, gauge_fixed.graph, kept, fit.w_T, volumes)
        for kept, fit, _ in (found, other)
    )
    if here is None or there is None:
        return here is None
    return there.evidence(here.odds) > here.evidence(here.odds)


def has_loops_on_odometry(problem: Problem) -> bool:
    """Return whether loops exist beside chains of odometry, which have at least as many edges as joints."""
    trusted = np.count_nonzero(problem.trusted)
    return bool(len(chain_members(problem)) <= trusted < len(problem.trusted))


def has_dominant_loop(gauge_fixed: GaugeFixedProblem, fit: GraphFit) -> bool:
    """Return whether the removal of one loop would halve the chi-square of the fit of all edges.

    Where covariances are stated far too large, the chi-square test passes with a false loop in the graph.
    """
    problem = gauge_fixed.problem
    residual = problem.residuals(fit.w_T)
    loops = np.flatnonzero(~problem.trusted)
    loops = np.sort(loops[np.argsort(-(residual[loops] ** 2).sum(axis=1))][:_SUSPECTS])
    volumes = np.zeros(len(problem.i))
    whole = LinearizedSet.of(problem, gauge_fixed.graph, np.ones_like(problem.trusted), fit.w_T, volumes)
    if whole is None or len(loops) == 0:
        return False
    decrease = SwapSearch(whole, loops, residual).chi_square_changes()
    return bool(decrease.max() > whole.chi_square / 2)


def _outliers(problem: Problem, found: tuple[Mask, GraphFit, Array], among: Mask) -> Mask:
    off = np.linalg.norm(problem.residuals(found[1].w_T), axis=1)
    return np.asarray(among & (off > edge_limit(problem)))


def _solver(gauge_fixed: GaugeFixedProblem) -> Solve:
    """Return a coarse solver for intermediate solves."""
    problem, options = gauge_fixed.problem, gauge_fixed.options

    def solve(kept: Mask, w_T: Array) -> Array:
        limits = (_FEW, _COARSE, None, options.deadline)
        begin = OptimizationResult(problem.values(w_T), 0.0, 0.0, 0, False, "")
        graph = gauge_fixed.graph(kept)
        try:
            at = gauss_newton(graph, begin.values, *limits, problem.name)
        except BackendError:
            at = begin
        if not at.converged:
            at = levenberg_marquardt(graph, at, *limits)
        return problem.poses(at.values)

    return solve


def _swap(
    gauge_fixed: GaugeFixedProblem, found: tuple[Mask, GraphFit, Array]
) -> tuple[Mask, GraphFit, Array]:
    def out_of_time() -> bool:
        return time.monotonic() > gauge_fixed.options.deadline

    kept, w_T = swap_loops(
        gauge_fixed.problem, gauge_fixed.graph, _solver(gauge_fixed), found[0], found[1].w_T, out_of_time
    )
    if np.array_equal(kept, found[0]):
        return found
    # The search counts places, not loops: it may lose true loops of a place that it takes for one.
    other = _refit(gauge_fixed, kept, w_T, ~gauge_fixed.problem.trusted)
    return other if _is_more_probable(gauge_fixed, other, found) else found


def _grow_set(gauge_fixed: GaugeFixedProblem) -> tuple[Mask, Array]:
    problem, options = gauge_fixed.problem, gauge_fixed.options
    solve = _solver(gauge_fixed)
    noise = white_noise(gauge_fixed.rows, problem.dof)

    def draw(kept: Mask, w_T: Array) -> Array | None:
        if time.monotonic() > options.deadline:
            return None
        return sample_posterior(gauge_fixed.graph(kept), problem.values(w_T), problem.dof, noise)

    def on_round(number: int, accepted: int) -> None:
        if options.on_step is not None:
            options.on_step(number, float(accepted))

    members = chain_members(problem)
    joints, start = np.zeros_like(problem.trusted), _chain_poses(problem)
    if len(members) > 1:
        chains = [_grown_chain(gauge_fixed, chain, number) for number, chain in enumerate(members)]
        joints, start = join_chains(problem, chains, lambda: time.monotonic() > options.deadline)
    start = start if np.isfinite(problem.initial).any() else aligned(start, problem.unary_factors)
    base = problem.trusted | joints
    return grow_consistent_set(problem, base, solve(base, start), solve, draw, on_round)


def _chain_poses(problem: Problem) -> Array:
    chain = problem.with_edges(problem.trusted)
    cost, root = np.ones(len(chain.i)), initial_poses(problem)[0]
    return spanning_tree(problem.count, chain.i, chain.j, chain.ij_T, cost, 0, root)


def _grown_chain(gauge_fixed: GaugeFixedProblem, members: Index, number: int) -> Chain:
    """Grow the consistent loops within one chain of odometry, with its first pose held."""
    whole = gauge_fixed.problem
    problem = whole.restricted(members)
    start = initial_poses(problem)
    problem = replace(problem, unary_factors=(fixed(0, start[0], problem.dimension),))
    own = GaugeFixedProblem(problem, problem.unary_factor_graph(), gauge_fixed.options)
    kept, w_T = (problem.trusted, start) if problem.trusted.all() else _grow_set(own)
    noise = white_noise(own.rows, problem.dof, number)
    samples = sample_posterior(own.graph(kept), problem.values(w_T), problem.dof, noise)
    if samples is None:
        raise BackendError(
            f"{format_keys(members.tolist(), whole.name)}: its odometry does not fix its poses"
        )
    return Chain(members, w_T, samples)


def _connected(problem: Problem, kept: Mask, w_T: Array) -> Mask:
    """Return kept edges, plus the best of the others that are needed to keep the graph connected."""
    cost = np.where(kept, 1e-9, 1) * (1 + (problem.residuals(w_T) ** 2).sum(axis=1))
    tree = tree_edges(problem.count, problem.i, problem.j, cost)
    return kept | np.isin(np.arange(len(kept)), tree)


def _refit(
    gauge_fixed: GaugeFixedProblem, kept: Mask, w_T: Array, candidate: Mask
) -> tuple[Mask, GraphFit, Array]:
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
    return kept, fit, sigma


def reason(problem: Problem, edge: int, w_T: Array, sigma: float) -> str:
    """Return why an edge was rejected: ``disagrees by 7.3 sigma (limit 4.1): 1.2 m, 14 deg``."""
    i, j = problem.i[edge], problem.j[edge]
    off = se3.log((se3.inverse(problem.ij_T[edge]) @ se3.inverse(w_T[i]) @ w_T[j])[None])[0]
    length, degrees = np.linalg.norm(off[3:]), np.degrees(np.linalg.norm(off[:3]))
    limit = edge_limit(problem)
    if sigma <= limit:
        return f"agrees, but too little is known of where it lies to trust it: {sigma:.1f} sigma"
    return (
        f"disagrees by {sigma:.1f} sigma (limit {limit:.1f}): {length:.2g} {problem.length_unit}, "
        f"{degrees:.2g} deg"
    )
