"""The iterations of a nonlinear least-squares solver: steps until the error settles, and their limits."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from backend.errors import BackendError
from backend.wording import counted

OnStep = Callable[[int, float], None]

_ABSOLUTE_TOLERANCE = 1e-7
_GROWTH = 1e-6
_MODEL_SHARE = 0.2
"""Tolerance, as a fraction of the relative tolerance, between the error and its linear prediction.
Within it the remaining nonlinearity cannot lower the error further, and the confirming step is skipped. The
difference must also be a hundred times smaller than one step before, to exclude a coincidence."""
MAX_DAMPING = 1e10
"""Damping at which no step is left that could lower the error."""


class GaussNewtonSteps(Protocol):
    """A least-squares problem at its current point."""

    @property
    def error(self) -> float:
        """Half the sum of squared whitened residuals, with the robust losses."""

    def step(self) -> Callable[[], float]:
        """Take an undamped step; return a function for the error that the linear model predicted."""

    def revert(self) -> None:
        """Return to the point before the last step."""


class DampedSteps(Protocol):
    """The same with steps that never raise the error."""

    @property
    def error(self) -> float:
        """Half the sum of squared whitened residuals, with the robust losses."""

    @property
    def damping(self) -> float:
        """Damping of the next step."""

    def step(self) -> None:
        """Take the least damped step that lowers the error. Raises ``LinearSolverError``."""


class LinearSolverError(Exception):
    """The linear system of a damped step could not be solved."""


@dataclass(frozen=True)
class Limits:
    """When to stop."""

    max_iterations: int
    relative_tolerance: float
    on_step: OnStep | None
    deadline: float
    """On the monotonic clock."""

    @property
    def passed(self) -> bool:
        """Whether the time is over."""
        return time.monotonic() >= self.deadline

    def report(self, iteration: int, error: float) -> None:
        """Call ``on_step``."""
        if self.on_step is not None:
            self.on_step(iteration, error)


@dataclass(frozen=True)
class Outcome:
    """How the iterations ended."""

    error: float
    initial_error: float
    iterations: int
    converged: bool
    reason: str
    """Reason for the end of the iterations, in words."""


def descend(steps: GaussNewtonSteps, limits: Limits) -> Outcome:
    """Take undamped steps while the error falls; if a step raises it, return to the best point."""
    start = error = steps.error
    gap = math.inf
    for iteration in range(1, limits.max_iterations + 1):
        predicted = steps.step()
        previous, error = error, steps.error
        if not error <= previous * (1 + _GROWTH) + _ABSOLUTE_TOLERANCE:
            steps.revert()
            return Outcome(previous, start, iteration, False, "the error rose")
        limits.report(iteration, error)
        if _is_converged(previous, error, limits.relative_tolerance):
            return Outcome(error, start, iteration, True, "converged")
        before, gap = gap, abs(error - predicted())
        if gap <= _MODEL_SHARE * limits.relative_tolerance * error and gap <= 0.01 * before < math.inf:
            return Outcome(error, start, iteration, True, "converged")
        if limits.passed:
            return Outcome(error, start, iteration, False, "the time limit was reached")
        del predicted  # It holds a system larger than the graph: free it before the next one.
    return Outcome(
        error, start, limits.max_iterations, False, f"{counted(limits.max_iterations, 'iteration')} done"
    )


def descend_damped(steps: DampedSteps, limits: Limits, start: Outcome) -> Outcome:
    """Continue with damped steps. Raises ``BackendError`` if the error is not finite."""
    error, iteration = steps.error, start.iterations

    def ended(converged: bool, reason: str) -> Outcome:
        return Outcome(error, start.initial_error, iteration, converged, reason)

    while iteration < limits.max_iterations:
        iteration += 1
        try:
            steps.step()
        except LinearSolverError as exception:
            return ended(False, f"the linear solver failed: {exception}")
        previous, error = error, steps.error
        if not math.isfinite(error):
            raise BackendError("the solve left the finite numbers: a measurement is not finite")
        limits.report(iteration, error)
        if steps.damping >= MAX_DAMPING:
            return ended(False, "no step lowers the error further")
        if _is_converged(previous, error, limits.relative_tolerance):
            return ended(True, "converged")
        if limits.passed:
            return ended(False, "the time limit was reached")
    return ended(False, f"{counted(limits.max_iterations, 'iteration')} done")


def _is_converged(previous: float, error: float, relative_tolerance: float) -> bool:
    decrease = previous - error
    return decrease <= _ABSOLUTE_TOLERANCE or decrease <= relative_tolerance * previous
