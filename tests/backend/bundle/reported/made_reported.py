"""Motion that a vehicle reports, of a made flight and with known errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from backend.measurements import ReportedMotion, ReportedNoise
from tests.backend.bundle.inertial.made_inertial import NOISE as IMU_NOISE
from tests.backend.bundle.inertial.made_inertial import InertialScene, MadeInertial, make
from tests.backend.made_motion import MadeFlight

RATE_HZ = 50.0
NOISE = ReportedNoise(density=(0.01, 0.01, 0.005), error=(0.05, 0.05, 0.01), time_s=(1.0, 1.0, 2.0))


@dataclass(frozen=True)
class Errors:
    """What is put in."""

    gains: tuple[float, float] = (1.0, 1.0)
    bias_m_s: tuple[float, float] = (0.0, 0.0)
    drift_rad_s: float = 0.0
    lag_s: float = 0.0


def report(
    flight: MadeFlight,
    seconds: float,
    errors: Errors = Errors(),
    rng: np.random.Generator | None = None,
    rate_hz: float = RATE_HZ,
) -> ReportedMotion:
    """Return what the vehicle reports; without ``rng`` there is no noise."""
    t = np.arange(-0.3, seconds + 0.3, 1 / rate_hz)
    velocity = np.array(errors.gains) * flight.heading_velocity(t - errors.lag_s) + errors.bias_m_s
    yaw = np.unwrap(flight.angles.at(t)[:, 2]) + errors.drift_rad_s * t
    if rng is not None:
        rates = wrong_rates(len(t), 1 / rate_hz, rng)
        velocity = velocity + rates[:, :2]
        yaw = yaw + np.cumsum(rates[:, 2]) / rate_hz
    return ReportedMotion(t, velocity, t, yaw, NOISE)


def wrong_rates(count: int, step_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return errors (n, 3) of both velocities and of the yaw rate by the noise."""
    density, error, time_s = (np.array(row) for row in NOISE)
    kept = np.exp(-step_s / time_s)
    fading, out = error * rng.normal(size=3), np.empty((count, 3))
    for row in out:
        row[:] = fading
        fading = kept * fading + np.sqrt(1 - kept**2) * error * rng.normal(size=3)
    return out + density / np.sqrt(step_s) * rng.normal(size=out.shape)


def make_reported(scene: InertialScene, seed: int, errors: Errors = Errors()) -> MadeInertial:
    """Return a flight without an IMU, whose vehicle reports its motion."""
    made = make(replace(scene, noise=replace(IMU_NOISE, delay_s=0.0)), seed)
    motion = report(made.flight, scene.seconds, errors, np.random.default_rng([seed, 1]))
    return replace(made, measurements=replace(made.measurements, inertial=None, reported=motion))
