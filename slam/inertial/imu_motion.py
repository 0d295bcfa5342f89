"""Motion by gyro, accelerometer and attitude alone, beside which other streams are compared.

Its velocity drifts, but changes of velocity within a second or two are those of the vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.clocks.delay_residuals import GRID_STEP_S, DelayResiduals, thinned
from backend.clocks.gap_steps import StampGap
from slam.core.flight import Flight
from slam.core.rotations import roll_pitch_yaw_of
from slam.inertial.filter_input import filter_input
from slam.inertial.instruments import InertialTrust, barometer_of, range_of
from slam.inertial.motion import filter_motion
from slam.inertial.window_means import window_means

Array = NDArray[np.float64]

COMPARED = ("velocity", "sonar", "barometer")
"""Streams that show how velocity or height changes."""
STEP_S = 0.02
"""Step of the motion by the IMU: a vehicle accelerates at less than 10 Hz."""
_MEAN_S = 0.25
"""Time over which readings are averaged, so that their noise does not hide changes of velocity."""
_LONGEST_CHANGE_S = 1.5
"""Over longer times the IMU's errors of tilt add up to more than vehicles accelerate."""
_LONGEST_GAP_S = 60.0
"""Longest gap of the IMU that steps bridge. Beyond it nothing is left of the motion, and the steps of a day
would fill the memory."""
_LEAST_CHANGES = 40
"""Fewer changes of velocity do not show a clock surely."""


@dataclass(frozen=True)
class ImuMotion:
    """Motion by gyro, accelerometer and attitude alone; its velocity drifts."""

    at_s: Array
    w_v_m_s: Array
    roll_pitch_yaw: Array
    """(n, 3), the yaw unwrapped."""

    @staticmethod
    def of(flight: Flight, trust: InertialTrust) -> ImuMotion | None:
        """Return the motion; None without an IMU."""
        if flight.imu is None or len(flight.imu.stamps_s) < 2:
            return None
        inputs = filter_input(replace(flight, velocity=None, sonar=None, barometer=None, gps=None), trust)
        at_s = np.arange(inputs.start_s, inputs.end_s, STEP_S)
        imu_s = flight.imu.stamps_s
        after = np.searchsorted(imu_s, at_s).clip(1, len(imu_s) - 1)
        at_s = at_s[imu_s[after] - imu_s[after - 1] < _LONGEST_GAP_S]
        if len(at_s) < 2:
            return None
        states = filter_motion(inputs, at_s).smoothed
        assert states is not None
        angles = roll_pitch_yaw_of(states.w_T_b[:, :3, :3])
        angles[:, 2] = np.unwrap(angles[:, 2])
        return ImuMotion(at_s, states.w_v_m_s, angles)

    def opened(self, gap: StampGap) -> ImuMotion:
        """Return the motion as it is where no time was lost in the gap of another stream."""
        return replace(self, at_s=gap.opened(self.at_s))

    def closed(self, gap: StampGap) -> ImuMotion:
        """Return the motion as it is where no time was lost in the gap of the IMU."""
        known = (self.at_s <= gap.last_s) | (self.at_s > gap.last_s + gap.lost_s)
        return ImuMotion(gap.closed(self.at_s[known]), self.w_v_m_s[known], self.roll_pitch_yaw[known])

    def angles_at(self, stamps_s: Array) -> Array:
        """Return roll, pitch and yaw (n, 3)."""
        return np.column_stack([np.interp(stamps_s, self.at_s, a) for a in self.roll_pitch_yaw.T])

    def residuals(
        self, stamps_s: Array, w_v_m_s: Array, axes: list[int], delays_s: Array
    ) -> DelayResiduals | None:
        """Compare changes of a velocity (n, c) along some axes of the world, whose stamps are sorted."""
        rows = thinned(stamps_s)
        stamps_s, w_v_m_s = stamps_s[rows], w_v_m_s[rows]
        if len(stamps_s) < 2:
            return None
        begin_s, end_s = stamps_s[:-1], stamps_s[1:]
        kept = (begin_s - delays_s[-1] >= self.at_s[0]) & (end_s - delays_s[0] <= self.at_s[-1])
        kept &= end_s - begin_s < _LONGEST_CHANGE_S
        if kept.sum() < _LEAST_CHANGES:
            return None
        at_s = stamps_s[:, None] - delays_s
        made = np.stack([np.interp(at_s, self.at_s, self.w_v_m_s[:, axis]) for axis in axes], axis=-1)
        change = np.diff(w_v_m_s, axis=0)[kept]
        difference = change[:, None] - np.diff(made, axis=0)[kept]
        return DelayResiduals(delays_s, begin_s[kept], end_s[kept], change, difference)


def delay_grid(longest_s: float) -> Array:
    """Return delays (g,) from minus the longest one to it."""
    steps = int(longest_s / GRID_STEP_S)
    return np.arange(-steps, steps + 1, dtype=np.float64) * GRID_STEP_S


def changes_against(flight: Flight, name: str, motion: ImuMotion, delays_s: Array) -> DelayResiduals | None:
    """Compare the changes of velocity that a stream shows with those of the motion, at delays (g,)."""
    stamps_s, w_v_m_s, axes = _velocity(flight, name, motion)
    return motion.residuals(stamps_s, w_v_m_s, axes, delays_s)


def _velocity(flight: Flight, name: str, motion: ImuMotion) -> tuple[Array, Array, list[int]]:
    """Return stamps (n,), the velocity (n, c) that a stream shows, and its axes of the world."""
    stamps_s, values, axes = readings_in_world(flight, name, motion)
    stamps_s, values = _averaged(stamps_s, values)
    if name == "velocity":
        return stamps_s, values, axes
    steps_s = np.diff(stamps_s)
    short = steps_s < _LONGEST_CHANGE_S
    middle_s = 0.5 * (stamps_s[1:] + stamps_s[:-1])
    return middle_s[short], (np.diff(values, axis=0) / steps_s[:, None])[short], axes


def readings_in_world(flight: Flight, name: str, motion: ImuMotion) -> tuple[Array, Array, list[int]]:
    """Return stamps (n,), velocities or heights (n, c) of a stream of ``COMPARED``, and their axes of the
    world."""
    if name == "velocity":
        assert flight.velocity is not None
        known = np.isfinite(flight.velocity.v_m_s).all(axis=1)
        stamps_s, v = flight.velocity.stamps_s[known], flight.velocity.v_m_s[known]
        along = (v[:, 0] + 1j * v[:, 1]) * np.exp(1j * motion.angles_at(stamps_s)[:, 2])
        return stamps_s, np.column_stack([along.real, along.imag]), [0, 1]
    heights = (range_of if name == "sonar" else barometer_of)(flight, InertialTrust())
    if heights is None:
        return np.empty(0), np.empty((0, 1)), [2]
    known = np.isfinite(heights.values[:, 0])
    stamps_s, values = heights.stamps_s[known], heights.values[known]
    if name == "sonar":
        values = values * np.cos(motion.angles_at(stamps_s)[:, :2]).prod(axis=1)[:, None]
    return stamps_s, values, [2]


def _averaged(stamps_s: Array, values: Array) -> tuple[Array, Array]:
    """Return means of stamps (n,) and values (n, c) over successive equal times."""
    if len(stamps_s) == 0:
        return stamps_s, values
    _, means = window_means(stamps_s, np.column_stack([stamps_s, values]), stamps_s[0], _MEAN_S)
    return means[:, 0], means[:, 1:]
