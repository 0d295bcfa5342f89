"""Terms of the inertial unit, in the order in which they act on a reading.

Readings are in body axes: gyro in the entries 0 to 2, specific force in 3 to 5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import radians
from typing import Any

import numpy as np

from slam.core.flight import Flight
from slam.simulation.terms.term import BODY_AXES, Array, Term, signed

_AXES = ("x", "y", "z")


def _turned(out: Any, state: Any, rate: Any, elapsed: Any, values: Any, first: int) -> None:
    """Rotate both vectors into the axes of the unit, by Rodrigues' formula."""
    a, b, c = values[first], values[first + 1], values[first + 2]
    angle = np.sqrt(a * a + b * b + c * c)
    if angle == 0.0:
        return
    sine, cosine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    for i in (0, 3):
        x, y, z = out[i], out[i + 1], out[i + 2]
        u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
        out[i] = x - sine * u + cosine * (b * w - c * v)
        out[i + 1] = y - sine * v + cosine * (c * u - a * w)
        out[i + 2] = z - sine * w + cosine * (a * v - b * u)


def _gyro_scaled(out: Any, state: Any, rate: Any, elapsed: Any, values: Any, first: int) -> None:
    for i in range(3):
        out[i] *= 1.0 + values[first]


def _gyro_shifted(out: Any, state: Any, rate: Any, elapsed: Any, values: Any, first: int) -> None:
    for i in range(3):
        out[i] += values[first + i]


def _accel_scaled(out: Any, state: Any, rate: Any, elapsed: Any, values: Any, first: int) -> None:
    for i in range(3, 6):
        out[i] *= 1.0 + values[first]


def _accel_shifted(out: Any, state: Any, rate: Any, elapsed: Any, values: Any, first: int) -> None:
    for i in range(3):
        out[3 + i] += values[first + i]


def _in_body_axes(flight: Flight, gyro: Callable[[Array], Array], accel: Callable[[Array], Array]) -> Flight:
    imu = flight.imu
    assert imu is not None
    b_R_s = imu.b_T_s[:3, :3]
    corrected = replace(
        imu,
        gyro_rad_s=gyro(imu.gyro_rad_s @ b_R_s.T) @ b_R_s,
        accel_m_s2=accel(imu.accel_m_s2 @ b_R_s.T) @ b_R_s,
    )
    return replace(flight, imu=corrected)


def _unchanged(values: Array) -> Array:
    return values


def _without_turn(flight: Flight, values: Array, std: float | None) -> Flight:
    from scipy.spatial.transform import Rotation

    b_R_u = Rotation.from_rotvec(values)
    return _in_body_axes(flight, b_R_u.apply, b_R_u.apply)


def _without_gyro_scale(flight: Flight, values: Array, std: float | None) -> Flight:
    return _in_body_axes(flight, lambda w: w / (1.0 + values[0]), _unchanged)


def _without_gyro_bias(flight: Flight, values: Array, std: float | None) -> Flight:
    return _in_body_axes(flight, lambda w: w - values, _unchanged)


def _without_accel_scale(flight: Flight, values: Array, std: float | None) -> Flight:
    return _in_body_axes(flight, _unchanged, lambda a: a / (1.0 + values[0]))


def _without_accel_bias(flight: Flight, values: Array, std: float | None) -> Flight:
    return _in_body_axes(flight, _unchanged, lambda a: a - values)


IMU = (
    Term(
        name="imu_misalignment",
        title="an IMU mounted at an angle",
        meaning="the IMU is mounted at an angle",
        family="imu",
        acts_on="sensor",
        instrument="mounting of the IMU",
        parameters=tuple(
            signed(axis, "rad", radians(3), 0.5, step=0.001, quantity=BODY_AXES[axis]) for axis in _AXES
        ),
        equation="the unit is rotated against the body by this rotation vector",
        confounders=("accel_bias", "trim_offset"),
        looks_alike="An attitude that leans by as much against the body looks the same: put the "
        "vehicle level on the floor, and see whether roll and pitch are 0 there.",
        excitation="fast tilts and yaw: one axis shows in another",
        tolerance=0.001,
        in_differences=True,
        stream="imu",
        read=_turned,
        undo=_without_turn,
    ),
    Term(
        name="gyro_scale",
        title="a gyro wrong by a factor",
        meaning="the gyro's rates are wrong by a factor",
        family="imu",
        acts_on="sensor",
        instrument="gyro",
        parameters=(signed("eps", "1", 0.03, 0.5, step=0.001, quantity="error of the rates"),),
        equation="the body rate times 1 + eps, all axes",
        confounders=("yaw_drag",),
        excitation="yaw steps of 90 deg and back, with the heading from the camera",
        tolerance=0.001,
        in_differences=True,
        stream="imu",
        read=_gyro_scaled,
        undo=_without_gyro_scale,
        scales=True,
    ),
    Term(
        name="gyro_bias",
        title="a gyro bias",
        meaning="the gyro reads a rate while the vehicle stands still",
        family="imu",
        acts_on="sensor",
        instrument="gyro",
        parameters=tuple(
            signed(axis, "rad/s", radians(2), 1.0, step=0.0001, quantity=BODY_AXES[axis]) for axis in _AXES
        ),
        equation="added to the body rate",
        confounders=("gyro_scale",),
        looks_alike="An attitude that drifts by as much looks the same in flight: at rest, the gyro "
        "tells which of the two is wrong.",
        excitation="30 s at rest on the floor with motors off, before and after the flight",
        tolerance=0.0001,
        in_differences=True,
        stream="imu",
        read=_gyro_shifted,
        undo=_without_gyro_bias,
    ),
    Term(
        name="accel_scale",
        title="an accelerometer wrong by a factor",
        meaning="the accelerometer is wrong by a factor",
        family="imu",
        acts_on="sensor",
        instrument="accelerometer",
        parameters=(signed("eps", "1", 0.03, 0.5, step=0.001, quantity="error of the accelerations"),),
        equation="the specific force times 1 + eps, all axes",
        confounders=("accel_bias",),
        excitation="fast climbs and tilts",
        tolerance=0.001,
        in_differences=True,
        stream="imu",
        read=_accel_scaled,
        undo=_without_accel_scale,
        scales=True,
    ),
    Term(
        name="accel_bias",
        title="an accelerometer bias",
        meaning="the accelerometer reads an acceleration that the vehicle does not have",
        family="imu",
        acts_on="sensor",
        instrument="accelerometer",
        parameters=tuple(
            signed(axis, "m/s^2", 0.3, 5.0, step=0.001, quantity=BODY_AXES[axis]) for axis in _AXES
        ),
        equation="added to the specific force",
        confounders=("trim_offset", "accel_scale"),
        excitation="rest on the floor with motors off, turned by 180 deg about the vertical, and upside down",
        tolerance=0.01,
        in_differences=True,
        stream="imu",
        read=_accel_shifted,
        undo=_without_accel_bias,
    ),
)
