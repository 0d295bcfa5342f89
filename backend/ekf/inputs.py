"""Inputs of the filter: readings of instruments, the noise model, and the initial state."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from backend.measurements import nominal_errors

Array = NDArray[np.float64]
CloneMode = Literal["none", "first", "each"]
"""Pose that the filter clones: none, that of the first requested time, or of each one until the next."""


@dataclass(frozen=True)
class Series:
    """Readings of one instrument."""

    stamps_s: Array
    """(n,) not decreasing."""
    values: Array
    """(n, d); NaN where missing."""
    std: Array
    """(d,) standard deviation of the white noise of one reading, or (n, d) where that of each differs."""

    def between(self, start_s: float, end_s: float) -> Series | None:
        """Return the readings from ``start_s`` to ``end_s``; None if there are none."""
        inside = (self.stamps_s >= start_s) & (self.stamps_s <= end_s)
        std = self.std[inside] if self.std.ndim > 1 else self.std
        return Series(self.stamps_s[inside], self.values[inside], std) if inside.any() else None


@dataclass(frozen=True)
class VisualStep:
    """Motion of the camera between two requested times, estimated from pictures of the floor."""

    i: int
    j: int
    """Indices of the requested times, j = i + 1."""
    i_T_j: Array
    """(4, 4) motion of body axes at the camera; translation in units of the height of camera i."""
    covariance: Array
    """(6, 6), rotation first, right perturbation."""


def renumber_steps(steps: tuple[VisualStep, ...], inside: NDArray[np.bool_]) -> tuple[VisualStep, ...]:
    """Return steps whose ends are both among the chosen times (n,), a contiguous run, renumbered from 0."""
    number = np.cumsum(inside) - 1
    return tuple(
        replace(step, i=int(number[step.i]), j=int(number[step.j]))
        for step in steps
        if inside[step.i] and inside[step.j]
    )


@dataclass(frozen=True)
class Readings:
    """All readings of a flight's instruments, in body axes; None for an absent instrument."""

    gyro_rad_s: Series | None = None
    accel_m_s2: Series | None = None
    """Specific force."""
    roll_pitch_yaw_rad: Series | None = None
    range_m: Series | None = None
    """Range along the beam; see `FilterModel`."""
    velocity_m_s: Series | None = None
    """Horizontal velocity, forward and left, in axes that turn with yaw only."""
    w_p_antenna_m: Series | None = None
    """World positions (GPS); their height has an unknown zero."""
    barometer_m: Series | None = None
    """Height above an unknown zero."""
    rest_m_s: Series | None = None
    """Zeros (n, 3) at times when the vehicle is known to have zero velocity."""
    still_rad_s: Series | None = None
    """Zeros (n, 3) at times when it is known not to rotate."""
    steps: tuple[VisualStep, ...] = ()

    def between(self, start_s: float, end_s: float) -> Readings:
        """Return the readings from ``start_s`` to ``end_s``, without steps."""
        present = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "steps"}
        inside = {
            name: series.between(start_s, end_s) for name, series in present.items() if series is not None
        }
        return Readings(**inside)


READINGS = {
    "gyro": "gyro_rad_s",
    "accelerometer": "accel_m_s2",
    "attitude": "roll_pitch_yaw_rad",
    "range": "range_m",
    "velocity": "velocity_m_s",
    "position": "w_p_antenna_m",
    "barometer": "barometer_m",
    "rest": "rest_m_s",
    "still": "still_rad_s",
}
"""Channel of the filter -> its field of ``Readings``."""


@dataclass(frozen=True)
class FilterModel:
    """Model of vehicle and instruments beyond white noise; values are standard deviations.

    The defaults are those of a quiet vehicle in still air. For a flight all are replaced but the gate,
    the patience and the correlation times of errors (`slam.inertial.filter_input`).
    """

    accel_m_s2: float = 6.0
    accel_time_s: float = 0.1
    """Time constant of the acceleration, an exponentially correlated signal."""
    rate_rad_s: float = 2.0
    rate_time_s: float = 0.1
    """Time constant of the body rate, likewise."""
    gyro_offset_rad_s: float = nominal_errors.GYRO_OFFSET_RAD_S
    gyro_walk_rad_s2: float = 1e-5
    """Random walk, per root Hz."""
    accel_offset_m_s2: float = nominal_errors.ACCEL_OFFSET_M_S2
    accel_walk_m_s3: float = 1e-4
    """Random walk, per root Hz."""
    tilt_error_rad: float = 0.05
    tilt_error_time_s: float = 20.0
    """Time constant of the correlated error of the reported roll and pitch (wind, long accelerations)."""
    yaw_walk_rad: float = 0.01
    """Random walk of the reported yaw, per root second."""
    range_scale: float = 0.05
    range_offset_m: float = 0.05
    velocity_scale: float = 0.1
    velocity_error_m_s: float = 0.0
    velocity_error_time_s: float = 1.0
    """Time constant of the correlated error of the velocity."""
    barometer_walk_m: float = nominal_errors.BAROMETER_WALK_M
    """Random walk of the zero, per root second."""
    b_beam: tuple[float, float, float] = (0.0, 0.0, -1.0)
    """Unit vector of the range's beam in body axes."""
    b_p_imu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    b_p_range_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    b_p_camera_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    b_p_position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Place of the antenna. Velocity and barometric height are those of the body's origin."""
    gate_probability: float = 1e-5
    """Tail probability of the gate. A component beyond it is down-weighted to the gate; one beyond four times
    the squared gate is rejected."""
    patience_s: float = 1.0
    """Time without a reading inside the gate after which a step of the instrument's bias is assumed.
    A component without a bias is from then on down-weighted instead of rejected."""


@dataclass(frozen=True)
class InitialState:
    """Prior on the vehicle's state at the first event; standard deviations."""

    height_m: float
    height_std_m: float
    w_R_b: Array
    """(3, 3)."""
    tilt_std_rad: float = 0.3
    yaw_std_rad: float = 0.0
    """0 if the first heading defines that of the world."""
    place_m: tuple[float, float] = (0.0, 0.0)
    place_std_m: float = 0.0
    """0 if the first position defines the world's origin."""
    w_v_m_s: Array = field(default_factory=lambda: np.zeros(3))
    velocity_std_m_s: float = 1.0
    accel_std_m_s2: float = 5.0
    rate_std_rad_s: float = 2.0
    tilt_error_rad: float | None = None
    """Standard deviation of the initial error of the reported tilt; None: the stationary value."""
    yaw_zero_rad: float = 0.0
    """Zero of the reported yaw in the world: a first reading of it less the first heading. The reported tilt
    lies in the axes that it gives, which must not be far off."""
    yaw_zero_std_rad: float = 1.0
    barometer_zero_std_m: float = 100.0
    range_scale: float = 0.0
    velocity_scale: tuple[float, float] = (0.0, 0.0)
    position_zero_std_m: float = 0.0
    """Standard deviation of the zero of the positions' height above the floor."""
