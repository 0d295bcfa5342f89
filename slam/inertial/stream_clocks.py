"""Steps of the clock of velocity, range or barometer against that of the IMU in mid-flight.

Each of them shows how the velocity changes, which gyro and accelerometer measure too. A gap in which a clock
was set forward is closed; a step that no gap explains is told (`backend.clocks.gap_steps`,
`backend.clocks.picture_clock`). The clock of a GPS is not compared.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.clocks.delay_residuals import LONGEST_DELAY_S
from backend.clocks.gap_steps import LONGEST_LAG_S, StampGap, gaps_of_one, is_step
from backend.clocks.picture_clock import PictureClock, clock_of
from slam.core.clock_steps import step_warning, steps_left_warning
from slam.core.flight import Flight
from slam.core.messages import Message
from slam.core.streams import STREAMS
from slam.inertial.imu_motion import COMPARED, ImuMotion, changes_against, delay_grid
from slam.inertial.instruments import InertialTrust

Array = NDArray[np.float64]

_LEAST_STEP_S = 0.25
"""Smallest step that is looked for: twice the largest delay (0.1 s) that errors of tilt and gain feigned in
parts of measured flights, with a fourth to spare."""
_GAIN_ERROR = 0.5
"""Largest relative error of a change of velocity: flow and range have gains, and drag looks like tilt."""


def without_stream_steps(
    flight: Flight, motion: ImuMotion, trust: InertialTrust
) -> tuple[Flight, ImuMotion, list[Message]]:
    """Return the flight with the gaps closed in which a clock was set forward, each a warning of the flight;
    the motion by its IMU; and a line for each stream whose clock steps otherwise. Raises ``InputError``."""
    streams = [name for name in COMPARED if len(_stamps_s(flight, name)) > 1]
    flight, motion = _with_imu_gaps_closed(flight, streams, motion, trust)
    left: list[Message] = []
    for name in streams:
        folder = STREAMS[name].folder
        for gap in gaps_of_one(_stamps_s(flight, name), _stamps_s(flight, "imu")):
            if _fits_surely(flight, name, motion, motion.opened(gap), gap):
                flight = flight.restamped([name], gap.closed).with_warning(step_warning(folder, gap, "imu0"))
        residuals = changes_against(flight, name, motion, delay_grid(_longest_delay_s(motion)))
        clock = None if residuals is None else clock_of(residuals, _GAIN_ERROR)
        if clock is not None and _steps_notably(clock) and _is_within(clock):
            left.append(steps_left_warning(folder, "imu0", clock))
    return flight, motion, left


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
            flight = flight.with_warning(step_warning("imu0", gap, STREAMS[name].folder))
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


def _fits_surely(flight: Flight, name: str, motion: ImuMotion, other: ImuMotion, gap: StampGap) -> bool:
    """Return whether a stream fits surely better to another motion."""
    grid = delay_grid(LONGEST_LAG_S)
    return gap.lost_s > _LEAST_STEP_S and is_step(
        gap, changes_against(flight, name, motion, grid), changes_against(flight, name, other, grid)
    )
