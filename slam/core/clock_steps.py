"""Steps of the clock of gyro or attitude in mid-flight: taken out where a gap shows whose, else told.

Each of the two shows how the vehicle turned. A clock that is set forward leaves a gap in one of them, behind
which the turns of both agree only once the gap is closed (`backend.clocks.gap_steps`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.clocks.delay_residuals import GRID_STEP_S, DelayResiduals, residuals_at, thinned
from backend.clocks.gap_steps import LONGEST_LAG_S, StampGap, gaps_of_one, is_step
from backend.clocks.picture_clock import PictureClock, picture_clock
from backend.measurements import InertialReadings
from slam.core.flight import Flight
from slam.core.instrument_readings import MAX_GAP_S, attitude_readings, inertial_readings
from slam.core.messages import Message, about, warning
from slam.core.rotations import rotation_of
from slam.core.units import with_error

Array = NDArray[np.float64]

_DELAYS_S = np.arange(-LONGEST_LAG_S, LONGEST_LAG_S + GRID_STEP_S / 2, GRID_STEP_S)


def without_clock_steps(flight: Flight) -> Flight:
    """Return the flight with the gaps closed in which the clock of gyro or attitude was set forward.

    Each is a warning of the flight.
    """
    if inertial_readings(flight.imu) is None or flight.attitude is None:
        return flight
    for _ in range(2):  # a gap that is closed may hide the effect of another one
        before = flight
        for name, other in (("imu", "attitude"), ("attitude", "imu")):
            for gap in gaps_of_one(getattr(flight, name).stamps_s, getattr(flight, other).stamps_s):
                if _is_set_forward(flight, name, gap):
                    flight = flight.restamped([name], gap.closed).with_warning(
                        step_warning(f"{name}0", gap, f"{other}0")
                    )
        if flight is before:
            break
    return flight


def step_warning(folder: str, gap: StampGap, other: str) -> Message:
    """Describe a gap that was closed because the motion in ``other`` shows that no time was lost."""
    return about(
        folder,
        f"its clock steps by {gap.lost_s:+.3f} s at {gap.last_s:.2f} s, as the motion in {other} "
        "shows: no time was lost there, and its later stamps are corrected",
        "check the recorder's clock",
    )


def clock_step_left(flight: Flight) -> Message | None:
    """Describe where the clocks of gyro and attitude step against each other; None where they do not."""
    clock = attitude_clock(flight)
    if clock is None or len(clock.pieces) < 2:
        return None
    return steps_left_warning("attitude0", "imu0", clock)


def steps_left_warning(folder: str, other: str, clock: PictureClock) -> Message:
    """Describe steps of a stream's clock against that of another one that are not corrected."""
    return warning(
        f"the clock of {folder} steps against that of {other} by {step_sizes(clock)}, which is not "
        f"corrected: the readings of one of them are taken at wrong times",
        "check the stamps of both",
    )


def step_sizes(clock: PictureClock) -> str:
    """Describe where and by how much a clock steps, at most the first three times."""
    steps = [
        f"{with_error(after.delay_s - before.delay_s, np.hypot(after.std_s, before.std_s), '+')} s at "
        f"{after.begin_s:.2f} s"
        for before, after in zip(clock.pieces, clock.pieces[1:], strict=False)
    ]
    more = f" and {len(steps) - 3} times more" if len(steps) > 3 else ""
    return f"{', '.join(steps[:3])}{more}"


def attitude_clock(flight: Flight) -> PictureClock | None:
    """Return by how much the attitude is stamped after the gyro's reading of that moment.

    None where one of the two is missing, and where the gyro does not explain the attitude's turns.
    """
    readings, turned = inertial_readings(flight.imu), _attitude(flight)
    return None if readings is None or turned is None else picture_clock(*turned, readings)


def _attitude(flight: Flight) -> tuple[Array, Array, NDArray[np.int64]] | None:
    """Return stamps (n,), rotations (n, 3, 3), and the run of each between two gaps; None without two."""
    stamps_s, angles = np.empty(0), np.empty((0, 3))
    if flight.attitude is not None:
        stamps_s, angles = attitude_readings(flight.attitude)
    if len(stamps_s) < 2:
        return None
    return stamps_s, rotation_of(angles), np.append(0, np.cumsum(np.diff(stamps_s) > MAX_GAP_S))


def _is_set_forward(flight: Flight, name: str, gap: StampGap) -> bool:
    """Return whether a gap of imu or attitude is a step of its clock."""
    readings, turned = inertial_readings(flight.imu), _attitude(flight)
    if readings is None or turned is None:
        return False
    change = gap.closed if name == "imu" else gap.opened
    moved = replace(readings, stamps_s=change(readings.stamps_s))
    return is_step(gap, _residuals(turned, readings), _residuals(turned, moved))


def _residuals(
    turned: tuple[Array, Array, NDArray[np.int64]], readings: InertialReadings
) -> DelayResiduals | None:
    stamps_s, w_R_b, chain = turned
    rows = thinned(stamps_s)
    return residuals_at(_DELAYS_S, stamps_s[rows], w_R_b[rows], chain[rows], readings)
