"""How the vehicle turned from picture to picture, before there is a map.

The clock of the pictures is found from these turns, so that every stage reads the instruments at the right
times: a wrong clock bends a map, and makes true links across a pause look false.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.clocks.picture_clock import PictureClock, picture_clock
from backend.clocks.windows import ClockDisagreement, clock_disagreements
from frontend.lift import LiftedPoses, lift
from frontend.tracked import IntermediateFrame
from slam.core.flight import Flight
from slam.core.instrument_readings import inertial_readings
from slam.mapping.front_end import Observations
from slam.mapping.setup import Setup

Array = NDArray[np.float64]


def tracked_clock(flight: Flight, observations: Observations, setup: Setup) -> PictureClock | None:
    """Estimate the delay of the pictures' clock from tracked pictures; None without a gyro, or where it does
    not explain how the pictures turn."""
    readings = inertial_readings(flight.imu)
    if readings is None:
        return None
    turns = turned_attitudes(observations, setup)
    return picture_clock(*turns, readings)


def disagreements_left(
    flight: Flight, observations: Observations, setup: Setup
) -> tuple[ClockDisagreement, ...]:
    """Return the times in which the pictures, stamped as the map has them, turn earlier or later than the
    gyro says; none without a gyro."""
    readings = inertial_readings(flight.imu)
    return () if readings is None else clock_disagreements(*turned_attitudes(observations, setup), readings)


def turned_attitudes(observations: Observations, setup: Setup) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return stamps (n,) in order, attitudes (n, 3, 3) and chain numbers (n,) of the tracked pictures.

    The attitudes of one chain are relative to each other; no picture links two chains.
    """
    rows, lifted = _lifted(observations, setup)
    k = np.array([row.keyframe for row in rows], dtype=np.int64)
    n, keyframe_of = len(observations.stamps_s), {int(f): j for j, f in enumerate(observations.frame_index)}
    attitude, chain = np.tile(np.eye(3), (n, 1, 1)), np.arange(n)
    for m in np.flatnonzero(lifted.usable):  # in the order of the keyframes
        if (j := keyframe_of.get(rows[m].frame)) is not None:
            attitude[j], chain[j] = attitude[k[m]] @ lifted.i_T_j[m, :3, :3], chain[k[m]]
    between = np.array(
        [m for m in np.flatnonzero(lifted.usable) if rows[m].frame not in keyframe_of], dtype=np.int64
    )
    frames = np.concatenate(
        [observations.frame_index, np.array([rows[m].frame for m in between], dtype=np.int64)]
    )
    attitudes = np.concatenate([attitude, attitude[k[between]] @ lifted.i_T_j[between, :3, :3]])
    chains = np.concatenate([chain, chain[k[between]]])
    stamps_s, first = np.unique(observations.frame_stamps_s[frames], return_index=True)
    return stamps_s, attitudes[first], chains[first]


def picture_speeds(observations: Observations, setup: Setup) -> tuple[Array, Array]:
    """Return times (n,) between tracked pictures and the speed there, in heights above the floor a second."""
    rows, lifted = _lifted(observations, setup)
    at_s, speed = [], []
    previous: tuple[int, float, Array] | None = None
    for m in np.flatnonzero(lifted.usable):
        keyframe, place = rows[m].keyframe, lifted.i_T_j[m, :3, 3]
        if previous is None or previous[0] != keyframe:
            previous = keyframe, float(observations.stamps_s[keyframe]), np.zeros(3)
        stamp_s = float(observations.frame_stamps_s[rows[m].frame])
        if stamp_s > previous[1]:
            at_s.append(0.5 * (stamp_s + previous[1]))
            speed.append(float(np.linalg.norm(place - previous[2])) / (stamp_s - previous[1]))
        previous = keyframe, stamp_s, place
    return np.array(at_s), np.array(speed)


def _lifted(observations: Observations, setup: Setup) -> tuple[list[IntermediateFrame], LiftedPoses]:
    """Return the pictures registered to each keyframe, and their poses relative to it."""
    rows = [row for frames in observations.registered() for row in frames[1:]]  # not the keyframe itself
    k = np.array([row.keyframe for row in rows], dtype=np.int64)
    lifted = lift(
        np.array([row.i_H_j for row in rows]).reshape(-1, 3, 3),
        np.array([row.corner_covariance for row in rows]).reshape(-1, 8, 8),
        setup.camera,
        setup.readings.roll_pitch_rad[k],
        setup.readings.roll_pitch_std_rad[k],
    )
    return rows, lifted
