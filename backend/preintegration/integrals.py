"""Integration of gyro and accelerometer between known poses.

Source: Forster et al. 2017 (T-RO 33), equation 33, for the integrals.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.quaternions import inverse, product, rotation_vectors

Array = NDArray[np.float64]
Number = TypeVar("Number", np.float64, np.complex128)

_GAP_STEPS = 3.0
"""Longest step between two readings that is no gap, in typical steps."""
_DENSE_S = 0.005
"""Longest step of an integral. The trapezoidal rule loses (pi f dt)^2 / 3 of a motion of frequency f: 5e-4 at
2.5 Hz, which is faster than a small vehicle turns its thrust."""


def gaps(read_s: Array, least_gap_s: float) -> NDArray[np.bool_]:
    """Return which steps (k - 1,) between readings at ``read_s`` (k,) are gaps; one of ``least_gap_s`` is
    none."""
    step_s = np.diff(read_s)
    return np.asarray(step_s > max(_GAP_STEPS * float(np.median(step_s)), least_gap_s))


def dense(stamps_s: Array, values: Array, least_gap_s: float) -> tuple[Array, Array]:
    """Return times (m,) and readings (m, c) with further ones between slow readings (k, c), outside of gaps.

    Cubic pieces with the slopes of the chords between both neighbours (Catmull and Rom 1974) follow motion
    that straight lines cut short: at 25 readings a second lengths were 6 % too small. A chord spans two
    steps, so that stamps that scatter amplify no noise.
    """
    from scipy.interpolate import CubicHermiteSpline  # a long import, for this alone

    step_s = np.diff(stamps_s)
    pieces = np.where(gaps(stamps_s, least_gap_s), 1, np.ceil(step_s / _DENSE_S - 1e-6)).astype(int)
    if (pieces <= 1).all():
        return stamps_s, values
    pieces = np.maximum(pieces, 1)
    first = np.cumsum(pieces) - pieces
    share = (np.arange(pieces.sum()) - np.repeat(first, pieces)) / np.repeat(pieces, pieces)
    times_s = np.append(np.repeat(stamps_s[:-1], pieces) + share * np.repeat(step_s, pieces), stamps_s[-1])
    padded = [np.concatenate([x[:1], x, x[-1:]]) for x in (stamps_s, values)]
    chord = (padded[1][2:] - padded[1][:-2]) / (padded[0][2:] - padded[0][:-2])[:, None]
    return times_s, np.asarray(CubicHermiteSpline(stamps_s, values, chord)(times_s))


def interpolate_attitudes(at_s: Array, w_R_b: Array, imu_s: Array, gyro_rad_s: Array) -> Array:
    """Return attitudes (k, 3, 3) at the readings: integrated gyro, corrected linearly to meet both poses."""
    turned = integrate(imu_s, gyro_rad_s)
    at_poses = np.column_stack([np.interp(at_s, imu_s, turned[:, a]) for a in range(3)])
    piece = np.clip(np.searchsorted(at_s, imu_s, side="right") - 1, 0, len(at_s) - 2)
    share = (imu_s - at_s[piece]) / (at_s[piece + 1] - at_s[piece])
    within = turned - at_poses[piece] - share[:, None] * (at_poses[piece + 1] - at_poses[piece])
    known = Rotation.from_matrix(w_R_b).as_quat()
    step = rotation_vectors(product(inverse(known[:-1]), known[1:]))
    turns = (Rotation.from_rotvec(v).as_quat() for v in (share[:, None] * step[piece], within))
    found = product(product(known[piece], next(turns)), next(turns))
    return np.asarray(Rotation.from_quat(found).as_matrix())


def integrate(stamps_s: Array, values: NDArray[Number]) -> NDArray[Number]:
    """Integrate readings (k, ...) at times (k,) from the first one on, by the trapezoidal rule: (k, ...)."""
    dt = np.diff(stamps_s).reshape(-1, *[1] * (values.ndim - 1))
    steps = 0.5 * (values[1:] + values[:-1]) * dt
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(steps, axis=0)])


def integrate_twice(stamps_s: Array, values: Array, at_s: Array) -> Array:
    """Integrate readings (k, ...) twice; return (m, ...) at other times (m,) within theirs."""
    from scipy.interpolate import CubicHermiteSpline  # a long import, for this alone

    once = integrate(stamps_s, values)
    return np.asarray(CubicHermiteSpline(stamps_s, integrate(stamps_s, once), once)(at_s))


def covered(read_s: Array, stamps_s: Array, least_gap_s: float) -> NDArray[np.bool_]:
    """Return which intervals (n - 1,) between the stamps lie within the readings and contain no gap.

    ``read_s`` (k,) are the times of the readings. A step of ``least_gap_s`` is no gap.
    """
    gap = gaps(read_s, least_gap_s)
    begin, end = read_s[:-1][gap], read_s[1:][gap]
    # As many gaps have ended before an interval as begin before its end.
    free = np.searchsorted(end, stamps_s[:-1], side="right") == np.searchsorted(begin, stamps_s[1:])
    return np.asarray(
        free & (stamps_s[:-1] >= read_s[0]) & (stamps_s[1:] <= read_s[-1]) & (np.diff(stamps_s) > 0)
    )
