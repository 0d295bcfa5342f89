"""A recorded flight: the input of all jobs.

Times are seconds (float64) since ``epoch_ns`` on one clock for all streams; only files hold integer
nanoseconds. Frames, axes and signs: world z up with the floor at z = 0, body x forward, y left, z up, camera
as in OpenCV. A stream that was not recorded is ``None``; a missing value is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.control_points import SurveyedPoint
from slam.core.fix_check import FixCheck, check_fixes
from slam.core.geodesy import GeoOrigin
from slam.core.instrument import Instrument
from slam.core.messages import Kind, Line, Message, as_message
from slam.core.notebook import table_html
from slam.core.stream_source import StreamSource

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


@dataclass(frozen=True, repr=False)
class Flight:
    """One flight with its recorded streams."""

    name: str
    _: KW_ONLY
    epoch_ns: int = 0
    """Nanoseconds of second 0 on the recorder's clock."""
    camera: Camera | None = None
    frames: Frames | None = None
    imu: Imu | None = None
    sonar: Sonar | None = None
    attitude: AttitudeSeries | None = None
    velocity: Velocity | None = None
    command: Command | None = None
    battery: Scalar | None = None
    barometer: Scalar | None = None
    motor: Motor | None = None
    gps: Gps | None = None
    truth: Truth | None = None
    landmarks: dict[str, Array] = field(default_factory=dict)
    """Surveyed points of the floor: name -> (3,) metres in the world."""
    landmark_pairs: tuple[tuple[str, str], ...] = ()
    """Pairs of landmarks whose distance the paper's table lists; empty for all pairs of neighbours."""
    surveyed: tuple[SurveyedPoint, ...] = ()
    """Ground control points and check points, with the pictures that show them."""
    gaps: tuple[tuple[str, str], ...] = ()
    """Pairs of landmarks whose short distance a loop must close (in the figure eight: A-E)."""
    notes: dict[str, str] = field(default_factory=dict)
    """Vehicle, place, date, source, licence and notes of flight.yaml."""
    messages: tuple[Message, ...] = ()
    """One line for everything that was dropped, repaired or assumed when the flight was read."""
    all_keyframes: bool = False
    """Whether every picture is a keyframe, as in a set of photographs."""
    sources: tuple[StreamSource, ...] = ()
    """Channels of the recording that the flight was read from, taken and left; empty for a flight folder."""
    parts: tuple[Flight, ...] = ()
    """The flights that were joined into this one (`slam.core.join_flights`); empty for a single flight."""

    def __repr__(self) -> str:
        held = [stream.folder for name, stream in STREAMS.items() if getattr(self, name) is not None]
        frames = 0 if self.frames is None else len(self.frames)
        return f"Flight({self.name!r}, streams=[{', '.join(held)}], frames={frames})"

    def _repr_html_(self) -> str:
        series = {stream.folder: getattr(self, name) for name, stream in STREAMS.items()}
        stamps = {folder: s.stamps_s for folder, s in series.items() if s is not None and len(s.stamps_s)}
        rows = [(folder, f"{len(s)} rows, {s[0]:.1f} to {s[-1]:.1f} s") for folder, s in stamps.items()]
        return table_html(f"Flight {self.name}", [*rows, ("warnings", str(len(self.messages)))])

    @property
    def warnings(self) -> tuple[str, ...]:
        """Texts of all messages."""
        return tuple(map(str, self.messages))

    def with_warning(self, *lines: Line) -> Flight:
        """Return the flight with more messages."""
        return replace(self, messages=(*self.messages, *map(as_message, lines)))

    def restamped(self, fields: Iterable[str], stamps: Callable[[Array], Array]) -> Flight:
        """Return the flight with the stamps (n,) of some of its ``STREAMS`` changed by a function."""
        held = {name: getattr(self, name) for name in fields}
        changed: dict[str, Any] = {
            name: replace(series, stamps_s=stamps(series.stamps_s))
            for name, series in held.items()
            if series is not None
        }
        return replace(self, **changed)

    @property
    def camera_file(self) -> str:
        """Say where the camera's calibration is declared: photographs and recordings have no such file."""
        if self.all_keyframes or self.sources:
            return "cam0/sensor.yaml of the flight folder that `slam import` makes"
        return "cam0/sensor.yaml"

    def reason_not_read(self, folder: str) -> str:
        """Return the finding that says why an existing folder was not read; empty without one."""
        found = (m for m in self.messages if m.kind is Kind.UNREAD and m.about == folder)
        return next((f"{folder}: {message.finding}" for message in found), "")

    def picture_names(self, stamps_s: Array) -> tuple[str, ...]:
        """Return a name for each time (n,): the photograph that was taken then, or else the time."""
        taken = self.frames
        if taken is None or not self.all_keyframes:
            return tuple(f"{t:.2f} s" for t in stamps_s)
        name = dict(zip(np.round(taken.stamps_s, 6).tolist(), taken.names, strict=True))
        return tuple(name.get(round(float(t), 6), f"{t:.2f} s") for t in stamps_s)

    def fix_check(self) -> FixCheck | None:
        """Compare the GPS fixes with each other; None without GPS."""
        gps = self.gps
        if gps is None:
            return None
        # Photographs have times of whole seconds, or, without an epoch, only an order.
        resolution_s = 1.0 if self.all_keyframes else 0.0
        return check_fixes(
            gps.stamps_s,
            gps.latitude_deg,
            gps.longitude_deg,
            gps.altitude_m,
            gps.each_std_m,
            np.inf if self.all_keyframes and not self.epoch_ns else resolution_s,
        )

    def geo_origin(self) -> GeoOrigin | None:
        """Return the origin of the local east-north-up world: the first GPS fix that the others confirm.

        The altitude is the first known one among them; without any it is 0 and marked as unknown. Without a
        fix it is the first surveyed point that can be used, if possible one with an altitude, else None.
        """
        gps, check = self.gps, self.fix_check()
        surveyed = [p for p in self.surveyed if not p.fault]
        at_point = min(surveyed, key=lambda p: np.isnan(p.altitude_m)).origin if surveyed else None
        if gps is None or check is None:
            return at_point
        known = np.isfinite(gps.latitude_deg) & np.isfinite(gps.longitude_deg)
        if not known.any():
            return at_point
        k = int(np.argmax(known & check.consistent if (known & check.consistent).any() else known))
        altitude = gps.altitude_m[known & check.altitude_consistent & np.isfinite(gps.altitude_m)]
        return GeoOrigin(
            float(gps.latitude_deg[k]),
            float(gps.longitude_deg[k]),
            float(altitude[0]) if len(altitude) else 0.0,
            altitude_known=len(altitude) > 0,
            height_system=gps.height_system if len(altitude) else "",
        )


def with_unique_names(flights: Sequence[Flight]) -> tuple[Flight, ...]:
    """Return the flights with numbers appended to names that occur more than once."""
    names = [flight.name for flight in flights]
    return tuple(
        replace(flight, name=f"{flight.name}.{k}") if names.count(flight.name) > 1 else flight
        for k, flight in enumerate(flights, 1)
    )
