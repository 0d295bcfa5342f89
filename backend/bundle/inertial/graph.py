"""Inertial part of the graph: velocities and biases at the pictures, and the constants of the IMU.

The nodes are the keyframes and some pictures between them. The readings between two successive nodes make
one factor, so that every reading counts once.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B as BIAS
from gtsam.symbol_shorthand import V as VELOCITY
from numpy.typing import NDArray

from backend.bundle.inertial.factor import (
    ARM,
    DELAY,
    GAINS,
    GYRO_GAINS,
    IMU,
    IMU_SIZE,
    IntervalKeys,
    gain_effect,
    inertial_factor,
)
from backend.bundle.path_nodes import PathNodes, ends
from backend.bundle.pose_side_factors import PoseSideFactors
from backend.bundle.world import WorldTransform
from backend.measurements import Inertial, Measurements, PinholeModel
from backend.preintegration.intervals import (
    NO_BIAS,
    STATE_SIZE,
    ImuBias,
    InertialInterval,
    chains,
    preintegrate,
)
from backend.preintegration.limits import MOST_SIGMAS
from backend.robust import robust, robust_unit

Array = NDArray[np.float64]

_LETTERS = {ord(letter) for letter in "abfv"}
"""Letters of the keys of this part."""
_LEAST_WALK = 1e-6
"""Least random walk of a bias over its offset, per root second: none at all would be singular beside it."""
_NEAR_S = 0.3
"""Half the time over which a path is smoothed: the thrust of a small vehicle turns more slowly."""
_PARABOLA = 3
"""Coefficients of a parabola."""
_MOST_CUT = 0.25
"""Share of intervals that may be cut: where more do not fit, the others fit by chance."""


class InertialNoiseFactors(NamedTuple):
    """Factors on the nominal noise."""

    gyro: float = 1.0
    accel: float = 1.0
    frames: float = 1.0
    """That of the homographies of the pictures between keyframes."""


NOMINAL_INERTIAL_NOISE = InertialNoiseFactors()


@dataclass(frozen=True)
class InertialPart:
    """Integrated readings of a refinement, and the point at which they were linearised."""

    inertial: Inertial
    path: PathNodes
    intervals: tuple[InertialInterval, ...]
    """Between successive nodes, which they call by their place among all nodes."""
    bias: ImuBias
    delay_s: float
    """Delay of the stamps behind the readings that was taken out of the intervals."""
    by_gain: Mapping[int, Array]
    """First node of each interval -> `gain_effect` (6, 3)."""
    cut: frozenset[int] = frozenset()
    """First nodes of the intervals that were cut, because they do not fit the pictures."""

    @staticmethod
    def of(
        measurements: Measurements, camera: PinholeModel, poses: gtsam.Values, transform: WorldTransform
    ) -> InertialPart | None:
        """Integrate the readings of the measurements; None without any between two nodes.

        ``poses`` holds initial poses of the keyframes, and ``transform`` makes them metric.
        """
        inertial = measurements.inertial
        if inertial is None:
            return None
        path = PathNodes.of(measurements, camera)
        part = InertialPart(
            inertial=inertial,
            path=path,
            intervals=preintegrate(inertial, path.stamps_s),
            bias=NO_BIAS,
            delay_s=0.0,
            by_gain={},
        )
        if not part.intervals:
            return None
        return replace(part, by_gain=_gain_effects(part, path.metric_poses(path.placed(poses), transform)))

    def reintegrated(self, values: gtsam.Values, kept: NDArray[np.bool_]) -> InertialPart | None:
        """Integrate the ``kept`` (m,) intervals about the estimated delay and the mean of the biases.

        Returns None without any interval. The rates at the ends of an interval are noisy: multiplied by a
        delay that is not taken out of the stamps, their noise would be that of the factor.
        """
        cut = self.cut | {one.i for one, ok in zip(self.intervals, kept.tolist(), strict=True) if not ok}
        found = self.biases(values).mean(axis=0)
        bias = ImuBias(found[:3], found[3:])
        delay_s = self.delay_s + float(values.atVector(IMU)[DELAY])
        # Another delay may reach nodes beyond the readings, which have no velocity and no bias.
        known = {(one.i, one.j) for one in self.intervals}
        again = preintegrate(self.inertial, self.path.stamps_s - delay_s, bias, cut)
        intervals = tuple(one for one in again if (one.i, one.j) in known)
        if not intervals:
            return None
        path = self.path.calibrated(values)
        return replace(self, intervals=intervals, bias=bias, delay_s=delay_s, cut=cut, path=path)

    def biases(self, values: gtsam.Values) -> Array:
        """Return the biases (k, 6) of accelerometer and gyro at the ends of the intervals."""
        return np.array([values.atConstantBias(BIAS(k)).vector() for k in ends(self.intervals)])

    def start(self, poses: gtsam.Values, transform: WorldTransform) -> gtsam.Values:
        """Return the variables with initial frames, velocities, biases and constants."""
        values = self.path.placed(poses)
        velocity = _smoothed(self.path.stamps_s, self.path.metric_poses(values, transform)[:, :3, 3])[1]
        for k in ends(self.intervals):
            values.insert(VELOCITY(k), velocity[k])
            values.insert(BIAS(k), gtsam.imuBias.ConstantBias(self.bias.accel_m_s2, self.bias.gyro_rad_s))
        values.insert(IMU, _nominal_constants(self))
        return values

    def continued(self, values: gtsam.Values, before: InertialPart) -> gtsam.Values:
        """Return the variables of the part ``before`` it was integrated again, as variables of this one."""
        kept, constants = without_unused(values, self), values.atVector(IMU)
        constants[DELAY] += before.delay_s - self.delay_s
        kept.update(IMU, constants)
        return kept

    def damage(self, values: gtsam.Values, factors: InertialNoiseFactors) -> str:
        """Describe why the readings cannot be right, in words; empty if they can be.

        They do not fit where their noise, averaged over a second, is larger than a bias could be.
        """
        cut, count = len(self.cut), len(self.cut) + len(self.intervals)
        if cut > _MOST_CUT * count:
            return f"its readings do not fit over {cut} of {count} intervals"
        noise = self.inertial.noise
        accel, gyro = np.abs(self.biases(values)).max(axis=0).reshape(2, 3).max(axis=1)
        constants = np.abs(values.atVector(IMU))
        for name, found, std in (
            (
                "noise of the accelerometer [m/s²]",
                factors.accel * noise.accel_density,
                noise.accel_offset_m_s2,
            ),
            ("noise of the gyro [rad/s]", factors.gyro * noise.gyro_density, noise.gyro_offset_rad_s),
            ("bias of the accelerometer [m/s²]", accel, noise.accel_offset_m_s2),
            ("bias of the gyro [rad/s]", gyro, noise.gyro_offset_rad_s),
            ("error of the accelerometer's gain", constants[GAINS].max(), noise.gain_ratio),
            ("error of the gyro's gain", constants[GYRO_GAINS].max(), noise.gyro_gain_ratio),
        ):
            if found > MOST_SIGMAS * std:
                return f"the {name} would be {found:.2g}, and {std:.2g} is expected"
        return ""

    def keys(self, interval: InertialInterval) -> IntervalKeys:
        """Return the keys of the variables of an interval."""
        i, j = interval.i, interval.j
        return IntervalKeys(
            pose_i=self.path.keys[i],
            velocity_i=VELOCITY(i),
            pose_j=self.path.keys[j],
            velocity_j=VELOCITY(j),
            bias_i=BIAS(i),
            bias_j=BIAS(j),
        )


def _gain_effects(part: InertialPart, w_T_b: Array) -> dict[int, Array]:
    place, velocity = _smoothed(part.path.stamps_s, w_T_b[:, :3, 3])
    by_gain = {}
    for one in part.intervals:
        ends, lasts_s = [one.i, one.j], float(part.path.stamps_s[one.j] - part.path.stamps_s[one.i])
        by_gain[one.i] = gain_effect(w_T_b[one.i, :3, :3], place[ends], velocity[ends], lasts_s)
    return by_gain


def _smoothed(stamps_s: Array, place: Array) -> tuple[Array, Array]:
    """Return places and velocities (m, 3), each from the parabola through the places nearby.

    Noise of the places in the derivatives by the gains would make the estimated gains too small.
    """
    out = np.empty((2, *place.shape))
    for k, now_s in enumerate(stamps_s.tolist()):
        near = slice(*np.searchsorted(stamps_s, [now_s - _NEAR_S, now_s + _NEAR_S]).tolist())
        if near.stop - near.start < _PARABOLA:
            near = slice(max(k - 1, 0), k + 2)
        t = stamps_s[near] - now_s
        powers = t[:, None] ** np.arange(min(_PARABOLA, len(t)))
        out[:, k] = np.linalg.lstsq(powers, place[near], rcond=None)[0][:2]
    return out[0], out[1]


def without_unused(
    values: gtsam.Values, part: InertialPart | None = None, others: Collection[int] = ()
) -> gtsam.Values:
    """Return the variables without those that neither a factor of ``part`` touches nor ``others`` names."""
    used = set(others)
    if part is not None:
        used |= {key(k) for k in ends(part.intervals) for key in (VELOCITY, BIAS)} | {IMU, *part.path.keys}
    kept = gtsam.Values(values)
    for key in list(values.keys()):
        if gtsam.Symbol(key).chr() in _LETTERS and key not in used:
            kept.erase(key)
    return kept


def add_inertial(
    pose_side: PoseSideFactors,
    part: InertialPart,
    at: gtsam.Values,
    b_T_c: Array,
    factors: InertialNoiseFactors,
) -> None:
    """Add priors on biases and constants of the IMU, the homographies of pictures, and the intervals."""
    _add_biases(pose_side, part)
    constants = gtsam.noiseModel.Gaussian.Covariance(_constants_covariance(part.inertial))
    pose_side.add("inertial prior", gtsam.PriorFactorVector(IMU, _nominal_constants(part), constants))
    part.path.frames.add(pose_side, at, factors.frames)
    unit = robust_unit(STATE_SIZE)
    for interval in part.intervals:
        whitening = interval.whitening(factors.gyro, factors.accel)
        keys, by_gain = part.keys(interval), part.by_gain[interval.i]
        factor = inertial_factor(interval, whitening, by_gain, keys, b_T_c, unit)
        pose_side.add("inertial interval", factor)


def _add_biases(pose_side: PoseSideFactors, part: InertialPart) -> None:
    """Add the prior on the bias, once for all chains, and the walk of the bias between these.

    The walk goes on where readings are lost. It may jump across intervals that were cut. The robust loss lets
    it jump elsewhere too, where the readings show it.
    """
    noise, none = part.inertial.noise, gtsam.imuBias.ConstantBias()
    offsets = np.repeat([noise.accel_offset_m_s2, noise.gyro_offset_rad_s], 3)
    walks = np.maximum(np.repeat([noise.accel_walk, noise.gyro_walk], 3), _LEAST_WALK * offsets)
    runs = list(chains(part.intervals))
    first = gtsam.noiseModel.Diagonal.Sigmas(offsets)
    pose_side.add("inertial prior", gtsam.PriorFactorConstantBias(BIAS(runs[0][0].i), none, first))
    for before, after in pairwise(runs):
        left, right = before[-1].j, after[0].i
        walk = walks * np.sqrt(part.path.stamps_s[right] - part.path.stamps_s[left])
        jumps = any(left <= k < right for k in part.cut)
        model = robust(gtsam.noiseModel.Diagonal.Sigmas(np.hypot(walk, offsets if jumps else 0.0)))
        between = gtsam.BetweenFactorConstantBias(BIAS(left), BIAS(right), none, model)
        pose_side.add("inertial prior", between)


def _nominal_constants(part: InertialPart) -> Array:
    constants = np.zeros(IMU_SIZE)
    constants[ARM], constants[DELAY] = part.inertial.b_p_imu_m, -part.delay_s
    return constants


def _constants_covariance(inertial: Inertial) -> Array:
    noise = inertial.noise
    covariance = np.zeros((IMU_SIZE, IMU_SIZE))
    covariance[GAINS, GAINS] = noise.gain_ratio**2 * (np.eye(3) + 1) / 2
    covariance[ARM, ARM] = noise.arm_m**2 * np.eye(3)
    covariance[DELAY, DELAY] = noise.delay_s**2
    covariance[GYRO_GAINS, GYRO_GAINS] = noise.gyro_gain_ratio**2 * np.eye(3)
    return covariance
