"""Parameters of the simulated instruments: rates, noise and limits.

Source of the default figures: the healthy vehicle of the criticism flights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

Rate = Annotated[float, Field(gt=0, le=2000)]
Noise = Annotated[float, Field(ge=0, le=100)]
Correlation = Annotated[float, Field(ge=0, lt=1)]
"""Correlation of the noise of successive samples, a first-order autoregression; 0 is white noise."""


@dataclass(frozen=True)
class ImuModel:
    """Gyro and accelerometer with noise, white by default."""

    rate_hz: Rate = 200.0
    gyro_noise_density: Noise = 1.5e-3
    """Noise density in rad/s/sqrt(Hz)."""
    accel_noise_density: Noise = 5.0e-2
    """Noise density in m/s^2/sqrt(Hz)."""
    gyro_noise_correlation: Correlation = 0.0
    accel_noise_correlation: Correlation = 0.0
    gyro_random_walk: Noise = 0.0
    """Random walk of a bias that starts at 0, in rad/s^2/sqrt(Hz)."""
    accel_random_walk: Noise = 0.0
    """Random walk of a bias that starts at 0, in m/s^3/sqrt(Hz)."""


@dataclass(frozen=True)
class AttitudeModel:
    """The on-board attitude estimate with noise."""

    rate_hz: Rate = 200.0
    noise_std_deg: Noise = 0.3
    noise_correlation: Correlation = 0.0


@dataclass(frozen=True)
class VelocityModel:
    """The ground velocity of the on-board optical flow, in the heading frame, with noise."""

    rate_hz: Rate = 60.0
    noise_std_m_s: Noise = 0.03
    noise_correlation: Correlation = 0.0


@dataclass(frozen=True)
class SonarModel:
    """Slant range to the floor along the body's -z axis."""

    rate_hz: Rate = 25.0
    noise_std_m: Noise = 0.01
    noise_correlation: Correlation = 0.0
    datum_m: Annotated[float, Field(ge=-1, le=1)] = 0.0
    """Error of the zero, added to every range."""
    datum_std_m: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Standard deviation of the zero, reported in its sensor.yaml."""
    min_range_m: Annotated[float, Field(ge=0)] = 0.25
    max_range_m: Annotated[float, Field(gt=0)] = 6.0
    beam_width_rad: Annotated[float, Field(ge=0, le=2)] = 0.7
    """Beam width reported in its sensor.yaml; the term ``sonar_slant`` sets its effect."""


@dataclass(frozen=True)
class BatteryModel:
    """Three lithium cells: the voltage falls with the charge drawn, and dips with the current."""

    rate_hz: Rate = 5.0
    noise_std_v: Noise = 0.02
    capacity_ah: Annotated[float, Field(gt=0, le=100)] = 1.0
    first_charge: Annotated[float, Field(gt=0, le=1)] = 0.95
    """Remaining share of the capacity at the start."""
    resistance_ohm: Annotated[float, Field(ge=0, le=1)] = 0.03
    hover_current_a: Annotated[float, Field(ge=0, le=200)] = 6.0


@dataclass(frozen=True)
class CommandModel:
    """The log of the stick: at least ``rate_hz`` rows a second, and one at each change."""

    rate_hz: Rate = 20.0
