"""Instruments: the readings of each along a motion, with its clock, its noise and the model's terms.

Each instrument draws from its own random generators. So a change to one leaves the readings of the others as
they were. Each term also draws from its own generator. So a model with a term differs from one without it in
that term alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.recursion import recursion
from slam.core.streams import AttitudeSeries, Command, Imu, Sonar, Velocity
from slam.simulation.chance import generator
from slam.simulation.instruments import Rate
from slam.simulation.model import Model
from slam.simulation.motion import State, Trajectory
from slam.simulation.place.terrain import first_echo
from slam.simulation.place.world import World
from slam.simulation.state import Z
from slam.simulation.stick import Stick
from slam.simulation.terms import CATALOGUE

__all__ = ["Rate", "stamps"]

Array = NDArray[np.float64]

LATEST_START_S = 0.25
"""Each stream takes its first sample within this time."""
SECOND_ECHO_STD = 0.05
"""Standard deviation of a second echo, relative to the range."""


def stamps(rate_hz: float, duration_s: float, rng: np.random.Generator) -> Array:
    """Return regular stamps (n,), n >= 1, in whole nanoseconds, from a random start to the flight's end."""
    first = rng.uniform(0.0, min(LATEST_START_S, duration_s))
    count = int((duration_s - first) * rate_hz) + 1
    return np.round(first + np.arange(count) / rate_hz, 9)


def autoregressive(white: Array, correlation: float) -> Array:
    """Turn white noise (n, ...) into a first-order autoregression of the same standard deviation."""
    if correlation == 0.0:
        return white
    white = np.concatenate([white[:1], np.sqrt(1.0 - correlation**2) * white[1:]])
    return recursion(white, correlation)


def clock_stamps(times_s: Array, model: Model, rng: np.random.Generator) -> Array:
    """(n,) what the vehicle's clock says of readings sampling_times at ``times_s``: ``clock_drift``,
    ``timestamp_jitter``."""
    late = times_s * model.value("clock_drift", "ppm") * 1e-6
    late = late + rng.normal(0.0, model.value("timestamp_jitter", "sigma"), len(times_s))
    # Despite the jitter, stamps increase by at least a nanosecond.
    apart = 1e-9 * np.arange(len(times_s))
    return np.asarray(np.maximum.accumulate(np.round(times_s + late, 9) - apart) + apart)


def sampling_times(stamps_s: Array, model: Model) -> Array:
    """Return the true times (n,) of readings that the drifting vehicle clock stamped ``stamps_s``."""
    return stamps_s / (1 + model.value("clock_drift", "ppm") * 1e-6)


def with_terms(
    stream: str, reading: Array, state: State, model: Model, height_m: Array, progress: Array
) -> Array:
    """Return readings (n, k) of a stream with the terms of the model that change them.

    ``height_m`` (n,) is the height above what lies below, and ``progress`` (n,) the elapsed share of the
    flight.
    """
    out = reading.T.copy()
    state_at, rate = state.vectors
    state_at[Z] = height_m
    for term in CATALOGUE.values():
        if term.stream == stream and term.read is not None and model.holds(term.name):
            term.read(out, state_at, rate, progress, model.vector(term.name), 0)
    return out.T


def inertial(state: State, model: Model, progress: Array) -> tuple[Array, Array]:
    """Return body rates (n, 3) and specific force (n, 3) without noise, in the axes of the IMU."""
    reading = np.column_stack([state.b_rate_rad_s, state.b_specific_force_m_s2])
    read = with_terms("imu", reading, state, model, state.w_p_m[:, 2], progress)
    return read[:, :3], read[:, 3:]


def flow_speed(state: State, model: Model, world: World, progress: Array) -> Array:
    """Return the velocity (n, 2) of the on-board optical flow in the heading frame, without noise."""
    below = np.tile([0.0, 0.0, -1.0], (len(state.w_p_m), 1))
    height_m = first_echo(world, state.w_p_m, below)
    return with_terms("velocity", state.h_v_m_s, state, model, height_m, progress)


def slant_range(state: State, model: Model, world: World, progress: Array) -> Array:
    """Return the sonar range (n,) of the first surface in the beam, before noise, quantisation and limits.

    ``state`` is that at emission, ``sonar_lag`` before the reading. ``progress`` (n,) is the elapsed share
    of the flight.
    """
    w_T_b = state.w_T_b
    axis = Rotation.from_rotvec([*model.vector("sonar_tilt"), 0.0]).apply([0.0, 0.0, -1.0])
    along, pencil = w_T_b[:, :3, :3] @ axis, model.value("sonar_slant", "c")
    echo = first_echo(world, w_T_b[:, :3, 3], along)
    if pencil != 1.0:
        cone = first_echo(world, w_T_b[:, :3, 3], along, model.sonar.beam_width_rad)
        echo = pencil * echo + (1 - pencil) * cone
    range_m = with_terms("sonar", echo[:, None], state, model, state.w_p_m[:, 2], progress)
    return np.asarray(range_m[:, 0] + model.sonar.datum_m)


