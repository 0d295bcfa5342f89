"""Turns of the on-board attitude against those of the gyro: axes, signs, gains and the IMU's mount.

The filter believes both. A wrong axis or unit of one looks to it like noise of the other, or like an error of
the tilt. Over half a second, turns by the gyro are far more accurate than those by any attitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from backend.significance import SIGMAS_OF_SEVERAL
from slam.core.flight import Flight
from slam.core.messages import Message, warning
from slam.core.names import enumerated
from slam.core.stream_anomalies import longest_repeat
from slam.data_quality.axes import wrong_axes
from slam.data_quality.inertial_comparison import (
    FEWEST,
    NODE_S,
    IntegralComparison,
    comparisons,
    moments_of,
    near_floor,
)
from slam.inertial.variogram import white_density

Array = NDArray[np.float64]

_ANGLES, _AXES = ("roll", "pitch", "yaw"), ("x", "y", "z")
_GAIN, _TURN_DEG = 1.5, 15.0
"""Least ratio and angle that are told. Measured flights have 0.91 to 1.05, and up to 6 deg."""
_ABOVE_NOISE = 3.0
"""Multiples of the gyro's noise that the turns must exceed: it then lowers no gain by more than a tenth."""
_LEAST_ALIKE = 0.5
"""Least share of the attitude's turns that the gyro explains: a lag leaves less."""
_SPEED_M_S = 0.1
"""Above it a vehicle moves; velocities of one that stands are smaller."""
_DOUBT = "the motion that both give is not to be trusted"


@dataclass(frozen=True)
class _Regression:
    """Changes of the angles by the attitude as a linear function of those by the gyro."""

    gain: Array
    """(3, 3), the unit matrix where both are right; NaN for an angle that hardly changes."""
    std: Array
    """(3, 3)."""
    is_turning: NDArray[np.bool_]
    """(3,) the angles that change by the gyro, beyond its noise."""


def attitude_contradictions(flight: Flight) -> list[Message]:
    """Return a line for each kind of contradiction between the turns of ``attitude0`` and ``imu0``, and for
    an attitude that no flight has."""
    if lines := _impossible(flight):
        return lines
    if axes := wrong_axes(flight, ("attitude",))[0]:
        found = " and ".join(map(str, axes))
        do = "check the axes and signs of both, and T_BS of imu0"
        return [warning(f"attitude0 and imu0: {found}: {_DOUBT}", do)]
    seen = dict(comparisons(flight)).get("attitude")
    regression = None if seen is None else _regression(flight, seen)
    if seen is None or regression is None:
        return []
    stuck = regression.is_turning & (np.ptp(seen.read, axis=0) == 0)
    if stuck.any():
        angles = enumerated([angle for angle, is_stuck in zip(_ANGLES, stuck, strict=True) if is_stuck])
        return [
            warning(
                f"attitude0 does not change its {angles} while imu0's gyro shows that the vehicle turns "
                "(stuck?): leave attitude0 out, or repair it"
            )
        ]
    return [*_other_mounts(regression), *_other_gains(regression)]


def _impossible(flight: Flight) -> list[Message]:
    """Return a line where the vehicle would hang upside down, or would keep every angle while it moves."""
    attitude = flight.attitude
    known = attitude is not None and np.isfinite(attitude.roll_pitch_yaw_rad).all(axis=1)
    if attitude is None or not np.any(known):
        return []
    stamps_s, angles = attitude.stamps_s[known], attitude.roll_pitch_yaw_rad[known]
    if np.median(np.cos(angles[:, :2]).prod(axis=1)) < 0:
        return [
            warning(
                "by attitude0 the vehicle hangs upside down most of the time",
                "check its axes, and the order of its quaternions",
            )
        ]
    velocity = flight.velocity
    if flight.imu is not None or velocity is None:
        return []  # the gyro tells whether the vehicle turns
    read = np.isfinite(velocity.v_m_s).all(axis=1)
    if not read.any():
        return []
    speed_m_s = np.interp(stamps_s, velocity.stamps_s[read], np.hypot(*velocity.v_m_s[read].T))
    stamps_s, angles = stamps_s[speed_m_s > _SPEED_M_S], angles[speed_m_s > _SPEED_M_S]
    at, lasted_s, _ = longest_repeat(stamps_s, angles) if len(stamps_s) > 1 else (0, 0.0, 0.0)
    if lasted_s == 0:
        return []
    return [
        warning(
            f"attitude0 keeps every angle for {lasted_s:.1f} s from {stamps_s[at]:.1f} s while the vehicle "
            "moves (stuck?): the motion that it gives is not to be trusted",
            "leave attitude0 out, or repair it",
        )
    ]


def _regression(flight: Flight, seen: IntegralComparison) -> _Regression | None:
    assert flight.imu is not None
    moments = moments_of(seen.stamps_s, near_floor(flight))
    kept = moments.together(1)
    if kept.sum() < FEWEST:
        return None
    read, turned = (np.diff(moments.means(x), axis=0)[kept] for x in (seen.read, seen.integral))
    # Single jumps of a reading are no motion.
    read, turned = (np.clip(x, *np.quantile(x, [0.01, 0.99], axis=0)) for x in (read, turned))
    read, turned = read - read.mean(axis=0), turned - turned.mean(axis=0)
    spread = turned.std(axis=0)
    noise_rad = white_density(flight.imu.stamps_s, flight.imu.gyro_rad_s) * np.sqrt(NODE_S)
    known = spread > _ABOVE_NOISE * noise_rad
    gain, std = np.full((3, 3), np.nan), np.full((3, 3), np.nan)
    if not known.any():
        return _Regression(gain, std, known)
    inverse = np.linalg.pinv(turned[:, known].T @ turned[:, known])
    found = inverse @ turned[:, known].T @ read
    rest = ((read - turned[:, known] @ found) ** 2).mean(axis=0)
    alike = rest < (1 - _LEAST_ALIKE) * (read**2).mean(axis=0)
    gain[np.ix_(alike, known)] = found.T[alike]
    # Neighbouring changes share a moment: they count as half.
    std[:, known] = np.sqrt(2 * rest[:, None] * np.diag(inverse))
    return _Regression(gain, std, known)


def _other_mounts(regression: _Regression) -> list[Message]:
    """Return a line for each axis about which the IMU is turned."""
    gain, std, lines = regression.gain, regression.std, []
    for j, k in combinations(range(3), 2):
        angle = np.degrees(np.arctan2((gain[j, k] - gain[k, j]) / 2, (gain[j, j] + gain[k, k]) / 2))
        angle_std = np.degrees(np.hypot(std[j, k], std[k, j]) / 2)
        if abs(angle) - SIGMAS_OF_SEVERAL * angle_std > _TURN_DEG:
            lines.append(
                warning(
                    f"imu0 turns as if it was mounted {abs(angle):.0f} deg about its {_AXES[3 - j - k]} axis "
                    f"beside attitude0: {_DOUBT}",
                    "check T_BS of imu0",
                )
            )
    return lines


def _other_gains(regression: _Regression) -> list[Message]:
    """Return a line for each angle that changes by another factor than the gyro shows."""
    lines = []
    for k, angle in enumerate(_ANGLES):
        gain, margin = regression.gain[k, k], SIGMAS_OF_SEVERAL * regression.std[k, k]
        if gain - margin > _GAIN or gain + margin < 1 / _GAIN:
            lines.append(
                warning(
                    f"{angle} of attitude0 changes by {gain:.2g} times what imu0's gyro shows: {_DOUBT}",
                    "check the gain and the unit of both",
                )
            )
    return lines
