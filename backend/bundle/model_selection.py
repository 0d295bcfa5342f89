"""The model of the cameras that the evidence prefers: the lens first, and then the shutter."""

from __future__ import annotations

from dataclasses import replace

import gtsam

from backend.bundle.lens_choice import fisheye_by_evidence
from backend.bundle.problem import BundleProblem, NoiseLevels, Variables
from backend.bundle.rolling_shutter import (
    ReadoutEstimate,
    ReadoutTest,
    freed_readout,
    readout_estimate,
    readout_test,
)
from backend.bundle.rounds import Solved, solve_rounds
from backend.errors import BackendError
from backend.pose_graph.descent import OnStep


def solve_best_model(
    problem: BundleProblem, at: Variables, noise: NoiseLevels, on_step: OnStep | None
) -> tuple[Solved, ReadoutEstimate | None]:
    """Solve from the variables ``at``, again with each model that the evidence prefers to the one before.

    The read-out time is None where nothing is known of how the rows were exposed. Raises ``BackendError`` if
    the problem cannot be solved.
    """
    solved, start = solve_rounds(problem, at, noise, at.values, on_step), at.values
    fisheye = fisheye_by_evidence(solved.optimum, solved.minimum.error, start)
    if fisheye is not None:
        solved = _solved_again(solved, *fisheye, start, on_step)
    test = readout_test(solved.optimum)
    solved, test = _with_rolling_shutter(solved, test, start, on_step) or (solved, test)
    return solved, readout_estimate(solved.optimum, test)


def _with_rolling_shutter(
    solved: Solved, test: ReadoutTest | None, start: gtsam.Values, on_step: OnStep | None
) -> tuple[Solved, ReadoutTest] | None:
    """Return the rounds with the read-out time as a variable, and their test; None where it stays fixed."""
    try:
        freed = freed_readout(solved.optimum, test)
        if freed is None:
            return None
        rolling = _solved_again(solved, *freed, start, on_step)
        found = readout_test(rolling.optimum)
    except BackendError:  # a read-out time without a solution is no evidence against the fixed one
        return None
    return (rolling, found) if found is not None and found.refutes_fixed else None


def _solved_again(
    solved: Solved, problem: BundleProblem, at: Variables, start: gtsam.Values, on_step: OnStep | None
) -> Solved:
    """Return the rounds of another model, which begin with the noise of the solved one."""
    again = solve_rounds(problem, at, solved.optimum.noise, start, on_step)
    return replace(again, iterations=solved.iterations + again.iterations)
