"""Steps of the clock of velocity, range or barometer against that of the IMU in mid-flight.

Each of them shows how the velocity changes, which gyro and accelerometer measure too. A gap in which a clock
was set forward is closed; a step that no gap explains is told (`backend.clocks.gap_steps`,
`backend.clocks.picture_clock`). A GPS is left out: its fixes have so little weight that a step of seconds
stays within the accuracy told.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.clocks.delay_residuals import GRID_STEP_S, LONGEST_DELAY_S, DelayResiduals, thinned
from backend.clocks.gap_steps import LONGEST_LAG_S, StampGap, gaps_of_one, is_step
from backend.clocks.picture_clock import PictureClock, clock_of
from slam.core.clock_steps import told_step, told_steps_left
from slam.core.flight import STREAMS, Flight
from slam.core.rotations import roll_pitch_yaw_of
from slam.inertial.filter_input import filter_input
from slam.inertial.instruments import InertialTrust, barometer_of, range_of
from slam.inertial.motion import filter_motion

Array = NDArray[np.float64]

COMPARED = ("velocity", "sonar", "barometer")
_STEP_S = 0.02
"""Step of the motion by the IMU: a vehicle accelerates at less than 10 Hz."""
_MEAN_S = 0.25
"""Time over which readings are averaged, so that their noise does not hide changes of velocity."""
_LONGEST_CHANGE_S = 1.5
"""Over longer times the IMU's errors of tilt add up to more than vehicles accelerate."""
_LEAST_STEP_S = 0.25
"""Smallest step that is looked for: twice the largest delay (0.1 s) that errors of tilt and gain feigned in
parts of measured flights, with a fourth to spare."""
_GAIN_ERROR = 0.5
"""Largest relative error of a change of velocity: flow and range have gains, and drag looks like tilt."""
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
        at_s = np.arange(inputs.start_s, inputs.end_s, _STEP_S)
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


def without_stream_steps(flight: Flight, trust: InertialTrust) -> tuple[Flight, list[str]]:
    """Return the flight with the gaps closed in which a clock was set forward, each a warning of the flight,
    and a line for each stream whose clock steps otherwise. Raises ``InputError``."""
    streams = [name for name in COMPARED if len(_stamps_s(flight, name)) > 1]
    motion = ImuMotion.of(flight, trust) if streams else None
    if motion is None:
        return flight, []
    flight, motion = _with_imu_gaps_closed(flight, streams, motion, trust)
    left: list[str] = []
    for name in streams:
        folder = STREAMS[name].folder
        for gap in gaps_of_one(_stamps_s(flight, name), _stamps_s(flight, "imu")):
            if _fits_surely(flight, name, motion, motion.opened(gap), gap):
                flight = flight.restamped([name], gap.closed).with_warning(told_step(folder, gap, "imu0"))
        residuals = changes_against(flight, name, motion, delay_grid(_longest_delay_s(motion)))
        clock = None if residuals is None else clock_of(residuals, _GAIN_ERROR)
        if clock is not None and _steps_notably(clock) and _is_within(clock):
            left.append(told_steps_left(folder, "imu0", clock))
    return flight, left


def _with_imu_gaps_closed(
    flight: Flight, streams: list[str], motion: ImuMotion, trust: InertialTrust
) -> tuple[Flight, ImuMotion]:
    """Close the gaps in which the clock of the IMU was set forward, and of an attitude with the same gap.

    An attitude without the gap has shown already whether time was lost in it.
    """
    attitude_s = _stamps_s(flight, "attitude")
    for name in streams:
        for gap in gaps_of_one(_stamps_s(flight, "imu"), _stamps_s(flight, name)):
            if gap.is_filled_by(attitude_s) or not _fits_surely(
                flight, name, motion, motion.closed(gap), gap
            ):
                continue
            flight = flight.restamped(["imu", "attitude"], gap.closed)
            flight = flight.with_warning(told_step("imu0", gap, STREAMS[name].folder))
            moved = ImuMotion.of(flight, trust)
            assert moved is not None
            motion = moved
    return flight, motion


def _stamps_s(flight: Flight, name: str) -> Array:
    series = getattr(flight, name)
    return np.empty(0) if series is None else np.asarray(series.stamps_s)


def _is_within(clock: PictureClock) -> bool:
    """Return whether the posterior of no delay is cut off at the longest one that was tried."""
    return all(abs(p.delay_s) + 3 * p.std_s < clock.longest_s for p in clock.pieces)


def _steps_notably(clock: PictureClock) -> bool:
    delays_s = [piece.delay_s for piece in clock.pieces]
    return len(delays_s) > 1 and float(np.ptp(delays_s)) > _LEAST_STEP_S


def _longest_delay_s(motion: ImuMotion) -> float:
    return min(LONGEST_DELAY_S, 0.1 * float(motion.at_s[-1] - motion.at_s[0]))


def delay_grid(longest_s: float) -> Array:
    """Return delays (g,) from minus the longest one to it."""
    steps = int(longest_s / GRID_STEP_S)
    return np.arange(-steps, steps + 1, dtype=np.float64) * GRID_STEP_S


def _fits_surely(flight: Flight, name: str, motion: ImuMotion, other: ImuMotion, gap: StampGap) -> bool:
    """Return whether a stream fits surely better to another motion."""
    grid = delay_grid(LONGEST_LAG_S)
    return gap.lost_s > _LEAST_STEP_S and is_step(
        gap, changes_against(flight, name, motion, grid), changes_against(flight, name, other, grid)
    )


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
    block = np.unique(np.floor((stamps_s - stamps_s[0]) / _MEAN_S), return_inverse=True)[1]
    count = np.bincount(block).astype(np.float64)
    means = [np.bincount(block, column) / count for column in (stamps_s, *values.T)]
    return means[0], np.column_stack(means[1:])
