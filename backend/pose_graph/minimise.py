"""Minimise a nonlinear factor graph step by step, with checks, progress reports and a time limit.

gtsam answers an invalid graph with the initial guess, with NaN, or by aborting the interpreter. This module
checks the graph before and after, and takes each step from Python (Ctrl-C works between steps). It falls back
from Gauss-Newton to Levenberg-Marquardt if the error rises, and from Cholesky to QR for a long chain that
Cholesky finds singular.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from backend.errors import GTSAM_ERRORS, BackendError, first_line
from backend.gauge import format_keys, graph_components, key_name
from backend.pose_graph.descent import (
    MAX_DAMPING,
    Limits,
    LinearSolverError,
    OnStep,
    Outcome,
    descend,
    descend_damped,
)
from backend.pose_graph.elimination import set_ordering
from backend.pose_graph.observability import unobserved

Name = Callable[[int], str]

MAX_ITERATIONS = 100
RELATIVE_TOLERANCE = 1e-5
"""The solver stops after a step whose relative decrease of the error is smaller."""


@dataclass(frozen=True)
class OptimizationResult(Outcome):
    """Result of a minimisation."""

    values: gtsam.Values


def minimise(
    graph: gtsam.NonlinearFactorGraph,
    initial: gtsam.Values,
    *,
    max_iterations: int = MAX_ITERATIONS,
    relative_tolerance: float = RELATIVE_TOLERANCE,
    on_step: OnStep | None = None,
    time_limit_s: float | None = None,
) -> OptimizationResult:
    """Minimise with Gauss-Newton; if the error rises, continue from the best point with Levenberg-Marquardt.

    ``on_step(iteration, error)`` is called after each step; its exceptions propagate. Raises ``BackendError``
    if the graph or the initial guess is not finite, a component has no unary factor, or a direction is
    unobserved (the message names it).
    """
    check(graph, initial)
    deadline = math.inf if time_limit_s is None else time.monotonic() + time_limit_s
    limits = (max_iterations, relative_tolerance, on_step, deadline)
    first = gauss_newton(graph, initial, *limits)
    if first.converged or first.iterations >= max_iterations or time.monotonic() >= deadline:
        return first
    return levenberg_marquardt(graph, first, *limits)


def check(graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values) -> None:
    """Reject a graph that would crash gtsam or that it would silently accept. Raises ``BackendError``."""
    if graph.size() == 0 or initial.size() == 0:
        raise BackendError("the graph is empty: there is nothing to solve")
    parts = graph_components(graph)
    known = set(initial.keys())
    used = {key for part in parts.parts for key in part}
    if used - known:
        raise BackendError(f"{format_keys(used - known)} has measurements but no initial value; give it one")
    if known - used:
        raise BackendError(f"{format_keys(known - used)} has a value but no measurement; leave it out")
    if parts.floating:
        where = "; ".join(format_keys(part) for part in parts.floating[:4])
        raise BackendError(f"nothing ties {where} to the world: hold one pose of each connected part")
    _check_values(initial)


def _check_values(values: gtsam.Values) -> None:
    keys = list(values.keys())
    for extract in (gtsam.utilities.extractPose3, gtsam.utilities.extractPose2):
        rows = np.asarray(extract(values))
        if len(rows) and not np.isfinite(rows).all():
            bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))[0]
            # Positions of rows are positions of keys only where all values are poses.
            who = key_name(keys[bad]) if len(rows) == len(keys) else "a pose"
            raise BackendError(f"the initial value of {who} is not finite; give it a start")


def _optimizer(
    graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values, solver: str, name: Name
) -> gtsam.GaussNewtonOptimizer:
    """Create gtsam's optimizer. Raises ``BackendError`` if the initial error is not finite."""
    params = gtsam.GaussNewtonParams()
    params.setLinearSolverType(solver)
    set_ordering(params, graph, initial.size())
    try:
        optimizer = gtsam.GaussNewtonOptimizer(graph, initial, params)
    except (RuntimeError, ValueError, TypeError, IndexError) as error:
        raise BackendError(f"the graph cannot be evaluated: {first_line(error)}") from error
    if not math.isfinite(optimizer.error()):
        raise BackendError(not_finite(graph, initial, name))
    return optimizer


