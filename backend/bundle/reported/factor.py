"""Factor of reported motion between two nodes, on camera poses in mean heights.

The error compares the integrated velocity with the step between the poses, in level axes along their mean
heading, and the reported turn with theirs. The variables of the errors are constants of the flight, and the
errors that fade at both ends. Gains belong to the step of the map, not to the readings: multiplied by a gain,
these could shrink their noise.

Source: derived; the mean and the variance of a Gauss-Markov process between two known ends are those of an
Ornstein-Uhlenbeck bridge (Barczy and Kern 2013).
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.bundle.factors import WORLD
from backend.bundle.reported.integrate import ReportedInterval
from backend.bundle.world import WorldTransform
from backend.measurements import ReportedNoise
from backend.whitening import whitening

Array = NDArray[np.float64]

CHANNELS = 3
"""Velocity forward, velocity left and yaw rate."""
GAINS, BIAS, DRIFT, LAG = slice(0, 2), slice(2, 4), 4, 5
"""Index of each number in the variable of the constants: gains, constant errors [m/s], drift of the yaw
[rad/s], lag of the velocities [s]."""
CONSTANTS_SIZE = 6
REPORTED = gtsam.symbol("r", 0)
"""Key of that variable."""
_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Turn of a quarter to the left."""


@dataclass(frozen=True)
class ReportedKeys:
    """Keys of the variables of an interval, in the order of the factor's Jacobians.

    Those of the world and of the constants follow, which all intervals share.
    """

    pose_i: int
    pose_j: int
    error_i: int
    error_j: int


@dataclass(frozen=True)
class IntervalNoise:
    """Noise of an interval."""

    whitening: Array
    """(3, 3)."""
    by_error: Array
    """(3,) integral of the error that fades, for each unit of its standard deviation at either end."""

    @staticmethod
    def of(
        interval: ReportedInterval, noise: ReportedNoise, jump: Array = np.zeros(CHANNELS)
    ) -> IntervalNoise:
        """Return the noise of an interval, given the errors at both ends.

        The error may ``jump`` (3,) at any time of the interval, in units of its standard deviation.
        """
        lasts_s = interval.lasts_s
        density, error, time_s = (np.array(row) for row in noise)
        share = np.tanh(lasts_s / (2 * time_s))
        between = 2 * (error * time_s) ** 2 * (lasts_s / time_s - 2 * share)
        between = np.maximum(between, (jump * error * lasts_s) ** 2 / 12)
        variance = density**2 * lasts_s + between
        covariance = np.diag(variance)
        # A turn that wanders between the ends moves the path aside: the variance of the mean of a bridge.
        aside = _QUARTER @ vector(interval.moved)
        covariance[:2, :2] += variance[2] / 12 * np.outer(aside, aside)
        return IntervalNoise(whitening(covariance), error * time_s * share)


def vector(number: complex) -> Array:
    """Return real and imaginary part (2,)."""
    return np.array([number.real, number.imag])


def _rotating(number: complex) -> Array:
    """Return the matrix (2, 2) that multiplies by a complex number."""
    return np.array([[number.real, -number.imag], [number.imag, number.real]])


class _Headed:
    """Place and yaw of the body, with the Jacobian of the yaw by the body's rotation."""

    def __init__(self, pose: gtsam.Pose3) -> None:
        R = pose.rotation().matrix()
        self.R, self.place, self.yaw = R, pose.translation(), math.atan2(R[1, 0], R[0, 0])
        level = R[0, 0] ** 2 + R[1, 0] ** 2
        self.by_rotation = np.array([0.0, R[2, 1], R[2, 2]]) / level


class PlanarMotion(NamedTuple):
    """Motion of a body between two poses."""

    step: Array
    """(2,) in level axes along its mean heading."""
    turn_rad: float
    to_heading: Array
    """(2, 2) from the axes of the world to those of the step."""


def planar_motion(before: gtsam.Pose3, after: gtsam.Pose3, near_rad: float) -> PlanarMotion:
    """Return the motion between two poses; of all turns the one nearest to ``near_rad``."""
    first, last = _Headed(before).yaw, _Headed(after).yaw
    turn_rad = near_rad + math.remainder(last - first - near_rad, 2 * math.pi)
    to_heading = _rotating(complex(np.exp(-1j * (first + turn_rad / 2))))
    return PlanarMotion(to_heading @ (after.translation() - before.translation())[:2], turn_rad, to_heading)


def _by_body(
    end: _Headed, sign: float, step: Array, to_heading: Array, gains: Array, interval: ReportedInterval
) -> Array:
    """Return the Jacobian (3, 6) of the error by the pose of the body at one end; ``sign`` 1 at the last."""
    J = np.zeros((CHANNELS, 6))
    of_yaw = sign * vector(interval.by_turn) + gains * (_QUARTER @ step) / 2
    J[:2, :3] = np.outer(of_yaw, end.by_rotation)
    J[2, :3] = -sign * end.by_rotation
    J[:2, 3:] = -sign * gains[:, None] * (to_heading @ end.R[:2])
    return J


def _by_constants(interval: ReportedInterval, step: Array, bias: Array) -> Array:
    J = np.zeros((CHANNELS, CONSTANTS_SIZE))
    J[:2, GAINS], J[:2, BIAS] = -np.diag(step), -bias
    J[:2, LAG], J[2, DRIFT] = vector(interval.by_lag), -interval.lasts_s
    return J


def reported_factor(
    interval: ReportedInterval,
    noise: IntervalNoise,
    keys: ReportedKeys,
    b_T_c: Array,
    rows: int,
    model: gtsam.noiseModel.Base,
) -> gtsam.CustomFactor:
    """Return the factor of an interval; its error (rows,) is whitened.

    ``rows``: 3, or 2 without the turn. ``b_T_c`` (4, 4) is the nominal mount, and ``model`` a unit model.
    """
    whitening, bias = noise.whitening[:rows], _rotating(interval.by_bias)
    by_error = np.zeros((CHANNELS, CHANNELS))
    by_error[:2, :2] = -bias / interval.lasts_s * noise.by_error[:2]
    by_error[2, 2] = -noise.by_error[2]

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        transform, constants = WorldTransform.of(values, b_T_c), values.atVector(REPORTED)
        cameras = [values.atPose3(key) for key in (keys.pose_i, keys.pose_j)]
        bodies = [transform.body_pose(camera) for camera in cameras]
        step, turn_rad, to_heading = planar_motion(bodies[0], bodies[1], interval.turn_rad)
        more = turn_rad - interval.turn_rad
        fading = values.atVector(keys.error_i) + values.atVector(keys.error_j)
        off = by_error @ fading
        off[:2] += vector(interval.moved + constants[LAG] * interval.by_lag + more * interval.by_turn)
        off[:2] -= constants[GAINS] * step + bias @ constants[BIAS]
        off[2] -= more + constants[DRIFT] * interval.lasts_s
        if jacobians is not None:
            by_world: Array | float = 0.0
            for k, sign in enumerate((-1.0, 1.0)):
                by_body = _by_body(_Headed(bodies[k]), sign, step, to_heading, constants[GAINS], interval)
                by_both = whitening @ by_body @ transform.jacobian(cameras[k])
                jacobians[k], by_world = by_both[:, :6], by_world + by_both[:, 6:]
            jacobians[2] = jacobians[3] = whitening @ by_error
            jacobians[4], jacobians[5] = np.asarray(by_world), whitening @ _by_constants(interval, step, bias)
        return np.asarray(whitening @ off)

    return gtsam.CustomFactor(model, [*astuple(keys), WORLD, REPORTED], error)
