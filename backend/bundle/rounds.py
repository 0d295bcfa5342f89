"""Rounds of a refinement: each solves, and then estimates the noise of the measurements from residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, auto

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.bundle.checkpoints import minimum_of
from backend.bundle.factors import LOG_SCALE, SLOPE, WORLD
from backend.bundle.graph import start_calibration
from backend.bundle.ground_below import over_ground
from backend.bundle.inertial.graph import without_unused
from backend.bundle.inertial_noise import estimate_inertial_noise
from backend.bundle.lens import is_uncertain
from backend.bundle.minimise import COARSE, FINE, BundleCost, BundleMinimum, BundleOptimum, minimise_bundle
from backend.bundle.noise import TOLERANCE, estimate_noise, same_noise
from backend.bundle.problem import BundleProblem, NoiseLevels, Variables
from backend.bundle.rolling_shutter import corrected_rows
from backend.measurements import NO_REPORTED_NOISE, ReportedNoise
from backend.pose_graph.descent import OnStep

_ANY_SLOPE_RAD = 0.6
"""Standard deviation of a slope that may be any: twice of it is steeper than any ground that is mapped."""

_FAR = 3.0
"""Standard deviations of the relief beyond which heights have drawn the poses along."""


class _Prior(Enum):
    """Priors that may be too narrow: what they do not explain looks like noise, and like outliers.

    The rounds begin anew with a wider one, once for each.
    """

    SLOPE = auto()
    """Slope of the ground: in one round it may be any."""
    WAVES = auto()
    """Heights of points on the ground, which rises and falls as far as it was found to."""
    HEIGHT = auto()
    """Heights of all points: in one round they may be any."""


@dataclass(frozen=True)
class _Round:
    """Inputs of a round."""

    problem: BundleProblem
    at: Variables
    noise: NoiseLevels
    used: NDArray[np.bool_]
    """(m,) observations of the tracks that count."""

    def anew(self, noise: NoiseLevels) -> _Round:
        """Return the round with all observations and no raised points, at another ``noise``."""
        problem = replace(self.problem, raised=None)
        return replace(self, problem=problem, noise=noise, used=np.ones_like(self.used))


@dataclass(frozen=True)
class Solved:
    """The result of the last round."""

    optimum: BundleOptimum
    minimum: BundleMinimum
    iterations: int
    """Those of all rounds."""


def solve_rounds(
    problem: BundleProblem, at: Variables, noise: NoiseLevels, start: gtsam.Values, on_step: OnStep | None
) -> Solved:
    """Solve until the noise is settled, from the variables ``at``; ``start`` holds what nothing observes.

    Raises ``BackendError`` if the problem cannot be solved.
    """
    config, first, frees_lens = problem.config, noise, is_uncertain(problem.camera)
    now = narrow = _Round(problem, at, noise, np.ones(len(problem.tracks.track), bool))
    iterations, settled = 0, False
    wide: _Prior | None = None  # the prior of this round that anything fits,
    widened: set[_Prior] = set()  # and those with which the rounds have begun anew
    for number in range(config.rounds):
        if number == 1 and frees_lens and len(now.used) and not problem.self_calibrates:
            # Only now, as the lens is less certain than the poses of a poor initial guess.
            now = _with_free_lens(now.anew(_anew(first, now.noise)))
        last = settled or number + 1 == config.rounds
        # From a level start, a hillside takes more steps than others to be found.
        limits = FINE if last or wide is _Prior.SLOPE else COARSE
        cost = BundleCost.of(now.problem, now.noise, now.used, start)
        minimum = minimum_of(cost, start, now.at, limits, minimise_bundle, on_step)
        optimum = BundleOptimum(cost, minimum.at, minimum.structure)
        iterations += minimum.iterations
        if last:
            break
        before, was_wide = now.noise, wide
        now, kept = _estimated(optimum, level=wide is not _Prior.HEIGHT)
        has_structure = now.problem.has_structure
        high = now.noise.structure if has_structure else now.noise.relief
        wide = None
        if _Prior.SLOPE not in widened and now.noise.slope_rad > (1.0 + TOLERANCE) * config.slope_std_rad:
            wide = _Prior.SLOPE
            now = now.anew(replace(_anew(first, now.noise), slope_rad=_ANY_SLOPE_RAD))
        elif _Prior.HEIGHT not in widened and (number > 0 or not frees_lens) and high > _FAR * before.relief:
            wide = _Prior.HEIGHT
        if number == 0:
            # Once, because levels of a grid would keep the rounds from settling.
            now = replace(now, noise=replace(now.noise, reported=reported_noise(now.problem, now.at.values)))
        settled = number > 0 and same_noise(before, now.noise) and bool(kept.all())
        now, is_same = _about_found(now, kept, before.reported)
        settled = settled and is_same
        if settled and _Prior.WAVES not in widened and now.noise.height_prior > _FAR * first.height_prior:
            # Not before: at first, an attitude that is degrees off bends the map of flat ground too.
            widened.add(_Prior.WAVES)
            now, settled = replace(now, noise=_over_waves(first, now.noise, now.at)), False
        if wide is _Prior.HEIGHT:
            # Structure has drawn the poses along until now.
            narrow, settled = now, False
            now = now.anew(_over_waves(first, replace(now.noise, relief=high), now.at))
        elif was_wide is _Prior.HEIGHT and not has_structure:
            # Without a plane, an error of the lens may bend the map to any shape.
            now, settled = narrow, False
        widened |= {wide} if wide else set()
    return Solved(optimum, minimum, iterations)


def _with_free_lens(now: _Round) -> _Round:
    """Return the round with the calibration among its variables."""
    problem = replace(now.problem, self_calibrates=True)
    return replace(now, problem=problem, at=start_calibration(now.at, problem.camera))


def _estimated(optimum: BundleOptimum, level: bool) -> tuple[_Round, NDArray[np.bool_]]:
    """Return the round after an optimum as its residuals show it, and the inertial intervals (k,) to keep.

    ``level``: whether the fit has the ground at height zero.
    """
    factors, kept = estimate_inertial_noise(optimum)
    found = estimate_noise(optimum, level)
    at = replace(optimum.at, point=found.point)
    noise = replace(found.noise, inertial=factors, slope_rad=_slope_std_rad(optimum.problem, at))
    return _Round(replace(optimum.problem, raised=found.raised), at, noise, found.used), kept


def _about_found(now: _Round, kept: NDArray[np.bool_], assumed: ReportedNoise) -> tuple[_Round, bool]:
    """Return the round with its measurements as the variables found show them, and whether they are the same.

    The motion of the cameras bends their pictures, and the ground below shortens ranges. ``kept`` (k,) are
    the intervals of inertial readings to keep; the noise ``assumed`` is that of reported motion.
    """
    problem, at = _reintegrated(now.problem, now.at, kept, assumed)
    problem, at, same_rows = corrected_rows(problem, at, now.noise, now.used)
    problem, changed_m = over_ground(problem, at)
    is_same = same_rows and changed_m <= TOLERANCE * now.noise.range_m
    return replace(now, problem=problem, at=at), is_same


def _anew(first: NoiseLevels, noise: NoiseLevels) -> NoiseLevels:
    """Return the noise of the start, with what is estimated of inertial and reported motion and the slope.

    What the rounds before did not explain is no noise yet.
    """
    return replace(first, inertial=noise.inertial, reported=noise.reported, slope_rad=noise.slope_rad)


def _over_waves(first: NoiseLevels, noise: NoiseLevels, at: Variables) -> NoiseLevels:
    """Return the noise of the start, over ground that rises and falls as it was found to.

    What ground that was too flat does not explain is no noise of the attitude yet. A range is that of the
    ground below, which is off the level of the floor by its relief.
    """
    relief_m = noise.relief * float(np.exp(at.values.atVector(WORLD)[LOG_SCALE]))
    return replace(
        _anew(first, noise),
        range_m=float(np.hypot(first.range_m, relief_m)),
        relief=noise.relief,
        relief_inflation=noise.relief_inflation,
        structure=noise.structure,
    )


def _slope_std_rad(problem: BundleProblem, at: Variables) -> float:
    """Return the standard deviation of the slope of the ground that its two components show.

    It is the least one where nothing shows a larger one (empirical Bayes). With the least one alone, the
    attitudes and altitudes of a hillside would be taken for noise.
    """
    found = at.values.atVector(WORLD)[SLOPE]
    return max(problem.config.slope_std_rad, float(np.sqrt(np.mean(found**2))))


def reported_noise(problem: BundleProblem, values: gtsam.Values) -> ReportedNoise:
    """Return the noise of reported motion that the poses show."""
    if problem.reported is None:
        return NO_REPORTED_NOISE
    return problem.reported.noise(values, problem.transform(values))


def _reintegrated(
    problem: BundleProblem, at: Variables, kept: NDArray[np.bool_], noise: ReportedNoise
) -> tuple[BundleProblem, Variables]:
    """Integrate the ``kept`` intervals (k,) of inertial readings about the estimated biases and delay.

    ``noise`` of reported motion was assumed for the variables.
    """
    reported = None if problem.reported is None else problem.reported.updated(at.values, noise)
    problem, before = replace(problem, reported=reported), problem.inertial
    if before is None:
        return problem, at
    part = before.reintegrated(at.values, kept)
    others = () if reported is None else reported.path.keys
    values = without_unused(at.values, None, others) if part is None else part.continued(at.values, before)
    return replace(problem, inertial=part), replace(at, values=values)
