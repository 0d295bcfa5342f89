"""What the map shows of the instruments' own errors, beyond what they were believed.

Perspective knows tilt against the floor without drift, and loops know heading; the instruments are held
against both. A mount that is tilted looks like an offset of the attitude, and is told as one.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.bundle.noise import coloured_std
from backend.measurements import GRAVITY_M_S2
from slam.estimate import AccelerometerErrors, AttitudeErrors, InstrumentErrors
from slam.flight import AttitudeSeries, Flight
from slam.mapping.synchronize import attitudes_at

Array = NDArray[np.float64]

_LEAST_KEYFRAMES = 8
_STRETCHES = 8
_LEAST_TURN = 0.3
"""Of the mean rotation's smallest singular value: a vehicle that turns on itself hides an offset."""


def instrument_errors(flight: Flight, stamps_s: Array, w_T_b: Array, level: bool = True) -> InstrumentErrors:
    """Hold a flight's attitude and accelerometer against the poses (n, 4, 4) of its keyframes.

    ``level``: whether the poses stand over a level floor, and not in a frame of their own.
    """
    placed = np.isfinite(w_T_b).all(axis=(1, 2))
    stamps_s, w_T_b = stamps_s[placed], w_T_b[placed]
    if flight.attitude is None or not level or len(stamps_s) < _LEAST_KEYFRAMES:
        return InstrumentErrors(None, None)
    told = attitudes_at(flight.attitude, stamps_s, 0.0)
    if len(told) < _LEAST_KEYFRAMES:
        return InstrumentErrors(None, None)
    k = np.array([a.k for a in told])
    angles = Rotation.from_matrix(w_T_b[k, :3, :3]).as_euler("ZYX")[:, ::-1]
    off = np.array([a.roll_pitch_yaw_rad for a in told]) - angles
    off = np.unwrap(off, axis=0)
    headed = all(np.isfinite(a.std_rad[2]) for a in told)
    tilt = off[:, :2]
    mean = tilt.mean(axis=0)
    std = [coloured_std(tilt[:, a : a + 1] - mean[a]) / np.sqrt(len(k)) for a in (0, 1)]
    attitude = AttitudeErrors(
        (float(mean[0]), float(mean[1])),
        (float(std[0]), float(std[1])),
        float(np.sqrt(np.mean((tilt - mean) ** 2))),
        float(np.abs(tilt).max()),
        float(np.ptp(off[:, 2])) if headed else None,
    )
    return InstrumentErrors(attitude, _accelerometer(flight, stamps_s[k], w_T_b[k], off))


def _accelerometer(flight: Flight, stamps_s: Array, w_T_b: Array, off: Array) -> AccelerometerErrors | None:
    """mean(R a) = g + change of velocity + mean(R) offset, over each of some stretches."""
    imu = flight.imu
    if imu is None or flight.attitude is None:
        return None
    inside = (imu.stamps_s >= stamps_s[0]) & (imu.stamps_s <= stamps_s[-1])
    inside &= np.isfinite(imu.accel_m_s2).all(axis=1)
    if inside.sum() < 10 * _STRETCHES:
        return None
    at_s, accel = imu.stamps_s[inside], imu.accel_m_s2[inside] @ imu.b_T_s[:3, :3].T
    w_R_b = _corrected(flight.attitude, at_s, stamps_s, off)
    # Speed half way between two keyframes; a stretch goes from one such moment to another.
    middle_s = 0.5 * (stamps_s[1:] + stamps_s[:-1])
    speed = np.diff(w_T_b[:, :3, 3], axis=0) / np.diff(stamps_s)[:, None]
    ends = np.unique(np.linspace(0, len(middle_s) - 1, _STRETCHES + 1).round().astype(int))
    found = []
    for first, last in pairwise(ends.tolist()):
        rows = (at_s >= middle_s[first]) & (at_s < middle_s[last])
        if rows.sum() < 10:
            continue
        mean_R = w_R_b[rows].mean(axis=0)
        if np.linalg.svd(mean_R, compute_uv=False)[-1] < _LEAST_TURN:
            continue
        gained = (speed[last] - speed[first]) / (middle_s[last] - middle_s[first])
        felt = np.einsum("nij,nj->i", w_R_b[rows], accel[rows]) / rows.sum()
        found.append(np.linalg.solve(mean_R, felt - gained - [0.0, 0.0, GRAVITY_M_S2]))
    if len(found) < 3:
        return None
    mean, std = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
    (x, y, z), (std_x, std_y, std_z) = mean.tolist(), std.tolist()
    return AccelerometerErrors((x, y, z), (std_x, std_y, std_z))


def _corrected(attitude: AttitudeSeries, at_s: Array, stamps_s: Array, off: Array) -> Array:
    """(n, 3, 3) body to world by the attitude stream, less its errors at the keyframes, line by line."""
    good = np.isfinite(attitude.roll_pitch_yaw_rad).all(axis=1)
    series = np.unwrap(attitude.roll_pitch_yaw_rad[good], axis=0)
    angles = np.column_stack([np.interp(at_s, attitude.stamps_s[good], series[:, a]) for a in range(3)])
    angles -= np.column_stack([np.interp(at_s, stamps_s, off[:, a]) for a in range(3)])
    return np.asarray(Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix())
