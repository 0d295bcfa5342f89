"""Reported motion in the graph: the errors at the nodes of the path, and the constants of the flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import gtsam
import numpy as np
from gtsam.symbol_shorthand import E as ERROR
from numpy.typing import NDArray

from backend.bundle.path_nodes import PathNodes, ends
from backend.bundle.pose_side_factors import PoseSideFactors
from backend.bundle.reported.factor import (
    BIAS,
    CHANNELS,
    CONSTANTS_SIZE,
    DRIFT,
    GAINS,
    LAG,
    REPORTED,
    IntervalNoise,
    ReportedKeys,
    planar_motion,
    reported_factor,
)
from backend.bundle.reported.integrate import ReportedInterval, integrate_reported
from backend.bundle.reported.noise import Step, identify_reported_noise
from backend.bundle.world import WorldTransform
from backend.measurements import Measurements, PinholeModel, ReportedMotion, ReportedNoise
from backend.robust import robust_unit

Array = NDArray[np.float64]

_FREE_GAIN = 1.0
"""Standard deviation of the gains where a height sensor tells the lengths. A velocity by optical flow is the
flow times the height of the same or another sensor, so that it is no second measurement of the scale."""
_COMMON = 0.8
"""Share of the variance of the gains that both axes have in common, as a height that is too small makes both
velocities too small. Beside it the gains of an AR.Drone 2 differ by 5 %, half of their standard deviation."""
_JUMP = 3.0
"""Change of an error that is a jump, in the standard deviations of changes. When it happened in a gap is then
unknown, and the error of the gap's length larger than by a steady change."""
_OF_CHANNELS = ("velocity", "velocity", "attitude")
"""Instrument of each channel, and of its error that fades."""
_OF_CONSTANTS = ("velocity",) * 4 + ("attitude", "velocity")
"""Instrument of each constant."""
_MOST_GAIN = 2.0
"""Largest ratio of reported and true speed, or of true and reported one: gains and noise explain less, and
another unit or sign more."""


@dataclass(frozen=True)
class ReportedPart:
    """Integrated readings of a refinement."""

    motion: ReportedMotion
    path: PathNodes
    intervals: tuple[ReportedInterval, ...]
    gain_std: float
    jumps: Mapping[int, Array] = field(default_factory=dict)
    """First node of an interval -> change (3,) of the error that fades, in its standard deviations, where it
    is larger than by chance."""

    @staticmethod
    def of(measurements: Measurements, camera: PinholeModel) -> ReportedPart | None:
        """Integrate the readings of the measurements; None without any between two nodes."""
        motion = measurements.reported
        if motion is None:
            return None
        path = PathNodes.of(measurements, camera)
        intervals = integrate_reported(motion, path.stamps_s)
        has_lengths = measurements.ranges or measurements.positions
        gain_std = max(motion.gain_std, _FREE_GAIN) if has_lengths else motion.gain_std
        return ReportedPart(motion, path, intervals, gain_std) if intervals else None

    def start(self, poses: gtsam.Values) -> gtsam.Values:
        """Return the variables with initial frames, errors and constants."""
        values = self.path.placed(poses)
        for k in ends(self.intervals):
            values.insert(ERROR(k), np.zeros(CHANNELS))
        values.insert(REPORTED, nominal_constants())
        return values

    def updated(self, values: gtsam.Values, noise: ReportedNoise) -> ReportedPart:
        """Return the part with the focal lengths of the variables, where these are estimated, and with the
        jumps of the errors, whose ``noise`` was assumed."""
        jumps = {}
        for one in self.intervals:
            kept = np.exp(-one.lasts_s / np.array(noise.time_s))
            change = values.atVector(ERROR(one.j)) - values.atVector(ERROR(one.i))
            change[np.abs(change) < _JUMP * np.sqrt(2 * (1 - kept))] = 0.0
            if change.any():
                jumps[one.i] = change
        return replace(self, path=self.path.calibrated(values), jumps=jumps)

    def noise(self, values: gtsam.Values, transform: WorldTransform) -> ReportedNoise:
        """Return the noise that the poses show."""
        return identify_reported_noise(self._steps(values, transform), self.path.stamps_s, self.motion.noise)

    def length_ratio(self, values: gtsam.Values, transform: WorldTransform) -> float:
        """Return reported lengths over those of the poses, the median of the faster half of the intervals."""
        steps = self._steps(values, transform)
        lasts_s = np.array([step.interval.lasts_s for step in steps])
        true = np.array([np.linalg.norm(step.moved_m) for step in steps]) / lasts_s
        read = np.array([abs(step.interval.moved) for step in steps]) / lasts_s
        fast = true >= np.median(true)
        return float(np.median(read[fast] / np.maximum(true[fast], 1e-9)))

    def damage(self, values: gtsam.Values, transform: WorldTransform) -> str:
        """Describe why the readings cannot be right, in words; empty if they can be."""
        gains = dict(zip(("forward", "left"), values.atVector(REPORTED)[GAINS].tolist(), strict=True))
        # Where the velocity alone tells the scale, the scale may follow it to any value.
        gains["over ground"] = self.length_ratio(values, transform)
        for direction, gain in gains.items():
            if not 1 / _MOST_GAIN < gain < _MOST_GAIN:
                return f"its velocity {direction} would be {gain:.2g} times that of the pictures"
        return ""

    def _steps(self, values: gtsam.Values, transform: WorldTransform) -> list[Step]:
        poses = [transform.body_pose(values.atPose3(key)) for key in self.path.keys]
        found = []
        for one in self.intervals:
            motion = planar_motion(poses[one.i], poses[one.j], one.turn_rad)
            found.append(Step(one, motion.step, motion.turn_rad))
        return found


