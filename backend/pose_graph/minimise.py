"""Minimise a nonlinear factor graph one step at a time, so that it can be watched, stopped and trusted.

gtsam answers a bad graph with the initial guess, with NaN, or by ending the interpreter. Here what can be
known is checked before and after, each step is taken from Python (Ctrl-C works between steps), Gauss-Newton
hands over to Levenberg-Marquardt where the error rises, and Cholesky to QR where it calls a long chain
singular.
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
from backend.pose_graph.elimination import set_ordering
from backend.pose_graph.observability import unobserved

OnStep = Callable[[int, float], None]
Name = Callable[[int], str]

MOST_ITERATIONS = 100
RELATIVE_TOLERANCE = 1e-5
"""A step that lowers the error by a smaller share is the last."""
_ABSOLUTE_TOLERANCE = 1e-7
_GROWTH = 1e-6
_MODEL_SHARE = 0.2
"""A step ends at the minimum of a linear model. Where the error there is what the model promised, to within
this share of the tolerance, what curvature is left cannot lower it by more: the confirming step is saved. It
must also be a hundred times closer than one step before, so that a chance agreement is not taken for one."""


@dataclass(frozen=True)
class OptimizationResult:
    """Where the descent ended."""

    values: gtsam.Values
    error: float
    """Half the squared whitened residuals (robust losses where the graph has them)."""
    initial_error: float
    iterations: int
    converged: bool
    reason: str
    """Why it ended, in words."""


def minimise(
    graph: gtsam.NonlinearFactorGraph,
    initial: gtsam.Values,
    *,
    max_iterations: int = MOST_ITERATIONS,
    relative_tolerance: float = RELATIVE_TOLERANCE,
    on_step: OnStep | None = None,
    time_limit_s: float | None = None,
    common: int | None = None,
) -> OptimizationResult:
    """Gauss-Newton while the error falls, Levenberg-Marquardt from the best point on where it rises.

    ``common``: a variable that next to all others share. ``on_step(iteration, error)`` is called after each
    step; what it raises passes through. Raises
    ``BackendError`` where the graph or the start is not finite, a part of the graph is tied to nothing, or a
    direction is not observed (named).
    """
    check(graph, initial)
    deadline = math.inf if time_limit_s is None else time.monotonic() + time_limit_s
    limits = (max_iterations, relative_tolerance, on_step, deadline)
    first = gauss_newton(graph, initial, *limits, common=common)
    if first.converged or first.iterations >= max_iterations or time.monotonic() >= deadline:
        return first
    return levenberg_marquardt(graph, first, *limits, common)


def check(graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values) -> None:
    """Refuse what gtsam would not survive or silently accept. Raises ``BackendError``."""
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
    graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values, solver: str, name: Name, common: int | None
) -> gtsam.GaussNewtonOptimizer:
    """gtsam's optimizer, which evaluates the graph once: refused where that is not finite."""
    params = gtsam.GaussNewtonParams()
    params.setLinearSolverType(solver)
    set_ordering(params, graph, initial.size(), common)
    try:
        optimizer = gtsam.GaussNewtonOptimizer(graph, initial, params)
    except (RuntimeError, ValueError, TypeError, IndexError) as error:
        raise BackendError(f"the graph cannot be evaluated: {first_line(error)}") from error
    if not math.isfinite(optimizer.error()):
        raise BackendError(_not_finite(graph, initial, name))
    return optimizer


def _not_finite(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, name: Name) -> str:
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
    common: int | None = None,
) -> OptimizationResult:
    """Undamped steps while the error falls; ``converged`` is False at the best point where one raised it.

    The graph must have passed ``check``. Raises ``BackendError`` where a direction is not observed.
    """
    limits = (max_iterations, relative_tolerance, on_step, deadline, name, common)
    try:
        return _gauss_newton(graph, initial, "MULTIFRONTAL_CHOLESKY", *limits)
    except _SingularError:
        pass
    try:
        # Cholesky squares the condition number: a long well-posed chain fails with it, not with QR.
        return _gauss_newton(graph, initial, "MULTIFRONTAL_QR", *limits)
    except _SingularError as singular:
        raise BackendError(_singular_message(graph, singular, name)) from singular


