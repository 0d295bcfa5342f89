"""Solve one connected component: fix its gauge, initialise, solve, and reject edges only if necessary."""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.gauge import format_directions, format_keys, gauge_prior, unobserved_directions
from backend.measurements import Rejection
from backend.pose_graph.chi_square import SIGNIFICANCE
from backend.pose_graph.elimination import elimination_exceeds
from backend.pose_graph.gauge_fixed_problem import (
    GaugeFixedProblem,
    GraphFit,
    Options,
    initial_poses,
    least_squares_fit,
)
from backend.pose_graph.marginals import MAX_VARIANCE, posterior
from backend.pose_graph.observability import unobserved
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.own_noise import own_noise
from backend.pose_graph.selection.reasons import reasons
from backend.pose_graph.selection.rejection import has_loops_on_odometry, reject_outliers
from backend.pose_graph.selection.rival_loops import rival_loops, rivals_sentence
from backend.pose_graph.unary_factors import fixed, jacobian
from backend.quantiles import chi_square_limit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_EXPENSIVE = 5e9
"""Floating-point operations of an elimination that takes about a second."""
_MAX_LISTED = 5
_MAX_RATIO = 1e10
"""Ratio of two edges' information above which covariances are computed by QR."""


@dataclass(frozen=True)
class SolvedComponent:
    """Solution of one component; arrays are in the order of its poses and edges."""

    w_T: Array
    covariances: Array | None
    kept: Mask
    reasons: tuple[Rejection | None, ...]
    residual: Array
    error: float
    iterations: int
    failure: str
    """Sentence that no start converged, or empty."""
    unobserved: str
    open: tuple[str, ...]
    """Directions that neither a measurement nor the gauge fixes, as sentences."""
    doubts: tuple[str, ...]
    """Reasons why the result may be wrong, as sentences."""
    warnings: tuple[str, ...]
    contradictions: tuple[str, ...]
    """The doubts that edges scatter more than their covariances allow."""
    disputed_odometry: tuple[str, ...]
    """A sentence about rejected loops that agree with each other against odometry, or empty."""


def solve_component(problem: Problem, options: Options) -> SolvedComponent:
    """Solve one connected component. Raises ``BackendError`` if it has no solution."""
    start = initial_poses(problem)
    priors, open_directions = gauge_priors(problem, start)
    gauge_fixed = GaugeFixedProblem(problem, priors, options)
    kept = np.ones(len(problem.i), dtype=bool)
    sigma = np.full(len(kept), np.nan)
    # Random false loops cause large fill-in: then they are rejected before any solve with all edges.
    size = (problem.count, problem.i, problem.j, problem.dof)
    expensive = options.loops_robust and elimination_exceeds(_EXPENSIVE, *size)
    expensive = expensive and has_loops_on_odometry(problem)
    fit = None if expensive else least_squares_fit(gauge_fixed, kept, start)
    complete = True
    disputes: tuple[str, ...] = ()
    noise = 1.0
    if options.loops_robust and has_loops_on_odometry(problem):
        # Where covariances are stated far too large, the fit of all edges passes its test with a false loop.
        noise = own_noise(gauge_fixed, start if fit is None else fit.w_T)
    if fit is None or (options.loops_robust and not fit.test.at(noise).passed):
        selected = reject_outliers(gauge_fixed, fit, noise)
        kept, fit, sigma = selected.kept, selected.fit, selected.innovation_sigma
        # Past its time limit, each search ends with the best set so far.
        complete = selected.is_complete and not options.out_of_time()
        rivals = rival_loops(gauge_fixed, kept, fit.w_T)
        disputes = selected.disputed_odometry
        disputes += () if rivals is None else (rivals_sentence(problem, rivals),)
    minimum, w_T, contradictions = fit.minimum, fit.w_T, _contradictions(problem, fit)
    covariances: Array | None = None
    still_open: tuple[str, ...] = ()
    unknown: list[str] = []
    if options.covariances:
        covariances = _posterior(gauge_fixed, kept, fit)
        if np.isnan(covariances).any():
            graph = gauge_fixed.graph(kept)
            still_open = tuple(unobserved(graph, minimum.values, problem.name))
            unknown = [] if still_open else [_without_covariance(problem, covariances)]
    return SolvedComponent(
        w_T=w_T,
        covariances=covariances,
        kept=kept,
        reasons=reasons(problem, kept, w_T, sigma, noise),
        residual=np.linalg.norm(problem.residuals(w_T), axis=1),
        error=minimum.error,
        iterations=minimum.iterations,
        failure=_failure(problem, fit),
        unobserved=open_directions,
        open=still_open,
        doubts=tuple(s for s in (*contradictions, *disputes, "" if complete else _cut_off(problem)) if s),
        warnings=(*_far_readings(problem, fit), *unknown),
        contradictions=tuple(contradictions),
        disputed_odometry=disputes,
    )


def _posterior(gauge_fixed: GaugeFixedProblem, kept: Mask, fit: GraphFit) -> Array:
    """Return the covariances (n, 6, 6) of all poses."""
    return posterior(
        gauge_fixed.graph(kept),
        fit.minimum.values,
        range(gauge_fixed.problem.count),
        by_qr=_is_ill_scaled(gauge_fixed.problem),
    ).poses


