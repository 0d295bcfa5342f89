"""The recorded streams of a flight: pictures, readings of instruments, commands and the reference motion.

Times are seconds (float64) since the flight's ``epoch_ns`` on one clock for all streams. Frames, axes and
signs: world z up with the floor at z = 0, body x forward, y left, z up, camera as in OpenCV. A missing value
is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slam.core.instrument import Instrument

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Frame:
    """One picture of a flight; it is read on request."""

    index: int
    stamp_s: float
    name: str
    read: Callable[[], Image | None]
    """Return the picture as (h, w, 3) BGR or (h, w) grey; None where the file is damaged or missing."""


@dataclass(frozen=True)
class Frames:
    """The pictures of a flight in order of time; none of them is held in memory."""

    stamps_s: Array
    """(n,)."""
    names: tuple[str, ...]
    load: Callable[[int], Image | None]
    """Read picture k; None where it is damaged or missing."""
    failures: Mapping[int, str] = field(default_factory=dict)
    """Reason why picture k could not be read, for pictures that ``load`` has tried."""
    w_v_m_s: Array | None = None
    """(n, 3) velocity of the vehicle at each picture, east, north and up, NaN where it is not known; None
    without any."""

    def __len__(self) -> int:
        return len(self.stamps_s)

    def __getitem__(self, k: int) -> Frame:
        return Frame(k, float(self.stamps_s[k]), self.names[k], lambda: self.load(k))

    def __iter__(self) -> Iterator[Frame]:
        return (self[k] for k in range(len(self)))


@dataclass(frozen=True)
class Imu(Instrument):
    """Inertial measurements in sensor axes (body axes after ``b_T_s``)."""

    stamps_s: Array
    gyro_rad_s: Array
    """(n, 3)."""
    accel_m_s2: Array
    """(n, 3) specific force: (0, 0, +9.80665) at rest and level."""
    gyro_noise_density: float = 1.5e-3
    """rad/s/sqrt(Hz)."""
    accel_noise_density: float = 5.0e-2
    """m/s^2/sqrt(Hz)."""
    gyro_random_walk: float = 0.0
    """rad/s^2/sqrt(Hz)."""
    accel_random_walk: float = 0.0
    """m/s^3/sqrt(Hz)."""
    b_T_s: Array = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True)
class Sonar(Instrument):
    """Slant range along the sensor's axis (-z of the sensor)."""

    stamps_s: Array
    range_m: Array
    """(n,); NaN where out of range."""
    noise_std_m: float = 0.01
    min_range_m: float = 0.25
    max_range_m: float = math.inf
    """Infinite where no limit is stated."""
    beam_width_rad: float = 0.44
    b_T_s: Array = field(default_factory=lambda: np.eye(4))
    scale_std: float = 0.05
    """Relative uncertainty that all readings share; 0 for a sensor without scale error. Cheap sonars read up
    to 5 % short."""
    datum_std_m: float = 0.02
    """Standard deviation of the offset that all readings share; 0 where the offset is known."""


@dataclass(frozen=True)
class AttitudeSeries(Instrument):
    """Attitude as the vehicle estimates it: ``R_wb = Rz(yaw) Ry(pitch) Rx(roll)``."""

    stamps_s: Array
    roll_pitch_yaw_rad: Array
    """(n, 3)."""
    noise_std_rad: tuple[float, float, float] = (0.005, 0.005, 0.005)


@dataclass(frozen=True)
class Velocity(Instrument):
    """On-board optical-flow velocity in the heading frame: level axes, without yaw."""

    stamps_s: Array
    v_m_s: Array
    """(n, 2): forward, left."""
    noise_std_m_s: tuple[float, float] = (0.03, 0.03)
    scale_std: float = 0.1
    """Relative uncertainty that all readings of an axis share; 0 for a sensor without scale error. On-board
    flow sensors read about 0.75 to 1.05 times the true speed."""


@dataclass(frozen=True)
class Command:
    """Stick positions; each value holds from its stamp to the next."""

    stamps_s: Array
    stick: Array
    """(n, 4) in -1..1: forward, left, up, yaw (counter-clockwise from above)."""
    max_tilt_rad: float = 0.5236


@dataclass(frozen=True)
class Scalar(Instrument):
    """A stream with one value per stamp: battery voltage [V] or barometric altitude [m]."""

    stamps_s: Array
    value: Array
    """(n,)."""
    noise_std: float = 0.0


@dataclass(frozen=True)
class Motor:
    """Motor drive, 0..1."""

    stamps_s: Array
    drive: Array
    """(n, 4)."""


@dataclass(frozen=True)
class Gps(Instrument):
    """Geodetic positions, WGS 84."""

    stamps_s: Array
    latitude_deg: Array
    longitude_deg: Array
    altitude_m: Array
    """(n,); NaN where only the horizontal position is known."""
    noise_std_m: tuple[float, float, float] = (5.0, 5.0, 10.0)
    """Nominal standard deviations east, north, up; the back end estimates its own."""
    b_T_s: Array = field(default_factory=lambda: np.eye(4))
    """Its translation is the place of the antenna on the body."""
    antenna_std_m: float = 0.0
    """Standard deviation of that place along each axis; above 0 a map estimates it."""
    stds_m: Array | None = None
    """(n, 3) standard deviations of each fix where they differ much, such as with and without RTK;
    ``noise_std_m`` is their median then. None where that holds for all."""
    height_system: str = ""
    """The level of altitudes, as `slam.core.height_systems` names it; empty if nobody states it."""

    @property
    def each_std_m(self) -> Array:
        """(n, 3) nominal standard deviations of each fix."""
        return np.tile(self.noise_std_m, (len(self.stamps_s), 1)) if self.stds_m is None else self.stds_m

    @property
    def antenna_assumed(self) -> bool:
        """Whether the antenna is at the body's origin because nobody told its place."""
        return "T_BS" in self.assumed


@dataclass(frozen=True)
class Truth:
    """Reference motion, from a simulator or motion capture."""

    stamps_s: Array
    w_T_b: Array
    """(n, 4, 4)."""
    w_v_m_s: Array | None = None
    """(n, 3)."""


@dataclass(frozen=True)
class Stream:
    """Folder of a stream on disk, and the clock of its stamps."""

    folder: str
    clock: Literal["vehicle", "recorder", "reference"]
    """The vehicle's clock; the clock of the recorder of commands and pictures; or that of the truth."""


STREAMS: dict[str, Stream] = {
    "frames": Stream("cam0", "recorder"),
    "imu": Stream("imu0", "vehicle"),
    "sonar": Stream("sonar0", "vehicle"),
    "attitude": Stream("attitude0", "vehicle"),
    "velocity": Stream("velocity0", "vehicle"),
    "command": Stream("command0", "recorder"),
    "battery": Stream("battery0", "vehicle"),
    "gps": Stream("gps0", "vehicle"),
    "barometer": Stream("barometer0", "vehicle"),
    "motor": Stream("motor0", "vehicle"),
    "truth": Stream("state_groundtruth_estimate0", "reference"),
}
"""Field of ``Flight`` -> its stream."""
FIELD_BY_FOLDER = {stream.folder: name for name, stream in STREAMS.items()}
"""Folder -> field of ``Flight``."""
VEHICLE_CLOCK_STREAMS = tuple(name for name, stream in STREAMS.items() if stream.clock == "vehicle")
"""Fields of ``Flight`` whose stamps come from the vehicle's clock."""
