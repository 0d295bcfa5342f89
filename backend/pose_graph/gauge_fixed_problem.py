"""A problem with a fixed gauge, and the least-squares fit of a subset of its edges."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import compress

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.errors import BackendError
from backend.pose_graph.chi_square import ChiSquare, chi_square
from backend.pose_graph.descent import OnStep
from backend.pose_graph.initialize import chordal, spanning_tree
from backend.pose_graph.minimise import (
    MAX_ITERATIONS,
    RELATIVE_TOLERANCE,
    OptimizationResult,
    gauss_newton,
    levenberg_marquardt,
)
from backend.pose_graph.problem import Problem
from backend.pose_graph.unary_factors import aligned

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LOOP_COST_FACTOR = 1e6
"""Factor on the cost of a loop in the spanning tree: one false loop corrupts all poses behind it."""


@dataclass(frozen=True)
class Options:
    """Options of the solver."""

    loops_robust: bool = True
    covariances: bool = True
    on_step: OnStep | None = None
    deadline: float = math.inf
    """Time limit on the clock of ``time.monotonic``."""
    seed: int = 0
    """Seed of the loops that are drawn by lot where there are very many."""

    def out_of_time(self) -> bool:
        """Return whether the time limit has passed."""
        return time.monotonic() > self.deadline


@dataclass(frozen=True)
class GraphFit:
    """Least-squares fit of a subset of the edges."""

    minimum: OptimizationResult
    w_T: Array
    test: ChiSquare


@dataclass(frozen=True)
class GaugeFixedProblem:
    """A problem with a fixed gauge and solver options."""

    problem: Problem
    priors: gtsam.NonlinearFactorGraph
    """Unary factors and gauge priors."""
    options: Options

    def graph(self, kept: Mask) -> gtsam.NonlinearFactorGraph:
        """Build the graph of the kept edges (m,) with all unary factors and priors."""
        graph = gtsam.NonlinearFactorGraph()
        add = graph.add
        for factor in compress(self.edges, kept.tolist()):
            add(factor)
        graph.push_back(self.priors)
        return graph

    @cached_property
    def edges(self) -> list[gtsam.NonlinearFactor]:
        """(m,) factor of each edge, cached: their construction dominates the time to build a graph."""
        return list(self.problem.single_factors())

    @property
    def rows(self) -> int:
        """Number of rows of the linear system with all edges."""
        priors = (self.priors.at(k).dim() for k in range(self.priors.size()))
        return self.problem.dof * len(self.problem.i) + sum(priors)


def initial_poses(problem: Problem) -> Array:
    """Return initial poses (n, 4, 4): the given ones, or a spanning tree if some are unknown.

    The tree begins at a known pose; without one it is aligned to the unary factors.
    """
    known = np.isfinite(problem.initial).all(axis=(1, 2))
    if known.all():
        return se3.orthonormal(problem.initial)
    root = int(np.argmax(known))
    first = problem.initial[root] if known.any() else np.eye(4)
    R = problem.sqrt_information
    cost = 1 / np.maximum((R**2).sum(axis=(1, 2)), 1e-300) * np.where(problem.trusted, 1, _LOOP_COST_FACTOR)
    w_T = spanning_tree(problem.count, problem.i, problem.j, problem.ij_T, cost, root, first)
    return w_T if known.any() else aligned(w_T, problem.unary_factors)


def _chordal_start(problem: Problem, w_T_root: Array) -> Array | None:
    weight = (problem.sqrt_information**2).sum(axis=1)
    planar = problem.dimension == 2
    kappa = weight[:, 2] if planar else weight[:, :3].mean(axis=1)
    tau = weight[:, :2].mean(axis=1) if planar else weight[:, 3:].mean(axis=1)
    if not ((kappa > 0) & (tau > 0)).all():
        return None
    w_T = chordal(problem.i, problem.j, problem.ij_T, kappa, tau, w_T_root, problem.count, planar)
    known = np.isfinite(problem.initial).any()
    return w_T if w_T is None or known else aligned(w_T, problem.unary_factors)


def least_squares_fit(gauge_fixed: GaugeFixedProblem, kept: Mask, start: Array) -> GraphFit:
    """Fit all kept edges without rejection.

    Start from the better of the initial guess and the chordal relaxation; if that fails, from the other.
    Raises ``BackendError`` if neither can be solved.
    """
    problem, options = gauge_fixed.problem.with_edges(kept), gauge_fixed.options
    graph = gauge_fixed.graph(kept)
    limits = (MAX_ITERATIONS, RELATIVE_TOLERANCE, options.on_step, options.deadline)
    attempts: list[GraphFit] = []
    failure: BackendError | None = None
    for values in _starts(problem, start):
        if attempts and options.out_of_time():
            break
        try:
            attempts.append(_fit(gauge_fixed, problem, gauss_newton(graph, values, *limits, problem.name)))
        except BackendError as error:
            failure = error
            continue
        if attempts[-1].minimum.converged and attempts[-1].test.passed:
            return attempts[-1]
    if not attempts:
        raise failure or BackendError("no start was found")
    best = min(attempts, key=lambda fit: (not fit.minimum.converged, fit.minimum.error))
    if best.minimum.converged:
        return best
    return _fit(gauge_fixed, problem, levenberg_marquardt(graph, best.minimum, *limits))


def damped_fit(gauge_fixed: GaugeFixedProblem, start: Array) -> GraphFit:
    """Fit all edges by damped steps alone from some poses (n, 4, 4).

    Undamped steps may leave the valley of the start. Raises ``BackendError`` if the error is not finite.
    """
    problem, options = gauge_fixed.problem, gauge_fixed.options
    graph, values = gauge_fixed.graph(np.ones(len(problem.i), dtype=bool)), problem.values(start)
    error = float(graph.error(values))
    before = OptimizationResult(error, error, 0, False, "", values)
    limits = (MAX_ITERATIONS, RELATIVE_TOLERANCE, options.on_step, options.deadline)
    return _fit(gauge_fixed, problem, levenberg_marquardt(graph, before, *limits))


def _starts(problem: Problem, start: Array) -> Iterator[gtsam.Values]:
    """Yield the initial guess and the chordal relaxation, the one of lower error first."""
    if not np.isfinite(start).all():
        bad = int(np.argmin(np.isfinite(start).all(axis=(1, 2))))
        raise BackendError(f"the start of {problem.name(bad)} is not finite; give it a pose or none at all")
    # If the edges agree with the guess to within their noise, or form a tree, no relaxation is needed.
    before = _edge_statistic(problem, start)
    looped = len(problem.i) >= problem.count
    relaxed = _chordal_start(problem, start[0]) if looped and not chi_square(problem, before).passed else None
    starts = [start] if relaxed is None else [start, relaxed]
    if relaxed is not None and _edge_statistic(problem, relaxed) < before:
        starts.reverse()
    for w_T in starts:
        yield problem.values(w_T)
    relaxed = _chordal_start(problem, start[0]) if looped and relaxed is None else None
    if relaxed is not None:
        yield problem.values(relaxed)


def _edge_statistic(problem: Problem, w_T: Array) -> float:
    return float((problem.residuals(w_T) ** 2).sum())


def _fit(gauge_fixed: GaugeFixedProblem, edges: Problem, minimum: OptimizationResult) -> GraphFit:
    statistic = 2 * (minimum.error - float(gauge_fixed.priors.error(minimum.values)))
    return GraphFit(minimum, edges.poses(minimum.values), chi_square(edges, statistic))
