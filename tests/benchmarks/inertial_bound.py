"""Accuracy that an inertial unit alone allows across a gap between pictures.

Near level, errors of tilt, velocity and position along a horizontal axis follow ``theta' = w_g``, ``v' = g
theta + w_a``, ``p' = v`` with white noise of gyro and accelerometer. The integral of the noise over the gap
has a closed form.

Source: Groves 2013, Principles of GNSS, Inertial and Multisensor Integrated Navigation Systems, section 5.7
(errors of inertial navigation); Forster et al. 2017 (T-RO 33), section VI (covariance of preintegration).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2

Array = NDArray[np.float64]


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