def in_limits(range_m: Array, model: Model) -> Array:
    """Apply quantisation, the dead zone and the limits of the sonar to a range; NaN is out of range."""
    sonar, dead = model.sonar, model.value("sonar_dead_zone", "limit")
    if (step := model.value("sonar_quantisation", "step")) > 0:
        range_m = step * np.round(range_m / step)
    out = (range_m < sonar.min_range_m) | (range_m > sonar.max_range_m)
    # A sensor with a dead zone reports its limit there, not a missing value.
    return np.where(range_m < dead, dead, np.where(out, np.nan, range_m))


def read_imu(motion: Trajectory, model: Model, seed: int) -> Imu:
    """Return gyro and accelerometer readings with noise and random-walk biases."""
    imu, rng = model.imu, generator(seed, "imu")
    times = stamps(imu.rate_hz, motion.duration_s, rng)
    gyro, accel = inertial(motion.at(times), model, times / motion.duration_s)
    per_sample = np.sqrt(imu.rate_hz)
    gyro_noise = rng.normal(0.0, imu.gyro_noise_density * per_sample, gyro.shape)
    accel_noise = rng.normal(0.0, imu.accel_noise_density * per_sample, accel.shape)
    gyro = gyro + autoregressive(gyro_noise, imu.gyro_noise_correlation)
    accel = accel + autoregressive(accel_noise, imu.accel_noise_correlation)
    walks = generator(seed, "imu bias").standard_normal((2, *gyro.shape)).cumsum(axis=1) / per_sample
    return Imu(
        stamps_s=clock_stamps(times, model, generator(seed, "imu clock")),
        gyro_rad_s=gyro + imu.gyro_random_walk * walks[0],
        accel_m_s2=accel + imu.accel_random_walk * walks[1],
        gyro_noise_density=imu.gyro_noise_density,
        accel_noise_density=imu.accel_noise_density,
        gyro_random_walk=imu.gyro_random_walk,
        accel_random_walk=imu.accel_random_walk,
    )


def read_attitude(motion: Trajectory, model: Model, seed: int) -> AttitudeSeries:
    """Return roll, pitch and yaw with noise."""
    rng = generator(seed, "attitude")
    times = stamps(model.attitude.rate_hz, motion.duration_s, rng)
    std = float(np.radians(model.attitude.noise_std_deg))
    angles = motion.at(times).roll_pitch_yaw_rad
    stamps_s = clock_stamps(times, model, generator(seed, "attitude clock"))
    noise = autoregressive(rng.normal(0.0, std, angles.shape), model.attitude.noise_correlation)
    return AttitudeSeries(stamps_s, angles + noise, (std, std, std))


def read_velocity(motion: Trajectory, model: Model, world: World, seed: int) -> Velocity:
    """Return the velocity of the on-board optical flow with noise."""
    rng, std = generator(seed, "velocity"), model.velocity.noise_std_m_s
    times = stamps(model.velocity.rate_hz, motion.duration_s, rng)
    speed = flow_speed(motion.at(times), model, world, times / motion.duration_s)
    stamps_s = clock_stamps(times, model, generator(seed, "velocity clock"))
    noise = autoregressive(rng.normal(0.0, std, speed.shape), model.velocity.noise_correlation)
    # The scale is exact.
    return Velocity(stamps_s, speed + noise, (std, std), scale_std=0.0)


def read_sonar(motion: Trajectory, model: Model, world: World, seed: int) -> Sonar:
    """Return the noisy range to the first surface in the beam; NaN where it is out of range."""
    sonar, rng = model.sonar, generator(seed, "sonar")
    times = stamps(sonar.rate_hz, motion.duration_s, rng)
    emitted = motion.at(times - model.value("sonar_lag", "T"))
    range_m = slant_range(emitted, model, world, times / motion.duration_s)
    noise = rng.normal(0.0, sonar.noise_std_m, range_m.shape)
    range_m = range_m + autoregressive(noise, sonar.noise_correlation)
    spikes = generator(seed, "sonar spikes")
    twice = spikes.uniform(size=len(times)) < model.value("sonar_spikes", "share")
    range_m = np.where(twice, range_m * (2 + SECOND_ECHO_STD * spikes.standard_normal(len(times))), range_m)
    # The scale is exact, and the flight states so.
    return Sonar(
        stamps_s=clock_stamps(times, model, generator(seed, "sonar clock")),
        range_m=in_limits(range_m, model),
        noise_std_m=sonar.noise_std_m,
        min_range_m=sonar.min_range_m,
        max_range_m=sonar.max_range_m,
        beam_width_rad=sonar.beam_width_rad,
        scale_std=0.0,
        datum_std_m=sonar.datum_std_m,
    )


def log_command(stick: Stick, model: Model) -> Command:
    """Return the log of the stick on the recorder's clock: a row at each change, and at least at its rate."""
    changed = np.concatenate([[True], np.any(np.diff(stick.values, axis=0) != 0, axis=1)])
    inside = (stick.stamps_s > 0) & (stick.stamps_s < stick.duration_s)
    begin = np.concatenate([[0.0], stick.stamps_s[changed & inside]])
    end = np.concatenate([begin[1:], [stick.duration_s]])
    rows = [np.arange(a, b - 1e-6, 1 / model.command.rate_hz) for a, b in zip(begin, end, strict=True)]
    times = np.round(np.concatenate(rows), 9)
    return Command(times, stick.at(times + 1e-9)[:, :4], model.vehicle.max_tilt_rad)
