"""What the filter is given: readings of instruments, what is assumed of them, and the start."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CloneMode = Literal["none", "first", "each"]
"""Whose pose the filter keeps: nobody's, that of the first asked time, that of each until the next."""


@dataclass(frozen=True)
class Series:
    """Readings of one instrument."""

    stamps_s: Array
    """(n,) not decreasing."""
    values: Array
    """(n, d); NaN where missing."""
    std: Array
    """(d,) white noise of one reading."""

    def between(self, start_s: float, end_s: float) -> Series | None:
        """What was read from ``start_s`` to ``end_s``; None where nothing was."""
        inside = (self.stamps_s >= start_s) & (self.stamps_s <= end_s)
        return Series(self.stamps_s[inside], self.values[inside], self.std) if inside.any() else None


@dataclass(frozen=True)
class VisualStep:
    """Where the camera went between two of the asked times, as pictures of the floor tell it."""

    i: int
    j: int
    """Numbers of the asked times, j = i + 1."""
    i_T_j: Array
    """(4, 4) of body axes at the camera, translation in heights of camera i above the floor."""
    covariance: Array
    """(6, 6), rotation first, right perturbation."""


def renumber_steps(steps: tuple[VisualStep, ...], inside: NDArray[np.bool_]) -> tuple[VisualStep, ...]:
    """Steps whose ends are both among the chosen times (n,), which form one run, with their new numbers."""
    number = np.cumsum(inside) - 1
    return tuple(
        replace(step, i=int(number[step.i]), j=int(number[step.j]))
        for step in steps
        if inside[step.i] and inside[step.j]
    )


@dataclass(frozen=True)
class Readings:
    """All that a flight's instruments have read, in body axes; what it has not is None."""

    gyro_rad_s: Series | None = None
    accel_m_s2: Series | None = None
    """Specific force."""
    roll_pitch_yaw_rad: Series | None = None
    range_m: Series | None = None
    """Along the beam; see `FilterModel`."""
    velocity_m_s: Series | None = None
    """Forward and left, level, yaw taken out."""
    w_p_b_m: Series | None = None
    """World positions (GPS); their height is above a zero of its own."""
    barometer_m: Series | None = None
    """Height above a zero of its own."""
    rest_m_s: Series | None = None
    """Zeros (n, 3) where the vehicle is known to stand."""
    still_rad_s: Series | None = None
    """Zeros (n, 3) where it is known not to turn."""
    steps: tuple[VisualStep, ...] = ()

    def between(self, start_s: float, end_s: float) -> Readings:
        """What was read from ``start_s`` to ``end_s``, without steps."""
        held = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "steps"}
        inside = {name: series.between(start_s, end_s) for name, series in held.items() if series is not None}
        return Readings(**inside)


@dataclass(frozen=True)
class FilterModel:
    """What is assumed of vehicle and instruments beyond the white noise of each reading; stds."""

    accel_m_s2: float = 6.0
    accel_time_s: float = 0.1
    """The vehicle's acceleration, an exponentially correlated signal: rules where no accelerometer does."""
    rate_rad_s: float = 2.0
    rate_time_s: float = 0.1
    """Its body rate, likewise."""
    gyro_offset_rad_s: float = 0.02
    gyro_walk_rad_s2: float = 1e-5
    """Per root Hz."""
    accel_offset_m_s2: float = 0.3
    accel_walk_m_s3: float = 1e-4
    """Per root Hz."""
    tilt_error_rad: float = 0.05
    tilt_error_time_s: float = 20.0
    """Error of the vehicle's own roll and pitch that lasts: wind and long accelerations mislead it."""
    yaw_walk_rad: float = 0.01
    """Per root second: wandering of its own yaw."""
    range_scale: float = 0.05
    range_offset_m: float = 0.05
    velocity_scale: float = 0.1
    velocity_error_m_s: float = 0.0
    velocity_error_time_s: float = 1.0
    """Error of the velocity that lasts."""
    barometer_walk_m: float = 0.1
    """Per root second."""
    b_beam: tuple[float, float, float] = (0.0, 0.0, -1.0)
    """Direction of the range's beam, of length one, body axes."""
    b_p_range_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    b_p_camera_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gate_probability: float = 1e-5
    """A component less likely than this is down-weighted to its gate; one beyond four times its squared gate
    is refused."""
    patience_s: float = 1.0
    """After so many seconds without a reading inside its gate, the instrument's own offset is taken to have
    stepped; a component without one is from then on down-weighted instead of refused."""


@dataclass(frozen=True)
class InitialState:
    """What is known of the vehicle at the first event; stds."""

    height_m: float
    height_std_m: float
    w_R_b: Array
    """(3, 3)."""
    tilt_std_rad: float = 0.3
    yaw_std_rad: float = 0.0
    """0 where the first heading defines the world's."""
    place_m: tuple[float, float] = (0.0, 0.0)
    place_std_m: float = 0.0
    """0 where the first place defines the world's."""
    w_v_m_s: Array = field(default_factory=lambda: np.zeros(3))
    velocity_std_m_s: float = 1.0
    accel_std_m_s2: float = 5.0
    rate_std_rad_s: float = 2.0
    tilt_error_rad: float | None = None
    """Of the vehicle's own attitude at the start; None: as at any time."""
    yaw_zero_std_rad: float = 1.0
    """How far the zero of the vehicle's own yaw may be from the world's."""
    barometer_zero_std_m: float = 100.0
    range_scale: float = 0.0
    velocity_scale: tuple[float, float] = (0.0, 0.0)
    position_zero_std_m: float = 0.0
    """How far the zero of the positions' height may be from the floor's."""
