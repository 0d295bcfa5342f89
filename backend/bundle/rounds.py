"""Rounds of a refinement: each solves, and then estimates the noise of the measurements from residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.bundle.checkpoints import minimum_of
from backend.bundle.factors import LOG_SCALE, SLOPE
from backend.bundle.graph import WORLD, BundleProblem, NoiseLevels, Variables, start_calibration
from backend.bundle.ground_below import over_ground
from backend.bundle.inertial.graph import without_unused
from backend.bundle.inertial.noise import estimate_inertial_noise
from backend.bundle.lens import is_uncertain
from backend.bundle.minimise import BundleMinimum, BundleOptimum, minimise_bundle
from backend.bundle.noise import TOLERANCE, estimate_noise, same_noise
from backend.bundle.position_redundancy import absorbed_positions
from backend.bundle.rolling_shutter import corrected_rows
from backend.bundle.world import WorldTransform
from backend.measurements import NO_REPORTED_NOISE, ReportedNoise
from backend.pose_graph.descent import OnStep

_BEFORE, _LAST = (30, 1e-3), (300, 1e-5)
"""Most iterations, and the change of the error at which they end, relative to it: of a round before the last,
and of the last. The error is half of a chi-square variable, and few observations make it flat, because of its
robust losses: two pictures of trees took up to 117 small steps, while maps of a block converge within 30."""

_ANY_SLOPE_RAD = 0.6
"""Standard deviation of a slope that may be any: twice of it is steeper than any ground that is mapped."""

_FAR = 3.0
"""Standard deviations of the relief beyond which heights have drawn the poses along."""


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
    camera, config = problem.camera, problem.config
    every = used = np.ones(len(problem.tracks.track), bool)
    first, iterations = noise, 0
    settled = False
    of_any_slope: int | None = None  # the round with a prior that any slope fits,
    of_any_height: int | None = None  # and that with one that any height of a point fits
    of_waves = False  # and whether the rounds have begun anew over ground that rises and falls
    for number in range(config.rounds):
        if number == 1 and is_uncertain(camera) and len(used) and not problem.self_calibrates:
            # Only now, as the lens is less certain than the poses of a poor initial guess.
            problem = replace(problem, self_calibrates=True, raised=None)
            at = start_calibration(at, camera)
            # What the stated lens does not explain is no outlier yet, and no noise.
            used, noise = every, _anew(first, noise)
        last = settled or number + 1 == config.rounds
        # From a level start, a hillside takes more steps than others to be found.
        limits = _LAST if last or number == of_any_slope else _BEFORE
        made_of = problem, noise, used, start
        cost, minimum = minimum_of(made_of, at, limits, minimise_bundle, on_step)
        at, iterations = minimum.at, iterations + minimum.iterations
        if last:
            break
        before = noise
        optimum = BundleOptimum(cost, at, minimum.structure, noise, used)
        factors, kept = estimate_inertial_noise(optimum)
        absorbed = absorbed_positions(optimum)
        level = number != of_any_height
        found = estimate_noise(problem, at, replace(noise, inertial=factors), used, absorbed, level)
        noise, used, at = found.noise, found.used, replace(at, point=found.point)
        problem = replace(problem, raised=found.raised)
        slope_rad = _slope_std_rad(problem, at)
        if slope_rad > (1.0 + TOLERANCE) * config.slope_std_rad and of_any_slope is None:
            # What the narrow prior does not explain is no outlier yet, and no noise.
            of_any_slope, slope_rad = number + 1, _ANY_SLOPE_RAD
            used, noise = every, _anew(first, noise)
            problem = replace(problem, raised=None)
        elif of_any_height is None and (number > 0 or not is_uncertain(camera)):
            high = noise.structure if found.raised.any() else noise.relief
            of_any_height = number + 1 if high > _FAR * before.relief else None
        noise = replace(noise, slope_rad=slope_rad)
        if number == 0:
            # Once, because levels of a grid would keep the rounds from settling.
            noise = replace(noise, reported=reported_noise(problem, at.values))
        settled = number > 0 and same_noise(before, noise) and bool(kept.all())
        problem, at = _reintegrated(problem, at, kept, before.reported)
        problem, at, same_rows = corrected_rows(problem, at, noise, used)
        problem, changed_m = over_ground(problem, at)
        settled = settled and same_rows and changed_m <= TOLERANCE * noise.range_m
        if settled and not of_waves and noise.height_prior > _FAR * first.height_prior:
            # Not before: at first, an attitude that is degrees off bends the map of flat ground too.
            of_waves, settled = True, False
            noise = replace(_over_waves(first, noise, at), slope_rad=slope_rad, reported=noise.reported)
        if of_any_height == number + 1:
            # The same of the relief. Structure has drawn the poses along until now.
            narrow, settled = (problem, at, noise, used), False
            used, noise = every, _over_waves(first, replace(noise, relief=high), at)
            problem = replace(problem, raised=None)
        elif of_any_height == number and not found.raised.any():
            # No structure: without a plane, an error of the lens may bend the map to any shape.
            (problem, at, noise, used), settled = narrow, False
    return Solved(BundleOptimum(cost, at, minimum.structure, noise, used), minimum, iterations)


def _anew(first: NoiseLevels, noise: NoiseLevels) -> NoiseLevels:
    """Return the noise of the start, with what is estimated of inertial and reported motion and the slope."""
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
    return problem.reported.noise(values, WorldTransform(values.atVector(WORLD), problem.camera.b_T_c))


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
