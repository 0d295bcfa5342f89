"""Parameters of the filter: a model's constants, the hold noise and the noise of each channel, as vectors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from slam.core.arrays import Array
from slam.criticism.kalman.readings import CHANNELS, DATUM, INSTRUMENTS, SENSOR
from slam.simulation.dynamics import PARAMETERS
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

CAMERA = (
    "focal_length.eps", "radial_distortion.k1", "camera_tilt.x", "camera_tilt.y",
    "camera_time_offset.offset", "rolling_shutter.readout",
    "vignetting.a", "motion_blur.exposure", "exposure_variation.gain", "exposure_variation.gamma",
)  # fmt: skip
"""Parameters that pictures can show, the camera's vector. Entries of unobservable sign are squares: exposure
time, standard deviations of gain and gamma."""
(FOCAL, RADIAL, TILT_X, TILT_Y, OFFSET, READOUT, VIGNETTING, BLUR, GAIN, GAMMA) = range(len(CAMERA))
POINTS = 6
"""Number of leading entries that move points of the picture."""
_PARAMETERS = [CATALOGUE[term].parameter(name) for term, name in (entry.split(".") for entry in CAMERA)]
SQUARES = tuple(k for k, parameter in enumerate(_PARAMETERS) if parameter.squared)
LATE_SPREAD = 0.06
"""Standard deviation of the latency from command to command, as a share of the latency."""


@dataclass(frozen=True)
class FilterParameters:
    """All parameters of a filter run apart from the flight."""

    dynamics: Array
    """(``dynamics.PARAMETERS``,)."""
    sensor: Array
    """(``readings.SENSOR``,)."""
    hold: Array
    """(``transition.HOLD``,)."""
    noise_factor: Array
    """(channels,) factor on the flight's own noise figures."""
    latency_s: float = 0.0
    drift: float = 0.0
    """Relative rate error of the vehicle's clock against the recorder's."""
    jitter_s: float = 0.0
    """Standard deviation of the stamps."""
    noise_correlation: Array = field(default_factory=lambda: np.zeros(len(INSTRUMENTS)))
    """(``readings.INSTRUMENTS``,) AR(1) coefficient of the noise from sample to sample; 0: white."""
    out_of_model: bool = False
    """The vehicle is of another make: its process noise and instrument noise have no prior."""
    camera: Array = field(default_factory=lambda: np.zeros(len(CAMERA)))
    """(``CAMERA``,)."""


NOISE_FIGURES = (
    "imu.gyro_noise_density", "imu.accel_noise_density", "attitude.noise_std_deg", "velocity.noise_std_m_s",
    "sonar.noise_std_m",
)  # fmt: skip
"""Noise of ``readings.INSTRUMENTS`` in a model: densities of the imu, and standard deviations."""
NOISE_CORRELATIONS = (
    "imu.gyro_noise_correlation", "imu.accel_noise_correlation", "attitude.noise_correlation",
    "velocity.noise_correlation", "sonar.noise_correlation",
)  # fmt: skip
HOLD_NOISES = (
    "hold_noise.tilt_std_deg", "hold_noise.tilt_correlation_s", "hold_noise.yaw_rate_std_deg_s",
    "hold_noise.yaw_rate_correlation_s", "hold_noise.velocity_std_m_s", "hold_noise.velocity_correlation_s",
    "hold_noise.velocity_up_std_m_s", "hold_noise.velocity_pole_s",
)  # fmt: skip
"""The first entries of ``transition.HOLD``; those of gusts are a term's."""


def filter_parameters_of(model: Model) -> FilterParameters:
    """Return the filter parameters of a model, without the terms that act by chance alone."""
    own = (name.split(".") for name in SENSOR)
    sensor = np.array([model.value(*entry) if entry[0] in CATALOGUE else 0.0 for entry in own])
    sensor[DATUM] = model.sonar.datum_m
    camera = np.array([model.value(*name.split(".")) for name in CAMERA])
    camera[list(SQUARES)] **= 2
    return FilterParameters(
        dynamics=model.parameters(),
        sensor=sensor,
        hold=np.concatenate([model.figures(HOLD_NOISES), model.vector("gusts", "sigma", "tau")]),
        noise_factor=np.ones(len(CHANNELS)),
        latency_s=model.value("control_latency", "T"),
        drift=1e-6 * model.value("clock_drift", "ppm"),
        jitter_s=model.value("timestamp_jitter", "sigma"),
        noise_correlation=model.figures(NOISE_CORRELATIONS),
        camera=camera,
    )


def slot(name: str) -> tuple[Literal["dynamics", "camera", "sensor", "latency", "drift"], int]:
    """Return a parameter's vector and its entry there; "latency" or "drift" for the two that are no entry."""
    if name == "control_latency.T":
        return "latency", 0
    if name == "clock_drift.ppm":
        return "drift", 0
    if name in PARAMETERS:
        return "dynamics", PARAMETERS.index(name)
    if name in CAMERA:
        return "camera", CAMERA.index(name)
    return "sensor", SENSOR.index(name)
