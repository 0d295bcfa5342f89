"""Readings of an IMU between two keyframes, in the incremental estimation.

gtsam's factor compares poses, velocities and biases at both keyframes, in metres over a level floor with z
up. It has a robust loss. The IMU's gains and the delay of the pictures are not estimated here, as the
refinement does after the flight (`backend.bundle.inertial`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B as BIAS
from gtsam.symbol_shorthand import V as VELOCITY
from numpy.typing import NDArray

from backend.measurements import RelativePose
from backend.pose_graph.marginals import posterior
from backend.preintegration.intervals import POSITION, ROTATION, InertialInterval
from backend.preintegration.limits import MOST_HEIGHTS
from backend.quantiles import chi_square_limit
from backend.robust import robust

Array = NDArray[np.float64]

_ANY_SPEED_M_S = 30.0
"""Standard deviation of the first velocity, beyond that of any small vehicle."""
_FALSE_ALARM = 1e-6
"""Probability that a right gyro contradicts the pictures: a flight has thousands of intervals."""


@dataclass(frozen=True)
class InertialLink:
    """The factor of an interval, and what comes with it."""

    factors: gtsam.NonlinearFactorGraph
    """The factor, and priors on velocity and bias where no earlier interval tells them."""
    values: gtsam.Values
    """Initial velocities and biases that the estimate does not have yet."""
    w_T_j: Array
    """(4, 4) pose of the later keyframe."""


def has_velocity(isam: gtsam.ISAM2, k: int) -> bool:
    """Return whether an interval tells the velocity of keyframe ``k``."""
    return bool(isam.valueExists(VELOCITY(k)))


@dataclass(frozen=True)
class MeasuredInterval:
    """An interval, and its noise in flight."""

    interval: InertialInterval
    factors: tuple[float, float]
    """On the nominal noise of gyro and accelerometer."""

    @property
    def covariance(self) -> Array:
        """(15, 15) covariance of the error."""
        return self.interval.covariance(*self.factors)

    @property
    def model(self) -> gtsam.noiseModel.Gaussian:
        """Noise model of the error."""
        return gtsam.noiseModel.Gaussian.Covariance(self.covariance)

    def is_informative(self, height_m: float) -> bool:
        """Return whether the noise leaves the position known to a height above the floor."""
        return bool(np.trace(self.covariance[POSITION, POSITION]) < (MOST_HEIGHTS * height_m) ** 2)


def bridges(isam: gtsam.ISAM2, readings: MeasuredInterval) -> bool:
    """Return whether an interval without pictures leaves the position known to a height above the floor."""
    i, j = readings.interval.i, readings.interval.j
    if not has_velocity(isam, i):
        return False
    link = inertial_link(readings, isam, None)
    # At another point than the covariance's, velocities would turn by the unknown heading.
    point, values = isam.getLinearizationPoint(), gtsam.Values(link.values)
    begin = point.atPose3(i)
    values.insert(i, begin)
    values.insert(j, gtsam.Pose3(link.w_T_j))
    values.insert(VELOCITY(i), point.atVector(VELOCITY(i)))
    values.insert(BIAS(i), point.atConstantBias(BIAS(i)))
    # Columns in order of the keys: pose, velocity, pose, velocity, bias, bias.
    linear = np.asarray(keyed(readings, readings.model).linearize(values).jacobian()[0])
    by_begin = np.hstack([linear[:, :9], linear[:, 18:24]])
    from_errors = np.linalg.inv(np.hstack([linear[:, 9:18], linear[:, 24:]]))[:6]
    by_begin = -from_errors @ by_begin
    by_begin[:, :6] -= begin.between(gtsam.Pose3(link.w_T_j)).inverse().AdjointMap()
    known = isam.jointMarginalCovariance([i, VELOCITY(i), BIAS(i)]).fullMatrix()
    covariance = by_begin @ known @ by_begin.T + from_errors @ from_errors.T
    height_m = float(begin.translation()[2])
    return bool(np.trace(covariance[3:, 3:]) < (MOST_HEIGHTS * height_m) ** 2)


def keyed(readings: MeasuredInterval, model: gtsam.noiseModel.Base) -> gtsam.NonlinearFactor:
    """Return the factor of the readings on the keys of its keyframes."""
    i, j = readings.interval.i, readings.interval.j
    factor = readings.interval.factor.cloneWithNewNoiseModel(model)
    return factor.rekey([i, VELOCITY(i), j, VELOCITY(j), BIAS(i), BIAS(j)])


def inertial_link(readings: MeasuredInterval, isam: gtsam.ISAM2, w_T_j: Array | None) -> InertialLink:
    """Return the link of readings to the estimate ``isam``, which has the pose of its first keyframe.

    ``w_T_j`` (4, 4) is the pose of the other one by the pictures; without it the readings predict it, which
    takes the velocity of the first one.
    """
    noise, i, j = readings.interval.noise, readings.interval.i, readings.interval.j
    integrated = readings.interval.factor.preintegratedMeasurements()
    begin, lasts_s = isam.calculateEstimatePose3(i), integrated.deltaTij()
    values, factors = gtsam.Values(), gtsam.NonlinearFactorGraph()
    if has_velocity(isam, i):
        velocity = isam.calculateEstimateVector(VELOCITY(i))
        bias = isam.calculateEstimateConstantBias(BIAS(i))
    else:
        assert w_T_j is not None
        velocity, bias = (w_T_j[:3, 3] - begin.translation()) / lasts_s, gtsam.imuBias.ConstantBias()
        offsets = gtsam.noiseModel.Diagonal.Sigmas(
            np.repeat([noise.accel_offset_m_s2, noise.gyro_offset_rad_s], 3)
        )
        any_velocity = gtsam.noiseModel.Isotropic.Sigma(3, _ANY_SPEED_M_S)
        factors.push_back(gtsam.PriorFactorVector(VELOCITY(i), np.zeros(3), any_velocity))
        earlier = next((k for k in reversed(range(i)) if has_velocity(isam, k)), None)
        if earlier is None:
            factors.push_back(gtsam.PriorFactorConstantBias(BIAS(i), bias, offsets))
        else:
            # One sensor, whose prior counts once; where readings fail, its bias may jump.
            factors.push_back(gtsam.BetweenFactorConstantBias(BIAS(earlier), BIAS(i), bias, offsets))
            bias = isam.calculateEstimateConstantBias(BIAS(earlier))
        values.insert(VELOCITY(i), velocity)
        values.insert(BIAS(i), bias)
    end = integrated.predict(gtsam.NavState(begin, velocity), bias)
    values.insert(VELOCITY(j), end.velocity())
    values.insert(BIAS(j), bias)
    factors.push_back(keyed(readings, robust(readings.model)))
    return InertialLink(factors, values, np.asarray(end.pose().matrix()) if w_T_j is None else w_T_j)


def turns_agree(readings: MeasuredInterval, i_R_j: Array, rotation_covariance: Array) -> bool:
    """Return whether gyro and pictures turn alike; swapped axes or another unit do not.

    ``i_R_j`` (3, 3) by the pictures has the ``rotation_covariance`` (3, 3) [rad²].
    """
    integrated = readings.interval.factor.preintegratedMeasurements()
    off_rad = integrated.deltaRij().localCoordinates(gtsam.Rot3(i_R_j))
    by_bias = (readings.interval.noise.gyro_offset_rad_s * integrated.deltaTij()) ** 2 * np.eye(3)
    covariance = readings.covariance[ROTATION, ROTATION] + by_bias + rotation_covariance
    return bool(off_rad @ np.linalg.solve(covariance, off_rad) < chi_square_limit(_FALSE_ALARM, 3))


def relative_poses(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, pairs: Sequence[tuple[int, int]]
) -> tuple[RelativePose, ...]:
    """Return the relative poses of pairs of keyframes, each of one interval, of kind ``inertial``."""
    unit = gtsam.noiseModel.Unit.Create(6)
    found = [values.atPose3(i).between(values.atPose3(j)) for i, j in pairs]
    factors = [gtsam.BetweenFactorPose3(i, j, T, unit) for (i, j), T in zip(pairs, found, strict=True)]
    # The random walk of a bias is a millionth of the first velocity's prior.
    covariances = posterior(graph, values, [i for i, _ in pairs], factors, by_qr=True).predictions
    return tuple(
        RelativePose(i, j, T.matrix(), 0.5 * (P + P.T), "inertial")
        for (i, j), T, P in zip(pairs, found, covariances, strict=True)
    )