def not_finite(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, name: Name = key_name) -> str:
    """Name the first factor whose error is not finite."""
    for k in range(graph.size()):
        factor = graph.at(k)
        if factor is not None and not math.isfinite(factor.error(values)):
            keys = ", ".join(name(key) for key in list(factor.keys()))
            kind = type(factor).__name__
            return f"the {kind} on {keys} has no finite error: look for NaN, infinite or zero figures in it"
    return "the error of the graph overflows: the start is too far from the measurements"


def gauss_newton(
    graph: gtsam.NonlinearFactorGraph,
    initial: gtsam.Values,
    max_iterations: int,
    relative_tolerance: float,
    on_step: OnStep | None,
    deadline: float,
    name: Name = key_name,
) -> OptimizationResult:
    """Take undamped steps while the error falls; if a step raises it, return the best point, not converged.

    The graph must have passed ``check``. Raises ``BackendError`` if a direction is unobserved.
    """
    limits = Limits(max_iterations, relative_tolerance, on_step, deadline)
    try:
        return _gauss_newton(_Steps(graph, initial, "MULTIFRONTAL_CHOLESKY", name), limits)
    except _SingularError:
        pass
    try:
        # Cholesky squares the condition number: a long well-posed chain fails with it, not with QR.
        return _gauss_newton(_Steps(graph, initial, "MULTIFRONTAL_QR", name), limits)
    except _SingularError as singular:
        raise BackendError(_singular_message(graph, singular, name)) from singular


class _SingularError(Exception):
    """The linear system at ``values`` has no unique solution."""

    def __init__(self, message: str, values: gtsam.Values) -> None:
        super().__init__(message)
        self.values = values


def _singular_message(graph: gtsam.NonlinearFactorGraph, singular: _SingularError, name: Name) -> str:
    sentences = unobserved(graph, singular.values, name)
    if sentences:
        return "under-determined: " + "; ".join(sentences)
    return f"under-determined: {translated(str(singular), name)}"


def translated(message: str, name: Name = key_name) -> str:
    """Translate gtsam's message about a singular system to names of keyframes."""
    found = re.search(r"near variable\s+(\d+)", message)
    if not found:
        return first_line(RuntimeError(message))
    return f"the measurements around {name(int(found.group(1)))} leave a direction open"


class _Steps:
    """Undamped steps of gtsam's optimizer."""

    def __init__(
        self, graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values, solver: str, name: Name
    ) -> None:
        self._optimizer = _optimizer(graph, initial, solver, name)
        self._before = self.values = initial
        self.error = float(self._optimizer.error())

    def step(self) -> Callable[[], float]:
        self._before = before = self.values
        try:
            linear = self._optimizer.iterate()
        except GTSAM_ERRORS as exception:
            raise _SingularError(str(exception), before) from exception
        # A copy: gtsam returns a view of a state that the next step frees.
        self.values = after = gtsam.Values(self._optimizer.values())
        self.error = float(self._optimizer.error())
        return lambda: float(linear.error(before.localCoordinates(after)))

    def revert(self) -> None:
        self.values = self._before


def _gauss_newton(steps: _Steps, limits: Limits) -> OptimizationResult:
    outcome = descend(steps, limits)
    return OptimizationResult(**vars(outcome), values=steps.values)


class _DampedSteps:
    """Steps of gtsam's Levenberg-Marquardt optimizer."""

    def __init__(self, graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values) -> None:
        params = gtsam.LevenbergMarquardtParams()
        set_ordering(params, graph, initial.size())
        params.setlambdaUpperBound(MAX_DAMPING)
        self._optimizer = gtsam.LevenbergMarquardtOptimizer(graph, initial, params)

    @property
    def error(self) -> float:
        return float(self._optimizer.error())

    @property
    def damping(self) -> float:
        return float(self._optimizer.lambda_())

    @property
    def values(self) -> gtsam.Values:
        return gtsam.Values(self._optimizer.values())

    def step(self) -> None:
        try:
            self._optimizer.iterate()
        except GTSAM_ERRORS as exception:
            raise LinearSolverError(first_line(exception)) from exception


def levenberg_marquardt(
    graph: gtsam.NonlinearFactorGraph,
    start: OptimizationResult,
    max_iterations: int,
    relative_tolerance: float,
    on_step: OnStep | None,
    deadline: float,
) -> OptimizationResult:
    """Take damped steps, which never raise the error. The graph must have passed ``check``."""
    steps = _DampedSteps(graph, start.values)
    limits = Limits(max_iterations, relative_tolerance, on_step, deadline)
    outcome = descend_damped(steps, limits, start)
    return OptimizationResult(**vars(outcome), values=steps.values)
