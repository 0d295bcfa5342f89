"""A vehicle on a path of sines, known exactly, and instruments that err as the filter's model says."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend import se3
from backend.ekf.inputs import FilterModel, InitialState, Readings, Series, VisualStep
from backend.ekf.results import States

Array = NDArray[np.float64]
GRAVITY = np.array([0.0, 0.0, 9.80665])


@dataclass(frozen=True)
class Sines:
    """Sums of sines, one column an axis: values and derivatives at any time."""

    amplitude: Array
    rate: Array
    phase: Array
    offset: Array

    def at(self, t: Array, derivative: int = 0) -> Array:
        angle = t[:, None, None] * self.rate + self.phase + derivative * np.pi / 2
        out = np.sum(self.amplitude * self.rate**derivative * np.sin(angle), axis=1)
        return out + self.offset if derivative == 0 else out

    @staticmethod
    def drawn(rng: np.random.Generator, amplitude: Array, offset: Array) -> Sines:
        rate = rng.uniform(0.2, 2.0, (3, 3))
        return Sines(amplitude / rate / 2, rate, rng.uniform(0, 2 * np.pi, (3, 3)), offset)


@dataclass(frozen=True)
class MadeFlight:
    """Truth and readings of one flight."""

    position: Sines
    angles: Sines

    def w_T_b(self, t: Array) -> Array:
        T = np.tile(np.eye(4), (len(t), 1, 1))
        T[:, :3, 3] = self.position.at(t)
        T[:, :3, :3] = Rotation.from_euler("ZYX", self.angles.at(t)[:, ::-1]).as_matrix()
        return T

    def body_rate(self, t: Array) -> Array:
        (roll, pitch, _), (dr, dp, dy) = self.angles.at(t).T, self.angles.at(t, 1).T
        return np.column_stack(
            [
                dr - np.sin(pitch) * dy,
                np.cos(roll) * dp + np.sin(roll) * np.cos(pitch) * dy,
                -np.sin(roll) * dp + np.cos(roll) * np.cos(pitch) * dy,
            ]
        )

    def force(self, t: Array) -> Array:
        up = self.position.at(t, 2) + GRAVITY
        return np.einsum("nba,nb->na", self.w_T_b(t)[:, :3, :3], up)

    def heading_velocity(self, t: Array) -> Array:
        yaw, v = self.angles.at(t)[:, 2], self.position.at(t, 1)
        c, s = np.cos(yaw), np.sin(yaw)
        return np.column_stack([c * v[:, 0] + s * v[:, 1], -s * v[:, 0] + c * v[:, 1]])

    def slant(self, t: Array) -> Array:
        T = self.w_T_b(t)
        return T[:, 2, 3] / T[:, 2, 2]


def fly(rng: np.random.Generator) -> MadeFlight:
    """A flight about 1 m above the floor, some metres wide."""
    return MadeFlight(
        Sines.drawn(rng, np.array([1.0, 1.0, 0.15]), np.array([0.0, 0.0, 1.2])),
        Sines.drawn(rng, np.array([0.15, 0.15, 0.8]), np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])),
    )


@dataclass(frozen=True)
class Noise:
    """White noise of the instruments."""

    gyro: float = 0.015
    accel: float = 0.5
    angle: float = 0.005
    range_m: float = 0.01
    velocity: float = 0.03
    position: float = 0.5


def read(
    flight: MadeFlight,
    model: FilterModel,
    rng: np.random.Generator,
    seconds: float = 30.0,
    rate_hz: float = 100.0,
    noise: Noise = Noise(),
    yaw_zero_rad: float = 1.0,
) -> Readings:
    """Every instrument, each on stamps of its own, with errors drawn from what the model allows."""

    def stamps(hz: float) -> Array:
        return np.arange(rng.uniform(0, 1 / hz), seconds, 1 / hz)

    def white(std: float, shape: tuple[int, ...]) -> Array:
        return rng.normal(0, std, shape)

    imu, att, son, vel = stamps(rate_hz), stamps(rate_hz / 2), stamps(25), stamps(60)
    gyro = flight.body_rate(imu) + white(model.gyro_offset_rad_s, (1, 3)) + white(noise.gyro, (len(imu), 3))
    accel = flight.force(imu) + white(model.accel_offset_m_s2, (1, 3)) + white(noise.accel, (len(imu), 3))
    angles = (
        flight.angles.at(att) + persistent(rng, model, att, yaw_zero_rad) + white(noise.angle, (len(att), 3))
    )
    slant = (1 + white(model.range_scale, (1,))) * flight.slant(son) + white(model.range_offset_m, (1,))
    speed = flight.heading_velocity(vel) * (1 + white(model.velocity_scale, (1, 2)))
    return Readings(
        Series(imu, gyro, np.full(3, noise.gyro)),
        Series(imu, accel, np.full(3, noise.accel)),
        Series(att, angles, np.full(3, noise.angle)),
        Series(son, (slant + white(noise.range_m, slant.shape))[:, None], np.array([noise.range_m])),
        Series(vel, speed + white(noise.velocity, speed.shape), np.full(2, noise.velocity)),
    )


def persistent(rng: np.random.Generator, model: FilterModel, t: Array, yaw_zero_rad: float) -> Array:
    """Errors of roll and pitch that fade slowly, and a yaw that wanders from an unknown zero."""
    out = np.zeros((len(t), 3))
    dt = np.diff(t, prepend=t[0])
    out[0] = rng.normal(0, [model.tilt_error_rad, model.tilt_error_rad, yaw_zero_rad])
    for k in range(1, len(t)):
        fade = np.exp(-dt[k] / model.tilt_error_time_s)
        drawn = rng.normal(0, 1, 3)
        out[k, :2] = fade * out[k - 1, :2] + model.tilt_error_rad * np.sqrt(1 - fade**2) * drawn[:2]
        out[k, 2] = out[k - 1, 2] + model.yaw_walk_rad * np.sqrt(dt[k]) * drawn[2]
    return out


def start_of(flight: MadeFlight, readings: Readings, rng: np.random.Generator) -> InitialState:
    """What is known at the first reading: the true place and heading, the rest with the error that it is
    given."""
    held = (getattr(readings, f.name) for f in fields(readings) if f.name != "steps")
    at = np.array([min(series.stamps_s[0] for series in held if series is not None)])
    place, angles = flight.position.at(at)[0], flight.angles.at(at)[0]
    height_std, tilt_std, velocity_std = 0.2, 0.05, 0.3
    tipped = Rotation.from_rotvec([*rng.normal(0, tilt_std, 2), 0.0])
    own = readings.roll_pitch_yaw_rad
    return InitialState(
        height_m=float(place[2] + rng.normal(0, height_std)),
        height_std_m=height_std,
        w_R_b=(tipped * Rotation.from_euler("ZYX", angles[::-1])).as_matrix(),
        tilt_std_rad=tilt_std,
        place_m=(float(place[0]), float(place[1])),
        w_v_m_s=flight.position.at(at, 1)[0] + rng.normal(0, velocity_std, 3),
        velocity_std_m_s=velocity_std,
        yaw_zero_rad=0.0 if own is None else float(own.values[0, 2] - angles[2]),
    )


def as_the_flight_moves(flight: MadeFlight, model: FilterModel) -> FilterModel:
    """The model with the power by which this flight's acceleration and body rate wander, and a margin."""
    t = np.arange(0.0, 30.0, 0.01)

    def wander(values: Array) -> float:
        return max(float(np.mean((values[h:] - values[:-h]) ** 2)) / (0.01 * h) for h in (1, 4, 16, 50, 100))

    accel, rate = (np.sqrt(4 * wander(v) / 2) for v in (flight.position.at(t, 2), flight.body_rate(t)))
    return replace(model, accel_m_s2=accel, accel_time_s=1.0, rate_rad_s=rate, rate_time_s=1.0)


