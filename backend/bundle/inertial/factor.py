"""Factor of the readings of an IMU between two keyframes, on camera poses in mean heights.

gtsam's own factor compares metric states of the IMU: pose, velocity and bias at both ends. Here the poses
follow from those of the camera and the world variable, and from constants of the IMU: the log gains of its
accelerometer and of its gyro, its position on the body, and the delay of the pictures' stamps. The error is
gtsam's; the chain rule takes its Jacobians to the variables of the graph.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.bundle.factors import WORLD
from backend.bundle.world import WorldTransform
from backend.measurements import GRAVITY_M_S2
from backend.preintegration.intervals import MOTION, STATE_SIZE, InertialInterval
from backend.se3 import cross_matrix

Array = NDArray[np.float64]

GAINS, ARM, DELAY, GYRO_GAINS = slice(0, 3), slice(3, 6), 6, slice(7, 10)
"""Index of each number in the variable of the IMU's constants: log gains of the accelerometer, position [m],
delay [s], log gains of the gyro."""
IMU_SIZE = 10
IMU = gtsam.symbol("a", 0)
"""Key of that variable."""


@dataclass(frozen=True)
class IntervalKeys:
    """Keys of the variables of an interval, in the order of the factor's Jacobians.

    Those of the world and of the IMU's constants follow, which all intervals share.
    """

    pose_i: int
    velocity_i: int
    pose_j: int
    velocity_j: int
    bias_i: int
    bias_j: int


class _End:
    """State of the IMU at one end of the interval, with its derivatives."""

    def __init__(self, w_T_b: gtsam.Pose3, velocity: Array, imu: Array, rate: Array) -> None:
        delay = imu[DELAY]
        self.velocity, self.rate, self.delay, self.arm = velocity, rate, delay, imu[ARM]
        self.turned = gtsam.Rot3.Expmap(delay * rate)
        rotation = w_T_b.rotation().compose(self.turned)
        place = w_T_b.transformFrom(self.arm) + delay * velocity
        self.pose = gtsam.Pose3(rotation, place)

    def chained(self, by_pose: Array, by_velocity: Array) -> tuple[Array, Array, Array]:
        """Return Jacobians of an error by body pose, velocity and IMU constants, from those by pose and
        velocity of the IMU."""
        back = self.turned.matrix().T
        to_body = self.pose.rotation().matrix().T
        by_turn, by_place = by_pose[:, :3], by_pose[:, 3:]
        by_body = np.hstack([by_turn @ back - by_place @ back @ cross_matrix(self.arm), by_place @ back])
        by_imu = np.zeros((len(by_pose), IMU_SIZE))
        by_imu[:, ARM] = by_place @ back
        by_imu[:, DELAY] = by_turn @ self.rate + by_place @ (to_body @ self.velocity)
        return by_body, by_velocity + by_place @ (self.delay * to_body), by_imu


def gain_effect(w_R_b: Array, w_p_m: Array, w_v_m_s: Array, lasts_s: float) -> Array:
    """Return derivatives (6, 3) of the error, position and velocity, by the log gains of the accelerometer.

    ``w_R_b`` (3, 3) is the attitude at the beginning, and position and velocity (2, 3) are those at both
    ends. They come from a map without the accelerometer: readings multiplied by a gain would let the gain
    shrink their noise. The rotation within the interval is neglected, as a gain is within percents of 1.
    """
    gravity = np.array([0.0, 0.0, -GRAVITY_M_S2])
    moved = w_p_m[1] - w_p_m[0] - w_v_m_s[0] * lasts_s - gravity * (lasts_s**2 / 2)
    gained = w_v_m_s[1] - w_v_m_s[0] - gravity * lasts_s
    return -np.vstack([np.diag(w_R_b.T @ moved), np.diag(w_R_b.T @ gained)])


def inertial_factor(
    interval: InertialInterval,
    whitening: Array,
    by_gain: Array,
    keys: IntervalKeys,
    b_T_c: Array,
    model: gtsam.noiseModel.Base,
) -> gtsam.CustomFactor:
    """Return the factor of an interval; its error (15,) is whitened by ``whitening`` (15, 15).

    ``by_gain`` (6, 3) is the `gain_effect`, ``b_T_c`` (4, 4) the nominal mount, and ``model`` a unit model.
    """
    builtin = interval.factor
    noise = builtin.noiseModel()
    assert isinstance(noise, gtsam.noiseModel.Gaussian)
    rewhiten = np.asarray(whitening @ np.linalg.inv(noise.R()))
    local = gtsam.Values()
    for key in (0, 2):
        local.insert(key, gtsam.Pose3())
    for key in (1, 3):
        local.insert(key, np.zeros(3))
    for key in (4, 5):
        local.insert(key, gtsam.imuBias.ConstantBias())

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        transform, imu = WorldTransform.of(values, b_T_c), values.atVector(IMU)
        cameras = [values.atPose3(key) for key in (keys.pose_i, keys.pose_j)]
        velocities = [values.atVector(key) for key in (keys.velocity_i, keys.velocity_j)]
        ends = [
            _End(transform.body_pose(camera), velocity, imu, rate)
            for camera, velocity, rate in zip(cameras, velocities, interval.rates_rad_s, strict=True)
        ]
        for k, end in enumerate(ends):
            local.update(2 * k, end.pose)
            local.update(2 * k + 1, end.velocity)
        # A gain adds to the bias what it makes of the mean rate; a part of a percent of noise is neglected.
        gained_rate = gtsam.imuBias.ConstantBias(np.zeros(3), imu[GYRO_GAINS] * interval.mean_rate_rad_s)
        local.update(4, values.atConstantBias(keys.bias_i) + gained_rate)
        local.update(5, values.atConstantBias(keys.bias_j) + gained_rate)
        j_R_i = (ends[1].pose.rotation().inverse().compose(ends[0].pose.rotation())).matrix()
        off = (by_gain @ imu[GAINS]).reshape(2, 3)
        gained = np.zeros(STATE_SIZE)
        gained[MOTION] = (off @ j_R_i.T).ravel()
        if jacobians is None:
            return np.asarray(whitening @ (builtin.unwhitenedError(local) + gained))
        linear, right = builtin.linearize(local).jacobian()
        J = rewhiten @ linear
        # Columns in order of keys: poses of 6, velocities of 3, biases of 6.
        of_i, of_j = J[:, :9], J[:, 9:18]
        by_imu = np.zeros((STATE_SIZE, IMU_SIZE))
        for row, one in zip((3, 6), off, strict=True):
            of_i[:, :3] -= whitening[:, row : row + 3] @ j_R_i @ cross_matrix(one)
            of_j[:, :3] += whitening[:, row : row + 3] @ cross_matrix(j_R_i @ one)
            by_imu[:, GAINS] += whitening[:, row : row + 3] @ j_R_i @ by_gain[row - 3 : row]
        by_world: Array | float = 0.0
        for k, (end, of_end, camera) in enumerate(zip(ends, (of_i, of_j), cameras, strict=True)):
            by_body, jacobians[2 * k + 1], more = end.chained(of_end[:, :6], of_end[:, 6:])
            by_both = by_body @ transform.jacobian(camera)
            jacobians[2 * k], by_imu = by_both[:, :6], by_imu + more
            by_world = by_world + by_both[:, 6:]
        jacobians[4], jacobians[5] = J[:, 18:24], J[:, 24:]
        by_imu[:, GYRO_GAINS] = (J[:, 21:24] + J[:, 27:]) * interval.mean_rate_rad_s
        jacobians[6], jacobians[7] = np.asarray(by_world), by_imu
        return np.asarray(whitening @ gained - rewhiten @ right)

    return gtsam.CustomFactor(model, [*astuple(keys), WORLD, IMU], error)
