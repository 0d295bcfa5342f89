"""Grow the set of consistent loops from odometry: each chain for itself, then all chains together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from backend.gauge import format_keys
from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, initial_poses
from backend.pose_graph.initialize import spanning_tree
from backend.pose_graph.minimise import OptimizationResult, gauss_newton, levenberg_marquardt
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import GrownSet, Solve, grow_consistent_set
from backend.pose_graph.selection.chains import Chain, chain_members, join_chains
from backend.pose_graph.selection.prediction import sample_posterior, white_noise
from backend.pose_graph.unary_factors import aligned, fixed

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_FEW, _COARSE = 8, 1e-3
"""Steps and tolerance of the intermediate solves."""


def grow_from_odometry(gauge_fixed: GaugeFixedProblem) -> GrownSet:
    """Return the edges that are consistent with the trusted ones, and all poses.

    The loops within each chain of odometry come first; then the chains are joined.
    """
    problem, options = gauge_fixed.problem, gauge_fixed.options
    solve = coarse_solver(gauge_fixed)
    noise = white_noise(gauge_fixed.rows, problem.dof)

    def draw(kept: Mask, w_T: Array) -> Array | None:
        if options.out_of_time():
            return None
        return sample_posterior(gauge_fixed.graph(kept), problem.values(w_T), problem.dof, noise)

    def on_round(number: int, accepted: int) -> None:
        if options.on_step is not None:
            options.on_step(number, float(accepted))

    members = chain_members(problem)
    joints, start = np.zeros_like(problem.trusted), _chain_poses(problem)
    if len(members) > 1:
        chains = [_grown_chain(gauge_fixed, chain, number) for number, chain in enumerate(members)]
        joints, start = join_chains(problem, chains, options.out_of_time)
    start = start if np.isfinite(problem.initial).any() else aligned(start, problem.unary_factors)
    base = problem.trusted | joints
    return grow_consistent_set(problem, base, solve(base, start), solve, draw, on_round)


def _chain_poses(problem: Problem) -> Array:
    chain = problem.with_edges(problem.trusted)
    cost, root = np.ones(len(chain.i)), initial_poses(problem)[0]
    return spanning_tree(problem.count, chain.i, chain.j, chain.ij_T, cost, 0, root)


def _grown_chain(gauge_fixed: GaugeFixedProblem, members: Index, number: int) -> Chain:
    """Grow the consistent loops within one chain of odometry, with its first pose fixed."""
    own = anchored_part(gauge_fixed, members, initial_poses(gauge_fixed.problem.restricted(members))[0])
    trusted = own.problem.trusted
    grown = GrownSet(trusted, odometry_poses(own), True) if trusted.all() else grow_from_odometry(own)
    return Chain(members, grown.w_T, part_samples(own, grown.kept, grown.w_T, number))


def anchored_part(gauge_fixed: GaugeFixedProblem, members: Index, w_T_first: Array) -> GaugeFixedProblem:
    """Return the problem of some poses (sorted), with the first of them fixed at ``w_T_first`` (4, 4)."""
    problem = gauge_fixed.problem.restricted(members)
    problem = replace(problem, unary_factors=(fixed(0, w_T_first, problem.dimension),))
    return GaugeFixedProblem(problem, problem.unary_factor_graph(), gauge_fixed.options)


def part_samples(part: GaugeFixedProblem, kept: Mask, w_T: Array, number: int) -> Array:
    """Draw samples (n, d, s) of the posterior of a part, independent of those of another ``number``.

    Raises `BackendError` if the kept edges do not fix its poses.
    """
    problem = part.problem
    noise = white_noise(part.rows, problem.dof, number)
    samples = sample_posterior(part.graph(kept), problem.values(w_T), problem.dof, noise)
    if samples is None:
        poses = format_keys(range(problem.count), problem.name)
        raise BackendError(f"{poses}: its odometry does not fix its poses")
    return samples


def odometry_poses(own: GaugeFixedProblem) -> Array:
    """Return the poses (n, 4, 4) by odometry alone: the initial guess may follow loops that are false."""
    return coarse_solver(own)(own.problem.trusted, _chain_poses(own.problem))


def coarse_solver(gauge_fixed: GaugeFixedProblem) -> Solve:
    """Return a coarse solver for intermediate solves."""
    problem, options = gauge_fixed.problem, gauge_fixed.options

    def solve(kept: Mask, w_T: Array) -> Array:
        limits = (_FEW, _COARSE, None, options.deadline)
        begin = OptimizationResult(
            error=0.0, initial_error=0.0, iterations=0, converged=False, reason="", values=problem.values(w_T)
        )
        graph = gauge_fixed.graph(kept)
        try:
            at = gauss_newton(graph, begin.values, *limits, problem.name)
        except BackendError:
            at = begin
        if not at.converged:
            at = levenberg_marquardt(graph, at, *limits)
        return problem.poses(at.values)

    return solve
