"""Measured streams, and the readings that the instruments of a model predict along a motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.streams import Truth
from slam.simulation import sensors
from slam.simulation.model import Model
from slam.simulation.motion import Motion
from slam.simulation.place.world import World, with_place_terms

Array = NDArray[np.float64]
Predict = Callable[[Motion, Array], Array]

EVERYWHERE = (-1e6, -1e6, 1e6, 1e6)
"""Extent of the floor in a replay, which has no borders."""
LOG_S = 0.001
"""Accuracy of the time of a stick change in a log. Readings that jump with the stick, as of a gyro, cannot be
predicted within this time of a change."""


@dataclass(frozen=True)
class ReplayChannel:
    """A column of a replayed stream."""

    name: str
    unit: str
    noise_std: float
    """Standard deviation of one sample according to the flight's sensor.yaml; 0 for the truth."""
    angle: bool = False
    """Whether the values are angles, whose differences are modulo whole turns."""


def display_unit(unit: str) -> tuple[float, str]:
    """Return the factor and the unit for the display of a channel: angles are shown in degrees."""
    return (float(np.degrees(1.0)), unit.replace("rad", "deg")) if unit in ("rad", "rad/s") else (1.0, unit)


@dataclass(frozen=True)
class ReplayStream:
    """Readings of one instrument at their true times according to the model."""

    times_s: Array
    values: Array
    """(n, len(channels)) readings; NaN where missing."""
    channels: tuple[ReplayChannel, ...]
    predict: Predict
    """Function of motion and times (m,) to predicted readings (m, len(channels)); NaN for no reading."""

    def within(self, begin_s: float, end_s: float) -> NDArray[np.int64]:
        """Return indices (m,) of the readings after ``begin_s`` and up to ``end_s``."""
        first, last = np.searchsorted(self.times_s, [begin_s, end_s], side="right")
        return np.arange(first, last)

    def residual(self, rows: NDArray[np.int64], predicted: Array) -> Array:
        """Return measured minus predicted readings, (m, len(channels))."""
        residual = self.values[rows] - predicted
        for k, channel in enumerate(self.channels):
            if channel.angle:
                residual[:, k] = np.angle(np.exp(1j * residual[:, k]))
        return residual


def level_ground(model: Model) -> World:
    """Return the ground of a replay: level except for the terms of the model."""
    terms = {name: values for name, values in model.terms.items() if name == "floor_slope"}
    return with_place_terms(World(extent_m=EVERYWHERE), (), terms)


def replay_streams(flight: Flight, model: Model, begin_s: float, end_s: float) -> tuple[ReplayStream, ...]:
    """Return the streams that a model can predict, without empty columns."""
    world, span_s = level_ground(model), end_s - begin_s

    def progress(times_s: Array) -> Array:
        return (times_s - begin_s) / span_s

    streams = [
        _attitude(flight, model),
        _velocity(flight, model, world, progress),
        _sonar(flight, model, world, progress),
        _imu(flight, model, progress),
        _truth(flight.truth),
    ]
    return tuple(kept for stream in streams if stream and (kept := _without_empty_columns(stream)).channels)


def _without_empty_columns(stream: ReplayStream) -> ReplayStream:
    """Return the stream without empty columns, with unwrapped angles."""
    some = np.flatnonzero(np.isfinite(stream.values).any(axis=0))
    predict_all = stream.predict

    def predict(motion: Motion, times_s: Array) -> Array:
        return predict_all(motion, times_s)[:, some]

    channels, values = tuple(stream.channels[k] for k in some), stream.values[:, some].copy()
    for k, channel in enumerate(channels):
        known = np.isfinite(values[:, k])
        if channel.angle:
            values[known, k] = np.unwrap(values[known, k])
    return ReplayStream(stream.times_s, values, channels, predict)


def _attitude(flight: Flight, model: Model) -> ReplayStream | None:
    if flight.attitude is None:
        return None
    stds = flight.attitude.noise_std_rad
    names = ("roll", "pitch", "yaw")
    channels = tuple(
        ReplayChannel(f"attitude.{n}", "rad", std, angle=True) for n, std in zip(names, stds, strict=True)
    )

    def predict(motion: Motion, times_s: Array) -> Array:
        return motion.at(times_s).roll_pitch_yaw_rad

    times = sensors.sampling_times(flight.attitude.stamps_s, model)
    return ReplayStream(times, flight.attitude.roll_pitch_yaw_rad, channels, predict)


