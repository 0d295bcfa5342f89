"""Motion of the vehicle that one recording shows: its turns, and its speed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.clocks.alignment import Turns
from backend.clocks.delay_residuals import gyro_attitudes
from backend.clocks.lag_profile import Signal
from backend.clocks.picture_clock import GAIN_ERROR
from backend.measurements import InertialReadings
from slam.core.flight import Flight
from slam.core.geodesy import METRES_PER_DEGREE, metres_per_degree_east
from slam.core.instrument_readings import inertial_readings
from slam.core.progress import Progress
from slam.core.rotations import rotation_of
from slam.core.streams import Frames
from slam.mapping.calibration.picture_turns import picture_speeds, turned_attitudes
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import FrontEnd, Observations
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.setup import Setup

Array = NDArray[np.float64]

_PICTURE_RATE_HZ = 10.0
"""Vehicles turn and brake at less than 5 Hz."""
_MOST_PICTURES, _BURST_S = 3000, 30.0
"""Pictures that are tracked: five minutes, or bursts of a longer video, so that its length costs no time."""
_WIDTH_PX = 640
"""Width to which pictures are reduced; a turn shows in any size."""
_LEAST_RATE_HZ = 5.0
"""Slower attitudes miss turns between them."""
_LONGEST_GAP_S = 2.5
"""Longest gap between two speeds over which a vehicle keeps its speed; GPS has one fix a second."""


@dataclass(frozen=True)
class RecordedMotion:
    """The motion that one recording shows; pictures are tracked when they are first needed."""

    flight: Flight
    progress: Progress

    @cached_property
    def gyro(self) -> InertialReadings | None:
        """The gyro, or the rates of an attitude; None where the recording has neither."""
        by_gyro = inertial_readings(self.flight.imu)
        if by_gyro is not None:
            return by_gyro
        turns = self.attitude_turns
        if turns is None:
            return None
        # A rate in the middle of each turn, so that their integral is the attitude's.
        lasts_s = np.diff(turns.stamps_s)[:, None]
        relative = np.swapaxes(turns.w_R_b[:-1], 1, 2) @ turns.w_R_b[1:]
        rate = Rotation.from_matrix(relative).as_rotvec() / lasts_s
        return InertialReadings(turns.stamps_s[:-1] + 0.5 * lasts_s[:, 0], rate, np.zeros_like(rate))

    @cached_property
    def attitude_turns(self) -> Turns | None:
        """The attitude stream; None where it is missing or slow."""
        series = self.flight.attitude
        if series is None:
            return None
        known = np.isfinite(series.roll_pitch_yaw_rad).all(axis=1)
        stamps_s, first = np.unique(series.stamps_s[known], return_index=True)
        if len(stamps_s) < 2 or np.median(np.diff(stamps_s)) > 1 / _LEAST_RATE_HZ:
            return None
        attitude = rotation_of(series.roll_pitch_yaw_rad[known][first])
        return Turns(stamps_s, attitude, np.zeros(len(stamps_s), np.int64))

    @cached_property
    def turns(self) -> tuple[str, Turns] | None:
        """The turns and the stream that shows them: gyro, attitude, or pictures."""
        by_gyro = inertial_readings(self.flight.imu)
        if by_gyro is not None:
            return "imu0", gyro_turns(by_gyro)
        if self.attitude_turns is not None:
            return "attitude0", self.attitude_turns
        if self._tracked is None:
            return None
        camera = self._tracked[1].camera
        stamps_s, attitude, chain = turned_attitudes(*self._tracked)
        return "cam0", Turns(stamps_s, attitude, chain, GAIN_ERROR + 2 * camera.focal_std_ratio)

    @cached_property
    def speed(self) -> tuple[str, Signal] | None:
        """The speed and the stream that shows it: GPS, the velocity, or pictures in heights per second."""
        flight = self.flight
        if flight.velocity is not None:
            known = np.isfinite(flight.velocity.v_m_s).all(axis=1)
            speed = np.linalg.norm(flight.velocity.v_m_s[known], axis=1)
            return _speed("velocity0", flight.velocity.stamps_s[known], speed)
        if flight.gps is not None:
            return _speed("gps0", *_gps_speed(flight))
        return None if self._tracked is None else _speed("cam0", *picture_speeds(*self._tracked))

    @cached_property
    def _tracked(self) -> tuple[Observations, Setup] | None:
        flight, config = _sampled(self.flight), PipelineConfig()
        if flight.camera is None or flight.frames is None or not len(flight.frames):
            return None
        features = replace(config.features, kind="orb", max_side_px=_WIDTH_PX)
        config = replace(config, features=features)
        seen = FrontEnd(flight, flight.camera, config, self._report).track()
        alone = replace(flight, gps=None, sonar=None)
        readings = KeyframeReadings.at(alone, seen.stamps_s, None, config)
        return (seen, Setup(flight.camera, readings, config)) if len(seen.stamps_s) > 1 else None

    def _report(self, stage: str, done: int, total: int) -> None:
        self.progress(f"track pictures of {self.flight.name} for the clock", done, total)


def gyro_turns(readings: InertialReadings) -> Turns:
    """Return the attitudes by a gyro at the rate of pictures."""
    stamps_s = np.arange(readings.stamps_s[0], readings.stamps_s[-1], 1 / _PICTURE_RATE_HZ)
    return Turns(stamps_s, gyro_attitudes(readings, stamps_s), np.zeros(len(stamps_s), np.int64))


def _speed(stream: str, stamps_s: Array, speed: Array) -> tuple[str, Signal] | None:
    stamps_s, first = np.unique(stamps_s, return_index=True)
    if len(stamps_s) < 2:
        return None
    return stream, Signal.sampled(stamps_s, speed[first, None], _LONGEST_GAP_S)


def _gps_speed(flight: Flight) -> tuple[Array, Array]:
    """Return times between fixes and speeds over the ground."""
    gps = flight.gps
    assert gps is not None
    known = np.isfinite(gps.latitude_deg) & np.isfinite(gps.longitude_deg)
    stamps_s, north_deg, east_deg = (x[known] for x in (gps.stamps_s, gps.latitude_deg, gps.longitude_deg))
    if len(stamps_s) < 2:
        return np.empty(0), np.empty(0)
    per_degree = np.array([METRES_PER_DEGREE, metres_per_degree_east(float(north_deg[0]))])
    way_m = np.linalg.norm(np.diff(np.column_stack([north_deg, east_deg]), axis=0) * per_degree, axis=1)
    lasts_s = np.diff(stamps_s)
    good = lasts_s > 0
    return (stamps_s[:-1] + 0.5 * lasts_s)[good], way_m[good] / lasts_s[good]


def _sampled(flight: Flight) -> Flight:
    """Return the flight with the pictures that are tracked."""
    frames = flight.frames
    if frames is None or not len(frames):
        return flight
    since_s = frames.stamps_s - frames.stamps_s[0]
    index = np.unique(np.floor(since_s * _PICTURE_RATE_HZ + 1e-6), return_index=True)[1]
    if len(index) > _MOST_PICTURES:
        bursts = _MOST_PICTURES / (_BURST_S * _PICTURE_RATE_HZ)
        period_s = float(since_s[-1]) / bursts
        index = index[since_s[index] % period_s < _BURST_S]
    names = tuple(frames.names[k] for k in index.tolist())
    taken = Frames(frames.stamps_s[index], names, lambda k: frames.load(int(index[k])))
    return replace(flight, frames=taken)
