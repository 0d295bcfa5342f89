"""Which of several recordings of a flight has the pictures of the camera that looks down."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from backend.clocks.delay_residuals import gyro_attitudes
from slam.core.flight import Flight
from slam.core.instrument_readings import inertial_readings
from slam.core.messages import Message, about
from slam.core.names import listed
from slam.core.progress import Progress
from slam.io.down_looking import MAX_TILT_DEG, Look, axis_tilt_deg
from slam.io.recordings.camera_views import CameraLook, look_by_instruments, look_by_pictures
from slam.io.recordings.recording import Burst
from slam.io.recordings.schedule import CHAIN, GLANCE, Schedule

_AROUND_S = 0.1
"""The gyro must cover a stretch with so much time on either side."""


@dataclass(frozen=True)
class ChosenCamera:
    """The recording whose pictures are taken."""

    recording: int
    remark: Message
    """A sentence about why."""

    def alone(self, number: int, flight: Flight) -> Flight:
        """Return a recording without its pictures, unless it is the chosen one."""
        if number == self.recording or flight.frames is None:
            return flight
        others = tuple(message for message in flight.messages if message.about != "cam0")
        return replace(flight, frames=None, camera=None, messages=others)


def chosen_camera(flights: Sequence[Flight], progress: Progress) -> ChosenCamera | None:
    """Return the first recording whose camera looks down, by its mount or by its pictures.

    Without such a one, it is the first of which nothing is known. None where at most one has pictures.
    """
    able = [k for k, flight in enumerate(flights) if flight.frames is not None and flight.camera is not None]
    if len(able) < 2:
        return None
    looks = {}
    for done, k in enumerate(able):
        progress("looking where the cameras look", done, len(able))
        looks[k] = _look(flights[k])
    best = min(able, key=lambda k: looks[k].look)
    names = [f"{flights[k].name} ({looks[k].sentence})" for k in able]
    remark = about("cam0", f"of several cameras, that of {flights[best].name} is taken: {listed(names, 4)}")
    if looks[best].look != Look.DOWN:
        remark = remark.extended(
            "whether it looks down is not known: give the one that does first, or only that one"
        )
    return ChosenCamera(best, remark)


def _look(flight: Flight) -> CameraLook:
    camera = flight.camera
    assert camera is not None
    tilt_deg = axis_tilt_deg(camera.b_T_c[:3, 2])
    if tilt_deg > MAX_TILT_DEG:
        return CameraLook(Look.ASIDE, f"looks {tilt_deg:.0f} degrees aside by its mount", tilt_deg)
    if flight.imu is not None:
        look = look_by_instruments(camera, _bursts(flight, GLANCE))
        if look.look != Look.UNKNOWN:
            return look
    return look_by_pictures(camera, _bursts(flight, CHAIN))


def _bursts(flight: Flight, when: Schedule) -> Iterator[Burst]:
    """Yield stretches of the pictures of a recording, with the turns by its own gyro if it has one."""
    frames, readings = flight.frames, inertial_readings(flight.imu)
    assert frames is not None
    stamps_s = frames.stamps_s
    if len(stamps_s) < 2:
        return
    for start_s in (stamps_s[0] + when.starts_s(float(stamps_s[-1] - stamps_s[0]))).tolist():
        first = int(np.searchsorted(stamps_s, start_s))
        wanted_s = stamps_s[min(first, len(stamps_s) - 1)] + np.array([0.0, *when.after_s]) - 1e-6
        rows = np.unique(np.searchsorted(stamps_s, wanted_s))
        rows = rows[rows < len(stamps_s)]
        rows = rows[stamps_s[rows] - start_s <= when.longest_s]
        if len(rows) < 2:
            continue
        at_s, pictures = stamps_s[rows], tuple(frames.load(int(k)) for k in rows)
        attitude = up = None
        if readings is not None:
            near = (readings.stamps_s > at_s[0] - _AROUND_S) & (readings.stamps_s < at_s[-1] + _AROUND_S)
            covers = readings.stamps_s[0] <= at_s[0] and readings.stamps_s[-1] >= at_s[-1]
            if covers and near.any():
                attitude, up = gyro_attitudes(readings, at_s), readings.accel_m_s2[near].mean(axis=0)
        yield Burst(at_s, pictures, attitude, up)