def _without_covariance(problem: Problem, covariances: Array) -> str:
    """Return a sentence about poses that all measurements place, and whose deviations rounding dominates."""
    lost = np.flatnonzero(np.isnan(covariances).any(axis=(1, 2)))
    return (
        f"{format_keys(lost.tolist(), problem.name)} have no standard deviations: those that the edges state"
        f" are beyond {np.sqrt(MAX_VARIANCE):.0e} {problem.length_unit} or rad, or too small beside others;"
        " give the information in metres and radians"
    )


def _is_ill_scaled(problem: Problem) -> bool:
    """Return whether a normal matrix would lose the least accurate edge beside the most accurate one."""
    information = (problem.sqrt_information**2).sum(axis=1)
    positive = information[information > 0]
    return bool(len(positive) and positive.max() > _MAX_RATIO * positive.min())


def _contradictions(problem: Problem, fit: GraphFit) -> list[str]:
    """Return a sentence if the edges that were kept fail the chi-square test."""
    test = fit.test
    if test.passed:
        return []
    who, ratio = format_keys(range(problem.count), problem.name), math.sqrt(test.statistic / test.dof)
    return [
        f"{who}: the edges disagree more than their covariances allow (chi-square {test.statistic:.4g} for"
        f" {test.dof} degrees of freedom): take deviations {_times(ratio)} as large as stated"
    ]


def _times(ratio: float) -> str:
    return f"{ratio:.2g} times" if ratio < 100 else f"{ratio:.0f} times"


def _cut_off(problem: Problem) -> str:
    who = format_keys(range(problem.count), problem.name)
    return (
        f"{who}: the search for consistent loops was cut off, true loops may be missing or"
        " false ones kept: allow more time, or give fewer loops"
    )


def _failure(problem: Problem, fit: GraphFit) -> str:
    if fit.minimum.converged:
        return ""
    who = format_keys(range(problem.count), problem.name)
    return f"{who}: no start converged ({fit.minimum.reason}); the best point found is given"


def _far_readings(problem: Problem, fit: GraphFit) -> list[str]:
    """Return a sentence for each kind of readings that lie farther off than noise explains."""
    minimum, messages = fit.minimum, []
    # A pose graph's ranges may be heights from other instruments, or from the pictures.
    for kind, words in (("position", "positions"), ("range", "heights over the floor")):
        of_kind = [a for a in problem.unary_factors if a.kind == kind]
        squared = [2 * a.gaussian.error(minimum.values) for a in of_kind]
        gates = [_gate(len(of_kind), a.rows) for a in of_kind]
        far = [(d2, gate, a.k) for d2, gate, a in zip(squared, gates, of_kind, strict=True) if d2 > gate]
        if far:
            keys = format_keys([k for *_, k in far[:_MAX_LISTED]], problem.name)
            more = f" and {len(far) - _MAX_LISTED} more" if len(far) > _MAX_LISTED else ""
            d2, gate, k = max(far)
            messages.append(
                f"{len(far)} of {len(of_kind)} {words} lie farther off than noise explains: down-weighted "
                f"({keys}{more}); the farthest, that of {problem.name(k)}, is off by "
                f"{_times(math.sqrt(d2))} its stated deviation, and noise explains up to "
                f"{_times(math.sqrt(gate))}; check them, leave them out, or state larger deviations"
            )
    return messages


def _gate(count: int, rows: int) -> float:
    """Return the squared whitened error (``rows``) that any of ``count`` good ones exceeds once in 1000."""
    return chi_square_limit(SIGNIFICANCE / count, rows)


def is_placed_alone(problem: Problem) -> bool:
    """Return whether unary factors place the single pose of a problem."""
    if any(a.kind == "fixed" for a in problem.unary_factors):
        return True
    if problem.dimension == 2:
        return False
    return len(_unobserved(problem, initial_poses(problem))) == 0


def gauge_priors(problem: Problem, start: Array) -> tuple[gtsam.NonlinearFactorGraph, str]:
    """Return unary factors plus a gauge prior on unobserved directions, and a sentence about that prior."""
    priors = problem.unary_factor_graph()
    if any(a.kind == "fixed" for a in problem.unary_factors):
        return priors, ""
    who, first = format_keys(range(problem.count), problem.name), problem.name(0)
    if problem.dimension == 2 or not problem.unary_factors:
        priors.push_back(fixed(0, start[0], problem.dimension).factor)
        return (
            priors,
            f"position and attitude of {who}: nothing measures them, {first} is held where it starts",
        )
    directions = _unobserved(problem, start)
    if len(directions) == 0:
        return priors, ""
    priors.push_back(gauge_prior(0, start[0], directions))
    return priors, f"{format_directions(directions)} of {who}: nothing measures them, held at {first}"


def _unobserved(problem: Problem, start: Array) -> Array:
    return unobserved_directions([jacobian(a, start[a.k], start[0, :3, 3]) for a in problem.unary_factors])
