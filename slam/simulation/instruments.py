"""What a model says of each instrument: its rate, its noise, its limits.

Source of the default figures: the healthy vehicle of the criticism flights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

Rate = Annotated[float, Field(gt=0, le=2000)]
Noise = Annotated[float, Field(ge=0, le=100)]
Correlation = Annotated[float, Field(ge=0, lt=1)]
"""Of one sample's noise with the next: a first-order autoregression of the same spread; 0 is white noise."""


@dataclass(frozen=True)
class ImuModel:
    """Gyro and accelerometer with noise, white by default."""

    rate_hz: Rate = 200.0
    gyro_noise_density: Noise = 1.5e-3
    """rad/s/sqrt(Hz)."""
    accel_noise_density: Noise = 5.0e-2
    """m/s^2/sqrt(Hz)."""
    gyro_noise_correlation: Correlation = 0.0
    accel_noise_correlation: Correlation = 0.0
    gyro_random_walk: Noise = 0.0
    """rad/s^2/sqrt(Hz): a bias that starts at 0 and walks."""
    accel_random_walk: Noise = 0.0
    """m/s^3/sqrt(Hz)."""


@dataclass(frozen=True)
class AttitudeModel:
    """The vehicle's own attitude with noise."""

    rate_hz: Rate = 200.0
    noise_std_deg: Noise = 0.3
    noise_correlation: Correlation = 0.0


@dataclass(frozen=True)
class VelocityModel:
    """The speed over ground of the on-board optical flow, in the heading frame, with noise."""

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
    """Added to every range: the error of its zero."""
    datum_std_m: Annotated[float, Field(ge=0, le=1)] = 0.0
    """How far off its zero may be, as its sensor.yaml tells it."""
    min_range_m: Annotated[float, Field(ge=0)] = 0.25
    max_range_m: Annotated[float, Field(gt=0)] = 6.0
    beam_width_rad: Annotated[float, Field(ge=0, le=2)] = 0.7
    """What its sensor.yaml names; how the beam's width acts is the term ``sonar_slant``."""


@dataclass(frozen=True)
class BatteryModel:
    """Three lithium cells: the voltage falls with the charge drawn, and dips with the current."""

    rate_hz: Rate = 5.0
    noise_std_v: Noise = 0.02
    capacity_ah: Annotated[float, Field(gt=0, le=100)] = 1.0
    first_charge: Annotated[float, Field(gt=0, le=1)] = 0.95
    """Share of the capacity that is left at the start."""
    resistance_ohm: Annotated[float, Field(ge=0, le=1)] = 0.03
    hover_current_a: Annotated[float, Field(ge=0, le=200)] = 6.0


@dataclass(frozen=True)
class CommandModel:
    """The log of the stick: at least so many rows a second, and one at each change."""

    rate_hz: Rate = 20.0
