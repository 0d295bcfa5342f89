"""Simulated flights of one healthy vehicle, on which criticism is calibrated.

Each quantity that differs between healthy vehicles is drawn within its range. Instrument noise is Gaussian or
has Student's tails with four degrees of freedom and the same standard deviation. It has the vehicle's own
AR(1) coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.streams import Frames
from slam.simulation import sensors
from slam.simulation.camera.effects import camera_effects
from slam.simulation.camera.film import film_flight
from slam.simulation.camera.optics import CameraModel
from slam.simulation.dynamics import YAW
from slam.simulation.healthy.manoeuvres import MANOEUVRES, stick_for
from slam.simulation.model import Model
from slam.simulation.motion import Motion, Trajectory, at_rest, draw_model_noise, simulate_motion, step_count
from slam.simulation.place.world import World
from slam.simulation.stick import Stick

Array = NDArray[np.float64]

START_M = (1.2, 1.8)
"""Range of initial heights."""
ROOM_M = 60.0
ROUND_M, TEXEL_M = 2.0, 0.004
"""Margin of floor around the filmed path, and its resolution."""
STUDENT_DEGREES = 4


def at_lower_rates(model: Model) -> Model:
    """Return the model with half the reading rate of its fastest instruments, which halves the work."""
    return replace(
        model, imu=replace(model.imu, rate_hz=100.0), attitude=replace(model.attitude, rate_hz=50.0)
    )


def draw_vehicle(model: Model, rng: np.random.Generator) -> Model:
    """Draw a healthy vehicle of a model's kind."""

    def about(x: float, reach: float) -> float:
        return float(x * (1 + rng.uniform(-reach, reach)))

    hold, vehicle = model.hold_noise, model.vehicle
    noise = rng.uniform(0.8, 1.2, 5)
    return replace(
        model,
        vehicle=replace(
            vehicle,
            gain=about(vehicle.gain, 0.05),
            drag_1_s=about(vehicle.drag_1_s, 0.1),
            attitude_time_s=about(vehicle.attitude_time_s, 0.1),
        ),
        hold_noise=replace(
            hold,
            tilt_std_deg=about(hold.tilt_std_deg, 0.2),
            tilt_correlation_s=float(rng.uniform(0.15, 0.4)),
            yaw_rate_std_deg_s=about(hold.yaw_rate_std_deg_s, 0.2),
            yaw_rate_correlation_s=float(rng.uniform(0.2, 0.5)),
            velocity_std_m_s=about(hold.velocity_std_m_s, 0.2),
            velocity_up_std_m_s=about(hold.velocity_up_std_m_s, 0.2),
            velocity_correlation_s=float(np.exp(rng.uniform(np.log(0.05), np.log(0.25)))),
        ),
        imu=replace(
            model.imu,
            gyro_noise_density=model.imu.gyro_noise_density * noise[0],
            accel_noise_density=model.imu.accel_noise_density * noise[1],
        ),
        attitude=replace(model.attitude, noise_std_deg=model.attitude.noise_std_deg * noise[2]),
        velocity=replace(model.velocity, noise_std_m_s=model.velocity.noise_std_m_s * noise[3]),
        sonar=replace(
            model.sonar,
            noise_std_m=model.sonar.noise_std_m * noise[4],
            datum_m=float(rng.uniform(-0.01, 0.01)),
        ),
    )


def draw_plan(duration_s: float, rng: np.random.Generator) -> list[str]:
    """Draw names of manoeuvres that together last about ``duration_s``."""
    names, total = [], 0.0
    every = [n for n, rows in MANOEUVRES.items() if sum(row[0] for row in rows) < duration_s / 2]
    while total < duration_s:
        names.append(every[rng.integers(len(every))])
        total += sum(row[0] for row in MANOEUVRES[names[-1]])
    return names


def simulate_flight(
    model: Model,
    stick: Stick,
    seed: int,
    maker: Model | None = None,
    student: bool = False,
    camera: CameraModel | None = None,
    heading_rad: float | None = None,
) -> Flight:
    """Simulate one flight of a vehicle. Its stated noise figures are those of ``maker``, or its own.

    It starts at ``heading_rad``, by default at a random heading.
    """
    rng = np.random.default_rng((seed, 7))
    start = at_rest(0.0, 0.0, float(rng.uniform(*START_M)), float(rng.uniform(-np.pi, np.pi)))
    if heading_rad is not None:
        start[YAW] = heading_rad
    noise = draw_model_noise(model, step_count(stick.duration_s), (rng, np.random.default_rng((seed, 8))))
    motion = simulate_motion(stick, model, start, noise)
    flight = simulate_readings(model, maker or model, motion, student, seed, rng)
    flight = replace(flight, command=sensors.log_command(stick, model))
    return flight if camera is None else _filmed(flight, motion, camera, seed)