class _SingularError(Exception):
    """The linear system has no unique answer at ``values``."""

    def __init__(self, message: str, values: gtsam.Values) -> None:
        super().__init__(message)
        self.values = values


def _singular_message(graph: gtsam.NonlinearFactorGraph, singular: _SingularError, name: Name) -> str:
    sentences = unobserved(graph, singular.values, name)
    if sentences:
        return "under-determined: " + "; ".join(sentences)
    return f"under-determined: {translated(str(singular), name)}"


def translated(message: str, name: Name = key_name) -> str:
    """gtsam's account of a singular system in the words of the flight."""
    found = re.search(r"near variable\s+(\d+)", message)
    if not found:
        return first_line(RuntimeError(message))
    return f"the measurements around {name(int(found.group(1)))} leave a direction open"


def _gauss_newton(
    graph: gtsam.NonlinearFactorGraph,
    initial: gtsam.Values,
    solver: str,
    max_iterations: int,
    relative_tolerance: float,
    on_step: OnStep | None,
    deadline: float,
    name: Name,
    common: int | None,
) -> OptimizationResult:
    optimizer = _optimizer(graph, initial, solver, name, common)
    start = error = float(optimizer.error())
    gap = math.inf
    iteration = 0

    def ended(converged: bool, reason: str) -> OptimizationResult:
        return OptimizationResult(
            gtsam.Values(optimizer.values()), error, start, iteration, converged, reason
        )

    for iteration in range(1, max_iterations + 1):
        # A copy: gtsam hands out a view of a state that the next step frees.
        best = gtsam.Values(optimizer.values())
        try:
            linear = optimizer.iterate()
        except GTSAM_ERRORS as exception:
            raise _SingularError(str(exception), best) from exception
        previous, error = error, float(optimizer.error())
        if not error <= previous * (1 + _GROWTH) + _ABSOLUTE_TOLERANCE:
            return OptimizationResult(best, previous, start, iteration, False, "the error rose")
        if on_step is not None:
            on_step(iteration, error)
        if _settled(previous, error, relative_tolerance):
            return ended(True, "converged")
        before, gap = gap, abs(error - float(linear.error(best.localCoordinates(optimizer.values()))))
        del linear  # larger than the graph: not beside the next one
        if gap <= _MODEL_SHARE * relative_tolerance * error and gap <= 0.01 * before < math.inf:
            return ended(True, "converged")
        if time.monotonic() >= deadline:
            return ended(False, "the time limit was reached")
    return ended(False, f"{max_iterations} iterations done")


def levenberg_marquardt(
    graph: gtsam.NonlinearFactorGraph,
    start: OptimizationResult,
    max_iterations: int,
    relative_tolerance: float,
    on_step: OnStep | None,
    deadline: float,
    common: int | None = None,
) -> OptimizationResult:
    """Damped steps, which never raise the error. The graph must have passed ``check``."""
    params = gtsam.LevenbergMarquardtParams()
    set_ordering(params, graph, start.values.size(), common)
    params.setlambdaUpperBound(1e10)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start.values, params)
    error, iteration = float(optimizer.error()), start.iterations

    def ended(converged: bool, reason: str) -> OptimizationResult:
        return OptimizationResult(
            gtsam.Values(optimizer.values()), error, start.initial_error, iteration, converged, reason
        )

    while iteration < max_iterations:
        iteration += 1
        try:
            optimizer.iterate()
        except GTSAM_ERRORS as exception:
            return ended(False, f"the linear solver failed: {first_line(exception)}")
        previous, error = error, float(optimizer.error())
        if not math.isfinite(error):
            raise BackendError("the solve left the finite numbers: a measurement is not finite")
        if on_step is not None:
            on_step(iteration, error)
        if optimizer.lambda_() >= 1e10:
            return ended(False, "no step lowers the error further")
        if _settled(previous, error, relative_tolerance):
            return ended(True, "converged")
        if time.monotonic() >= deadline:
            return ended(False, "the time limit was reached")
    return ended(False, f"{max_iterations} iterations done")


def _settled(previous: float, error: float, relative_tolerance: float) -> bool:
    decrease = previous - error
    return decrease <= _ABSOLUTE_TOLERANCE or decrease <= relative_tolerance * previous
