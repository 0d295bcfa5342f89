"""Accuracy that an inertial unit allows: of the position across a gap between pictures, and of the scale.

Across a gap, near level, errors of tilt, velocity and position along a horizontal axis follow ``theta' =
w_g``, ``v' = g theta + w_a``, ``p' = v`` with white noise of gyro and accelerometer. The integral of the
noise over the gap has a closed form.

The scale's bound is that of Cramér and Rao for pictures that show the path exactly, up to its scale.

Source: Groves 2013, Principles of GNSS, Inertial and Multisensor Integrated Navigation Systems, section 5.7
(errors of inertial navigation); Forster et al. 2017 (T-RO 33), section VI (covariance of preintegration); Van
Trees 1968, Detection, Estimation, and Modulation Theory, Part I, section 2.4 (bound with priors).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from backend.measurements import GRAVITY_M_S2
from slam.core.flight import Flight
from slam.core.streams import Imu, Truth

Array = NDArray[np.float64]

_LEAST_ARM_M = 1e-6
"""Least deviation of a lever arm: it has no effect, and its information is finite."""


def gap_covariance(gap_s: float, gyro_density: float, accel_density: float) -> Array:
    """Return the covariance (3, 3) of tilt, velocity and position along a horizontal axis after a gap.

    Before the gap all are known exactly, and so are the unit's biases. Units: rad, m/s and m; densities in
    rad/s/sqrt(Hz) and m/s²/sqrt(Hz).
    """
    t, tilt, force = gap_s, gyro_density**2, accel_density**2
    by_tilt = np.array(
        [
            [t, GRAVITY_M_S2 * t**2 / 2, GRAVITY_M_S2 * t**3 / 6],
            [0, GRAVITY_M_S2**2 * t**3 / 3, GRAVITY_M_S2**2 * t**4 / 8],
            [0, 0, GRAVITY_M_S2**2 * t**5 / 20],
        ]
    )
    by_force = np.array([[0, 0, 0], [0, t, t**2 / 2], [0, 0, t**3 / 3]])
    upper = tilt * by_tilt + force * by_force
    return np.asarray(upper + np.triu(upper, 1).T)


def navigation_bound_m(gap_s: float, gyro_density: float, accel_density: float) -> float:
    """Return the RMS horizontal error at the end of a gap of navigation by the IMU alone."""
    return float(np.sqrt(2 * gap_covariance(gap_s, gyro_density, accel_density)[2, 2]))


def smoothing_bound_m(gap_s: float, gyro_density: float, accel_density: float) -> float:
    """Return the same where pictures behind the gap show tilt and velocity exactly.

    It is a lower bound for every estimate, as pictures show both with errors.
    """
    P = gap_covariance(gap_s, gyro_density, accel_density)
    seen, hidden = P[:2, :2], P[2, :2]
    return float(np.sqrt(2 * (P[2, 2] - hidden @ np.linalg.solve(seen, hidden))))


@dataclass(frozen=True)
class KnownPath:
    """Readings of an accelerometer over a path that is known up to its scale, and so are its attitudes.

    The unknowns are the scale, and gain, offset and lever arm of the instrument, which have prior standard
    deviations. Their least-squares estimate reaches the bound.
    """

    jacobian: Array
    """(n, 3, 8) derivatives of the readings by scale, gain, offset (3) and lever arm (3)."""
    force_m_s2: Array
    """(n, 3) specific forces of the true path, without errors."""
    information: Array
    """(8, 8) of all unknowns, with the priors."""
    noise_std_m_s2: float
    """Standard deviation of the white noise of a reading."""

    @property
    def scale_std(self) -> float:
        """Least relative standard deviation of the scale of any estimate."""
        return float(np.sqrt(np.linalg.inv(self.information)[0, 0]))

    def scale_error(self, accel_m_s2: Array) -> float:
        """Return the relative error of the scale of the least-squares estimate from some readings (n, 3)."""
        rest = accel_m_s2 - self.force_m_s2
        score = np.einsum("kai,ka->i", self.jacobian, rest) / self.noise_std_m_s2**2
        return float(np.linalg.solve(self.information, score)[0])


def accel_noise_std_m_s2(imu: Imu) -> float:
    """Return the standard deviation of the white noise of one reading of an accelerometer."""
    return float(imu.accel_noise_density / np.sqrt(np.median(np.diff(imu.stamps_s))))


def known_path(
    truth: Truth, stamps_s: Array, noise_std_m_s2: float, gain_std: float, offset_m_s2: float, arm_m: float
) -> KnownPath:
    """Return the readings at ``stamps_s`` (n,) over a true path; all deviations are those of the priors."""
    turn = RotationSpline(truth.stamps_s, Rotation.from_matrix(truth.w_T_b[:, :3, :3]))
    at_s = np.clip(stamps_s, truth.stamps_s[0], truth.stamps_s[-1])
    # Differences of the velocity would flatten the peaks of corners by some percent.
    accel = CubicSpline(truth.stamps_s, truth.w_v_m_s)(at_s, 1)
    b_R_w = turn(at_s).as_matrix().transpose(0, 2, 1)
    b_accel = np.einsum("kab,kb->ka", b_R_w, accel)
    force = b_accel + GRAVITY_M_S2 * b_R_w[:, :, 2]
    by_scale_and_gain = np.stack([b_accel, force], axis=-1)
    by_offset = np.tile(np.eye(3), (len(stamps_s), 1, 1))
    by_arm = np.stack([lever_force(turn, at_s, axis) for axis in np.eye(3)], axis=-1)
    jacobian = np.concatenate([by_scale_and_gain, by_offset, by_arm], axis=-1)
    prior = [0.0, gain_std**-2, *[offset_m_s2**-2] * 3, *[max(arm_m, _LEAST_ARM_M) ** -2] * 3]
    information = np.einsum("kai,kaj->ij", jacobian, jacobian) / noise_std_m_s2**2 + np.diag(prior)
    return KnownPath(jacobian, force, information, noise_std_m_s2)


def scale_bound(flight: Flight, gain_std: float, offset_m_s2: float) -> float:
    """Return the least relative standard deviation of the scale by accelerometer and sonar together.

    Pictures and attitudes show the path exactly, up to its scale. Gain and offset of the accelerometer have
    the given prior deviations, and gain and zero of the sonar those that it states.
    """
    imu, sonar, truth = flight.imu, flight.sonar, flight.truth
    assert imu is not None
    assert sonar is not None
    assert truth is not None
    path = known_path(truth, imu.stamps_s, accel_noise_std_m_s2(imu), gain_std, offset_m_s2, 0.0)
    height_m = np.interp(sonar.stamps_s, truth.stamps_s, truth.w_T_b[:, 2, 3])
    by_zero = np.column_stack([height_m, np.ones_like(height_m)])
    # Ranges do not tell scale and gain apart: they show the sum of both.
    ratio = np.linalg.inv(by_zero.T @ by_zero / sonar.noise_std_m**2 + np.diag([0.0, sonar.datum_std_m**-2]))
    by_ranges = ratio[0, 0] + sonar.scale_std**2
    return float((path.scale_std**-2 + 1 / by_ranges) ** -0.5)


def lever_force(turn: RotationSpline, stamps_s: Array, arm_m: Array) -> Array:
    """Return the specific force (n, 3) that an accelerometer at ``arm_m`` (3,) measures beyond that of the
    body's origin, in body axes: ``alpha x r + omega x (omega x r)``."""
    rate, change = turn(stamps_s, 1), turn(stamps_s, 2)
    arm = np.broadcast_to(arm_m, rate.shape)
    return np.asarray(np.cross(change, arm) + np.cross(rate, np.cross(rate, arm)))