def simulate_readings(
    model: Model, maker: Model, motion: Trajectory, student: bool, seed: int, rng: np.random.Generator
) -> Flight:
    """Simulate the readings of a motion, with the vehicle's noise and the reported noise figures of
    ``maker``."""
    slope = model.vector("floor_slope")
    world = World(extent_m=(-ROOM_M, -ROOM_M, ROOM_M, ROOM_M), slope=(float(slope[0]), float(slope[1])))
    silent = replace(
        model,
        imu=replace(model.imu, gyro_noise_density=0.0, accel_noise_density=0.0),
        attitude=replace(model.attitude, noise_std_deg=0.0),
        velocity=replace(model.velocity, noise_std_m_s=0.0),
        sonar=replace(model.sonar, noise_std_m=0.0),
    )

    def noisy(clean: Array, std: float, correlation: float) -> Array:
        if student:
            drawn = rng.standard_t(STUDENT_DEGREES, clean.shape) / np.sqrt(2.0)
        else:
            drawn = rng.standard_normal(clean.shape)
        return clean + std * sensors.autoregressive(drawn, correlation)

    root = np.sqrt(model.imu.rate_hz)
    gyro_std, accel_std = model.imu.gyro_noise_density * root, model.imu.accel_noise_density * root
    imu = sensors.read_imu(motion, silent, seed)
    imu = replace(
        imu,
        gyro_rad_s=noisy(imu.gyro_rad_s, gyro_std, model.imu.gyro_noise_correlation),
        accel_m_s2=noisy(imu.accel_m_s2, accel_std, model.imu.accel_noise_correlation),
        gyro_noise_density=maker.imu.gyro_noise_density,
        accel_noise_density=maker.imu.accel_noise_density,
    )
    attitude = sensors.read_attitude(motion, silent, seed)
    std_rad, stated_rad = (float(np.radians(m.attitude.noise_std_deg)) for m in (model, maker))
    attitude = replace(
        attitude,
        roll_pitch_yaw_rad=noisy(attitude.roll_pitch_yaw_rad, std_rad, model.attitude.noise_correlation),
        noise_std_rad=(stated_rad, stated_rad, stated_rad),
    )
    velocity = sensors.read_velocity(motion, silent, world, seed)
    velocity = replace(
        velocity,
        v_m_s=noisy(velocity.v_m_s, model.velocity.noise_std_m_s, model.velocity.noise_correlation),
        noise_std_m_s=(maker.velocity.noise_std_m_s,) * 2,
    )
    sonar = sensors.read_sonar(motion, silent, world, seed)
    range_m = noisy(sonar.range_m, model.sonar.noise_std_m, model.sonar.noise_correlation)
    range_m[(range_m < model.sonar.min_range_m) | (range_m > model.sonar.max_range_m)] = np.nan
    sonar = replace(sonar, range_m=range_m, noise_std_m=maker.sonar.noise_std_m)
    return Flight(f"flight_{seed}", imu=imu, attitude=attitude, velocity=velocity, sonar=sonar)


def _filmed(flight: Flight, motion: Motion, camera: CameraModel, seed: int) -> Flight:
    """Return the flight with pictures of a floor as large as the flight."""
    x, y = motion.states[:, :2].T
    extent_m = (x.min() - ROUND_M, y.min() - ROUND_M, x.max() + ROUND_M, y.max() + ROUND_M)
    rng = np.random.default_rng((seed, 9))
    world = World(
        texture=("puzzle", "gym")[seed % 2], extent_m=extent_m, metres_per_px=TEXEL_M,
        seed=int(rng.integers(2**31)),
    )  # fmt: skip
    stamps_s = sensors.stamps(camera.rate_hz, motion.duration_s, rng)
    film = film_flight(
        world, (), camera, camera_effects({}), stamps_s, lambda t: motion.at(t).w_T_b, motion.duration_s, seed
    )
    names = tuple(f"{k}.png" for k in range(len(film.stamps_s)))
    return replace(flight, camera=film.nominal_camera, frames=Frames(film.stamps_s, names, film))


def healthy_case(
    model: Model,
    seed: int,
    flights: int = 3,
    duration_s: float = 30.0,
    student: bool = False,
    camera: CameraModel | None = None,
) -> list[Flight]:
    """Simulate flights of one healthy vehicle with random manoeuvres."""
    rng = np.random.default_rng(seed)
    vehicle = draw_vehicle(model, rng)
    seeds: Sequence[int] = rng.integers(1, 2**31, flights).tolist()
    return [
        simulate_flight(vehicle, stick_for(draw_plan(duration_s, rng)), s, model, student, camera)
        for s in seeds
    ]