def error_of(states: States, flight: MadeFlight, t: Array, k: int) -> float:
    """Squared whitened error of one pose: chi-square with 6 degrees of freedom."""
    xi = se3.log(se3.inverse(states.w_T_b[k : k + 1]) @ flight.w_T_b(t[k : k + 1]))[0]
    return float(xi @ np.linalg.solve(states.covariances[k], xi))


def seen_steps(flight: MadeFlight, t: Array, rng: np.random.Generator) -> tuple[VisualStep, ...]:
    """Steps from each time to the next as pictures tell them, in heights of the first."""
    T = flight.w_T_b(t)
    covariance = np.diag([2e-3, 2e-3, 1e-3, 3e-3, 3e-3, 2e-3]) ** 2
    steps = []
    for i in range(len(t) - 1):
        i_T_j = se3.inverse(T[i : i + 1]) @ T[i + 1 : i + 2]
        i_T_j[:, :3, 3] /= T[i, 2, 3]
        noisy = i_T_j @ se3.exp(rng.multivariate_normal(np.zeros(6), covariance)[None])
        steps.append(VisualStep(i, i + 1, noisy[0], covariance))
    return tuple(steps)


KNOWN = FilterModel(range_scale=0.0, velocity_scale=0.0, tilt_error_rad=0.03, yaw_walk_rad=0.003)
"""Offsets and lasting errors unknown, scales known."""
MODEL = replace(KNOWN, range_scale=0.05, velocity_scale=0.05)
"""Scales unknown as well."""