def nominal_constants() -> Array:
    """Return the constants (6,) of perfect readings."""
    constants = np.zeros(CONSTANTS_SIZE)
    constants[GAINS] = 1.0
    return constants


def _constants_covariance(motion: ReportedMotion, gain_std: float) -> Array:
    sigmas = np.empty(CONSTANTS_SIZE)
    sigmas[GAINS], sigmas[BIAS], sigmas[DRIFT], sigmas[LAG] = (
        gain_std,
        motion.bias_m_s,
        motion.drift_rad_s,
        motion.lag_s,
    )
    covariance = np.diag(sigmas**2)
    covariance[0, 1] = covariance[1, 0] = _COMMON * gain_std**2
    return covariance


def add_reported(
    pose_side: PoseSideFactors,
    part: ReportedPart,
    b_T_c: Array,
    noise: ReportedNoise,
) -> None:
    """Add the prior on the constants, the errors that fade, and the intervals."""
    motion = part.motion
    prior = gtsam.noiseModel.Gaussian.Covariance(_constants_covariance(motion, part.gain_std))
    constants = gtsam.PriorFactorVector(REPORTED, nominal_constants(), prior)
    pose_side.add("reported prior", constants, _OF_CONSTANTS)
    unit, nodes = gtsam.noiseModel.Unit.Create(CHANNELS), ends(part.intervals)
    start = gtsam.PriorFactorVector(ERROR(nodes[0]), np.zeros(CHANNELS), unit)
    pose_side.add("reported prior", start, _OF_CHANNELS)
    for i, j in pairwise(nodes):
        kept = np.exp((part.path.stamps_s[i] - part.path.stamps_s[j]) / np.array(noise.time_s))
        pose_side.add("reported prior", _fading((ERROR(i), ERROR(j)), kept), _OF_CHANNELS)
    rows = CHANNELS if motion.tells_turns else CHANNELS - 1
    model = robust_unit(rows)
    for one in part.intervals:
        keys = ReportedKeys(part.path.keys[one.i], part.path.keys[one.j], ERROR(one.i), ERROR(one.j))
        interval_noise = IntervalNoise.of(one, noise, part.jumps.get(one.i, np.zeros(CHANNELS)))
        factor = reported_factor(one, interval_noise, keys, b_T_c, rows, model)
        pose_side.add("reported interval", factor, _OF_CHANNELS[:rows])


def _fading(keys: tuple[int, int], kept: Array) -> gtsam.CustomFactor:
    """Return the factor of errors of unit variance of which the share ``kept`` (3,) is left at the end."""
    whitening = np.diag(1 / np.sqrt(1 - kept**2))
    before, after = -whitening * kept, whitening

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            jacobians[0], jacobians[1] = before, after
        return np.asarray(before @ values.atVector(keys[0]) + after @ values.atVector(keys[1]))

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(CHANNELS), list(keys), error)
