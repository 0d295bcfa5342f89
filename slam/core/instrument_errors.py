"""Errors of the instruments as a map determines them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from backend.bundle.accuracy.systematic_errors import SystematicErrors


@dataclass(frozen=True)
class AttitudeErrors:
    """Errors of the attitude stream against the map's attitude; the floor is assumed to be level."""

    offset_rad: tuple[float, float]
    """Mean errors of roll and pitch."""
    offset_std_rad: tuple[float, float]
    spread_rad: float
    """Standard deviation of roll and pitch about the mean errors."""
    largest_rad: float
    """Largest error of roll or pitch at any keyframe."""
    heading_wander_rad: float | None
    """Range of the heading's error, largest minus smallest; None where no heading was measured."""

    @property
    def tilt_rad(self) -> float:
        """Mean tilt of the attitude against the map."""
        return math.hypot(*self.offset_rad)


@dataclass(frozen=True, kw_only=True)
class AccelerometerErrors:
    """Errors of the accelerometer against the map's trajectory (`backend.inertial_scale`).

    Vectors are in body axes (forward, left, up).
    """

    offset_m_s2: tuple[float, float, float]
    offset_std_m_s2: tuple[float, float, float]
    arm_m: tuple[float, float, float]
    """Lever arm from the body's origin to the accelerometer."""
    arm_std_m: tuple[float, float, float]
    scale: float
    """Ratio of the lengths that the accelerometer measures to those of the map without it."""
    scale_std: float
    """Standard deviation of ``scale``; it includes the uncertainty of the accelerometer's own gain."""
    used: bool
    """Whether the map's scale uses the accelerometer."""
    others_std: float | None = None
    """Relative standard deviation of the map's lengths without it; None where nothing else tells them."""
    delay_s: float = 0.0
    """Delay of the pictures' stamps behind those of the IMU for the same moment, before any step of it."""
    delay_std_s: float = float("inf")
    """Standard deviation of the delay; infinite where the flight does not determine it."""
    delay_taken_out_s: float = 0.0
    """Part of the delay that was removed from the pictures' stamps; 0 where none was removed."""
    lag_s: float = 0.0
    """Delay of the accelerometer's readings behind the gyro's of the same moment."""
    lag_std_s: float = float("inf")
    """Standard deviation of the lag; infinite where the flight does not determine it."""
    lag_taken_out: bool = False
    """Whether the lag was removed before lengths were compared."""


@dataclass(frozen=True)
class VelocityErrors:
    """Errors of the velocity that the vehicle reports, forward and left, against the map."""

    gain: tuple[float, float]
    """Reported over true speed."""
    gain_std: tuple[float, float]
    offset_m_s: tuple[float, float]
    offset_std_m_s: tuple[float, float]
    lag_s: float
    """Delay of the velocities behind the pictures of the same moment."""
    lag_std_s: float
    fading_m_s: tuple[float, float]
    """Standard deviation of an error that changes over the flight."""
    fading_time_s: tuple[float, float]
    """Its correlation time."""
    jump_m_s: tuple[float, float]
    """Largest change of it between two pictures that is no chance; 0 without any."""


@dataclass(frozen=True)
class BarometerErrors:
    """Errors of the barometer against the map."""

    gain: float
    """Change of height by the barometer over the true one."""
    gain_std: float
    noise_m: float
    """Standard deviation of a height, as if it were independent of those before."""


@dataclass(frozen=True)
class ClockSpan:
    """A time in which the delay of the pictures' clock is constant."""

    begin_s: float | None
    """Stamp of its first picture; None for the first span."""
    delay_s: float
    """Delay of the pictures' stamps behind those of the gyro for the same moment."""
    delay_std_s: float
    taken_out: bool
    """Whether the delay was removed from the pictures' stamps."""


@dataclass(frozen=True)
class ClockErrors:
    """Delay of the pictures' clock behind the gyro's."""

    spans: tuple[ClockSpan, ...]
    """In order of time; more than one where the clock steps."""


@dataclass(frozen=True)
class MountTilt:
    """Error of the camera's nominal mount on the body."""

    tilt_rad: tuple[float, float]
    """Rotation about the body's x and y that takes the nominal mount to the estimated one."""
    std_rad: float
    """Standard deviation of each component."""
    b_T_c: tuple[tuple[float, ...], ...]
    """Estimated mount, four rows of four: ``T_BS`` of ``cam0/sensor.yaml``."""


@dataclass(frozen=True)
class LensNumber:
    """One number of the lens: a focal length or the principal point in pixels, or a coefficient."""

    value: float
    std: float
    told: float
    """Value that the tags, the maker or ``sensor.yaml`` state."""
    told_std: float
    """Standard deviation of what is told, the prior of ``value``."""
    estimated: bool
    """Whether the flight tells more about it than was told. Otherwise it is fixed near ``told``."""


@dataclass(frozen=True)
class RollingShutter:
    """Time from the exposure of the first row of a picture to that of the last."""

    readout_s: float
    """0 where it is fixed and nobody states it; negative where the last row is exposed first."""
    std_s: float
    """Standard deviation with which the flight tells it, also where it is fixed; 0 where it is fixed as
    stated."""
    told_std_s: float
    """Standard deviation of what was known before the flight, about 0; 0 where it is fixed as stated."""
    estimated: bool
    """Whether the pictures show another time than the stated one, or than 0: it is then a free parameter,
    else fixed."""
    known_velocities: int
    """Number of pictures of which the vehicle, the neighbours or the frames of a video tell the velocity."""
    stated_s: float | None = None
    """Time that ``cam0/sensor.yaml`` states; None where it states none."""


@dataclass(frozen=True)
class AntennaPlace:
    """Place of the GPS antenna on the body, forward, left and up."""

    place_m: tuple[float, float, float]
    std_m: tuple[float, float, float]
    told_m: tuple[float, float, float]
    """Place that ``gps0/sensor.yaml`` states."""
    told_std_m: float


@dataclass(frozen=True)
class InstrumentErrors:
    """Errors of the instruments as the map determines them; None where it does not."""

    attitude: AttitudeErrors | None
    accelerometer: AccelerometerErrors | None
    mount: MountTilt | None = None
    """None where the camera's mount was fixed at its nominal value."""
    systematic: SystematicErrors | None = None
    """Errors that all pictures or all positions share; None without any beyond chance. They are those of a
    declared lens that the pictures refute where the map has an estimated one instead."""
    picture_clock: ClockErrors | None = None
    """None without a gyro that explains how the pictures turn."""
    lens: Mapping[str, LensNumber] | None = None
    """Numbers of the lens by their names; None where all are certain. They are fx, fy, cx, cy, k1, k2, p1, p2
    and k3, or fx, fy, cx, cy, k1, k2, k3 and k4 of an equidistant fisheye."""
    velocity: VelocityErrors | None = None
    """None where the map does not use the velocity."""
    barometer: BarometerErrors | None = None
    """None where the map does not use the barometer."""
    antenna: AntennaPlace | None = None
    """None where the antenna's place was fixed at what is told."""
    rolling_shutter: RollingShutter | None = None
    """None where no velocity is known."""


NOTHING_KNOWN = InstrumentErrors(None, None)
