"""Estimate one consistent trajectory from measurements or a pose graph.

Each connected component gets a gauge, an initial guess and a least-squares solve, followed by a global
chi-square test. Only if that test fails, edges are rejected, each with a reason, and the rest is refitted.
"""

from __future__ import annotations

import logging
import math
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.arguments import check_type
from backend.errors import BackendError
from backend.gauge import format_keys
from backend.measurements import LinkCheck, Measurements, Rejection
from backend.pose_graph.checks.common_errors import common_errors
from backend.pose_graph.checks.displaced_loops import displaced_loops
from backend.pose_graph.checks.redundancy import (
    rejected_odometry_warning,
    small_residuals_warning,
    unchecked_components,
)
from backend.pose_graph.checks.rival_groups import rival_groups
from backend.pose_graph.checks.row_mistakes import mistake_warnings, row_mistakes
from backend.pose_graph.checks.score_test import linearised_parts
from backend.pose_graph.connected_component import SolvedComponent, is_placed_alone, solve_component
from backend.pose_graph.descent import OnStep
from backend.pose_graph.from_measurements import components, from_measurements
from backend.pose_graph.gauge_fixed_problem import Options
from backend.pose_graph.graph import PoseGraph, rank_deficient_warning
from backend.pose_graph.problem import Problem, from_pose_graph, informative
from backend.pose_graph.solution import NO_INFORMATION, Solution
from backend.wording import counted, either

Array = NDArray[np.float64]

_LOG = logging.getLogger(__name__)


def solve(
    measurements: Measurements,
    *,
    loops_robust: bool = True,
    initial: Array | None = None,
    covariances: bool = True,
    on_step: OnStep | None = None,
    time_limit_s: float | None = None,
    seed: int = 0,
) -> Solution:
    """Estimate the most likely trajectory of a flight's keyframes.

    Relative poses, attitudes, ranges and positions count, and no other measurements.
    ``initial`` (n, 4, 4), NaN where unknown, is the initial guess; without it odometry provides one.
    ``loops_robust`` allows the rejection of edges if the global test fails; ``seed`` draws the loops from
    which it starts where there are very many. Raises ``BackendError`` for invalid values, and ``TypeError``
    for another object.
    """
    check_type(measurements, Measurements, "measurements")
    _check_stamps(measurements.stamps_s)
    problem, warnings = from_measurements(measurements, initial)
    deadline = math.inf if time_limit_s is None else time.monotonic() + time_limit_s
    options = Options(loops_robust, covariances, on_step, deadline, seed)
    return _solve(problem, options, warnings)


def _check_stamps(stamps_s: Array) -> None:
    stamps_s = np.asarray(stamps_s, dtype=np.float64)
    if not np.isfinite(stamps_s).all():
        k = int(np.argmin(np.isfinite(stamps_s)))
        raise BackendError(f"stamps_s: keyframe {k} has the time {stamps_s[k]}; give seconds")


def solve_pose_graph(
    graph: PoseGraph,
    *,
    loops_robust: bool = True,
    covariances: bool = True,
    on_step: OnStep | None = None,
    time_limit_s: float | None = None,
    seed: int = 0,
) -> Solution:
    """Solve a g2o graph, planar or spatial. Without fixed vertices the first of each component is fixed.

    Edges without information are rejected. The status names components whose accepted edges form a tree, or
    contradict each other, loops whose vertex numbers seem shifted or that share an offset, rejected edges of
    almost as much evidence as those against them, and a search that ``time_limit_s`` cut short. ``seed``
    draws the loops from which the selection starts where there are very many. A warning names rejected edges
    that one typical mistake of their rows explains. Raises ``BackendError`` for invalid values, and
    ``TypeError`` for another object.
    """
    check_type(graph, PoseGraph, "graph", "backend.read_g2o(path)")
    deadline = math.inf if time_limit_s is None else time.monotonic() + time_limit_s
    options = Options(loops_robust, covariances, on_step, deadline, seed)
    problem = from_pose_graph(graph)
    solution = _solve(problem, options, rank_deficient_warning(graph))
    mistakes, parts = row_mistakes(graph, problem, solution), linearised_parts(problem, solution)
    rivals = rival_groups(problem, solution, deadline)
    unsearched = _without_second_map(problem, solution) if options.out_of_time() else []
    reasons = (
        *solution.reasons,
        *unchecked_components(problem, solution),
        *(rivals or [*unsearched, *displaced_loops(problem, solution)]),
        *common_errors(parts),
    )
    return replace(
        solution,
        reasons=reasons,
        warnings=(
            *solution.warnings,
            *rejected_odometry_warning(problem, solution),
            *small_residuals_warning(problem, solution),
            *mistake_warnings(mistakes),
        ),
        row_mistakes=mistakes,
    )


