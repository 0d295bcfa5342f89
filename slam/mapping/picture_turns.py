"""How the vehicle turned from picture to picture, before there is a map.

The clock of the pictures is found from these turns, so that every stage reads the instruments at the right
times: a wrong clock bends a map, and makes true links across a pause look false.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.inertial_scale.picture_clock import PictureClock, picture_clock
from frontend.lift import lift
from slam.core.flight import Flight
from slam.mapping.front_end import Observations
from slam.mapping.keyframe_readings import inertial_readings
from slam.mapping.setup import Setup

Array = NDArray[np.float64]


def tracked_clock(flight: Flight, observations: Observations, setup: Setup) -> PictureClock | None:
    """Estimate the delay of the pictures' clock from tracked pictures; None without a gyro, or where it does
    not explain how the pictures turn."""
    readings = inertial_readings(flight.imu)
    if readings is None:
        return None
    return picture_clock(*turned_attitudes(observations, setup), readings)


def turned_attitudes(observations: Observations, setup: Setup) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return stamps (n,) in order, attitudes (n, 3, 3) and chain numbers (n,) of the tracked pictures.

    The attitudes of one chain are relative to each other; no picture links two chains.
    """
    rows = [
        (k, frame, i_H_j, covariance)
        for k, tracked in enumerate(_tracked(observations))
        for frame, i_H_j, covariance in tracked
    ]
    k = np.array([row[0] for row in rows], dtype=np.int64)
    lifted = lift(
        np.array([row[2] for row in rows]).reshape(-1, 3, 3),
        np.array([row[3] for row in rows]).reshape(-1, 8, 8),
        setup.camera,
        setup.readings.roll_pitch_rad[k],
        setup.readings.roll_pitch_std_rad[k],
    )
    usable, keyframe_of = lifted.usable, {int(f): n for n, f in enumerate(observations.frame_index)}
    attitude = np.tile(np.eye(3), (len(observations.stamps_s), 1, 1))
    chain = np.arange(len(attitude))
    # A row of ``attitude`` is a view: it is filled below.
    found = [(int(frame), attitude[n], n) for n, frame in enumerate(observations.frame_index)]
    for m, (i, frame, *_) in enumerate(rows):  # in the order of the keyframes
        if not usable[m]:
            continue
        if frame not in keyframe_of:
            found.append((frame, attitude[i] @ lifted.i_T_j[m, :3, :3], i))
            continue
        j = keyframe_of[frame]
        attitude[j], chain[j] = attitude[i] @ lifted.i_T_j[m, :3, :3], chain[i]
    if not found:
        return np.empty(0), np.empty((0, 3, 3)), np.empty(0, np.int64)
    frames = np.array([row[0] for row in found], dtype=np.int64)
    stamps_s, first = np.unique(observations.frame_stamps_s[frames], return_index=True)
    attitudes, home = np.array([row[1] for row in found]), np.array([row[2] for row in found], dtype=np.int64)
    return stamps_s, attitudes[first], chain[home[first]]


def _tracked(observations: Observations) -> list[list[tuple[int, Array, Array]]]:
    """Return, for each keyframe, frame number, homography (3, 3) into its picture and its corner covariance
    (8, 8) of the frames that were registered to it in tracking."""
    tracked: list[list[tuple[int, Array, Array]]] = [[] for _ in observations.frame_index]
    for passed in observations.passed:
        tracked[passed.keyframe].append((passed.frame, passed.i_H_j, passed.corner_covariance))
    for link in observations.links:
        if link is not None:
            frame = int(observations.frame_index[link.j])
            tracked[link.i].append((frame, link.i_H_j, link.corner_covariance))
    return tracked