def _velocity(
    flight: Flight, model: Model, world: World, progress: Callable[[Array], Array]
) -> ReplayStream | None:
    if flight.velocity is None:
        return None
    stds = flight.velocity.noise_std_m_s
    channels = tuple(
        ReplayChannel(f"velocity.{n}", "m/s", std) for n, std in zip(("v_x", "v_y"), stds, strict=True)
    )

    def predict(motion: Motion, times_s: Array) -> Array:
        return sensors.flow_speed(motion.at(times_s), model, world, progress(times_s))

    return ReplayStream(
        sensors.sampling_times(flight.velocity.stamps_s, model), flight.velocity.v_m_s, channels, predict
    )


def _sonar(
    flight: Flight, model: Model, world: World, progress: Callable[[Array], Array]
) -> ReplayStream | None:
    if flight.sonar is None:
        return None
    channels = (ReplayChannel("sonar.range", "m", flight.sonar.noise_std_m),)

    def predict(motion: Motion, times_s: Array) -> Array:
        emitted = motion.at(times_s - model.value("sonar_lag", "T"))
        range_m = sensors.slant_range(emitted, model, world, progress(times_s))
        return sensors.in_limits(range_m, model)[:, None]

    return ReplayStream(
        sensors.sampling_times(flight.sonar.stamps_s, model), flight.sonar.range_m[:, None], channels, predict
    )


def _imu(flight: Flight, model: Model, progress: Callable[[Array], Array]) -> ReplayStream | None:
    imu = flight.imu
    if imu is None or len(imu.stamps_s) < 2:
        return None
    per_sample = float(1 / np.sqrt(max(np.median(np.diff(imu.stamps_s)), 1e-6)))
    b_R_s = imu.b_T_s[:3, :3]
    channels = tuple(
        ReplayChannel(f"imu.{kind}_{axis}", unit, density * per_sample)
        for kind, unit, density in (
            ("gyro", "rad/s", imu.gyro_noise_density),
            ("accel", "m/s^2", imu.accel_noise_density),
        )
        for axis in "xyz"
    )

    def predict(motion: Motion, times_s: Array) -> Array:
        readings = np.hstack(sensors.inertial(motion.at(times_s), model, progress(times_s)))
        changes = motion.stick.stamps_s[1:][np.any(np.diff(motion.stick.values, axis=0) != 0, axis=1)]
        readings[_near(times_s, changes + motion.latency_s)] = np.nan
        return readings

    # The model predicts readings in body axes, so the reported mount is applied to the measurements.
    values = np.hstack([imu.gyro_rad_s @ b_R_s.T, imu.accel_m_s2 @ b_R_s.T])
    return ReplayStream(sensors.sampling_times(imu.stamps_s, model), values, channels, predict)


def _near(times_s: Array, changes_s: Array) -> NDArray[np.bool_]:
    """Return whether each time (n,) lies within ``LOG_S`` of one of the sorted changes."""
    if len(changes_s) == 0:
        return np.zeros(len(times_s), dtype=bool)
    k = np.clip(np.searchsorted(changes_s, times_s), 1, len(changes_s) - 1) if len(changes_s) > 1 else 0
    nearest = np.minimum(np.abs(times_s - changes_s[k]), np.abs(times_s - changes_s[np.maximum(k - 1, 0)]))
    return nearest <= LOG_S


def _truth(truth: Truth | None) -> ReplayStream | None:
    if truth is None:
        return None
    place = tuple(ReplayChannel(f"truth.{axis}", "m", 0.0) for axis in "xyz")
    speed = tuple(ReplayChannel(f"truth.v_{axis}", "m/s", 0.0) for axis in "xyz")
    angles = tuple(
        ReplayChannel(f"truth.{name}", "rad", 0.0, angle=True) for name in ("roll", "pitch", "yaw")
    )
    velocity = truth.w_v_m_s if truth.w_v_m_s is not None else np.full((len(truth.stamps_s), 3), np.nan)

    def predict(motion: Motion, times_s: Array) -> Array:
        state = motion.at(times_s)
        return np.hstack([state.w_p_m, state.w_v_m_s, state.roll_pitch_yaw_rad])

    values = np.hstack([truth.w_T_b[:, :3, 3], velocity, truth_angles(truth)])
    return ReplayStream(truth.stamps_s, values, place + speed + angles, predict)


def truth_angles(truth: Truth) -> Array:
    """Return roll, pitch and unwrapped yaw (n, 3) of reference poses."""
    R = truth.w_T_b[:, :3, :3]
    pitch = -np.arcsin(np.clip(R[:, 2, 0], -1, 1))
    roll, yaw = np.arctan2(R[:, 2, 1], R[:, 2, 2]), np.arctan2(R[:, 1, 0], R[:, 0, 0])
    return np.column_stack([roll, pitch, np.unwrap(yaw)])