def _without_second_map(problem: Problem, solution: Solution) -> list[str]:
    """Return a sentence if there are rejected loops that might make a second map."""
    rejected = solution.edge_informative & ~solution.edge_kept & ~problem.trusted
    if np.count_nonzero(rejected) < 2:
        return []
    return ["the search for a second map of the rejected loops was cut off: allow more time"]


def _solve(problem: Problem, options: Options, warnings: list[str]) -> Solution:
    """Solve from the edges that carry information; the others are rejected with that reason."""
    has_information = informative(problem)
    if has_information.all():
        return _solve_informative(problem, options, warnings)
    e = int(np.argmin(has_information))
    warnings.append(
        f"{(~has_information).sum()} of {len(has_information)} edges "
        f"{either(int((~has_information).sum()), 'carries', 'carry')} no information (the first is"
        f" {problem.name(problem.i[e])} to {problem.name(problem.j[e])}): left out"
    )
    solution = _solve_informative(problem.with_edges(has_information), options, warnings)
    residual, reasons = (
        np.full(len(has_information), np.nan),
        np.full(len(has_information), NO_INFORMATION, dtype=object),
    )
    residual[has_information], reasons[has_information] = solution.edge_residual, solution.edge_reason
    kept = has_information.copy()
    kept[has_information] = solution.edge_kept
    return replace(solution, edge_kept=kept, edge_residual=residual, edge_reason=tuple(reasons.tolist()))


def _solve_informative(problem: Problem, options: Options, warnings: list[str]) -> Solution:
    """Solve each connected component and assemble the solution."""
    n, m = problem.count, len(problem.i)
    label = components(problem)
    w_T = np.full((n, 4, 4), np.nan)
    covariances = np.full((n, 6, 6), np.nan) if options.covariances else None
    component = np.full(n, -1, dtype=np.int64)
    kept, residual, reasons = np.zeros(m, dtype=bool), np.full(m, np.nan), list[Rejection | None]([None] * m)
    parts: list[SolvedComponent] = []
    unplaced: list[int] = []
    failures: list[str] = []
    size = np.bincount(label)
    for number in range(len(size)):
        members = np.flatnonzero(label == number)
        edges = np.flatnonzero(label[problem.i] == number) if m else np.zeros(0, dtype=np.int64)
        part_problem = problem.restricted(members)
        if len(members) == 1 and n > 1 and not is_placed_alone(part_problem):
            unplaced += members.tolist()
            continue
        try:
            part = solve_component(part_problem, options)
        except BackendError as refused:
            if len(members) == n:
                raise
            for e in edges.tolist():
                reasons[e] = Rejection(LinkCheck.SOLVED_PART)
            failures.append(f"{format_keys(members.tolist(), problem.name)} could not be solved: {refused}")
            warnings += failures[-1:]
            continue
        w_T[members], component[members] = part.w_T, len(parts)
        if covariances is not None and part.covariances is not None:
            covariances[members] = part.covariances
        kept[edges], residual[edges] = part.kept, part.residual
        for e, why in zip(edges.tolist(), part.reasons, strict=True):
            reasons[e] = why
        failures += [part.failure] if part.failure else []
        warnings += [line for line in (part.failure, *part.warnings) if line]
        parts.append(part)
    unobserved = [part.unobserved for part in parts if part.unobserved]
    if unplaced:
        unobserved.append(f"{format_keys(unplaced, problem.name)} not placed: no edge and no position")
    _LOG.info("%d poses in %d parts, %d of %d edges kept", n, len(parts), np.count_nonzero(kept), m)
    return Solution(
        w_T_b=w_T,
        covariances=covariances,
        component=component,
        edge_kept=kept,
        edge_reason=tuple(reasons),
        edge_residual=residual,
        error=sum((part.error for part in parts), 0.0),
        iterations=max((part.iterations for part in parts), default=0),
        converged=not failures,
        reasons=_reasons(parts, unplaced, failures),
        unobserved=tuple(unobserved),
        warnings=tuple(warnings),
        contradictions=tuple(line for part in parts for line in part.contradictions),
        disputed_odometry=tuple(line for part in parts for line in part.disputed_odometry),
    )


def _reasons(parts: list[SolvedComponent], unplaced: list[int], failures: list[str]) -> tuple[str, ...]:
    reasons = []
    if len(parts) > 1:
        reasons.append(f"{len(parts)} parts are not connected to each other")
    if unplaced:
        reasons.append(f"{counted(len(unplaced), 'pose')} could not be placed")
    reasons += [direction for part in parts for direction in part.open]
    reasons += [doubt for part in parts for doubt in part.doubts]
    return (*reasons, *failures[:1])
