"""A recorded flight: the input of all jobs.

Times are seconds (float64) since ``epoch_ns`` on one clock for all streams; only files hold integer
nanoseconds. Frames, axes and signs: world z up with the floor at z = 0, body x forward, y left, z up, camera
as in OpenCV. A stream that was not recorded is ``None``; a missing value is NaN.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.control_points import SurveyedPoint
from slam.core.fix_check import FixCheck, check_fixes
from slam.core.geodesy import GeoOrigin
from slam.core.messages import Kind, Message
from slam.core.notebook import table_html
from slam.core.stream_source import StreamSource
from slam.core.streams import (
    STREAMS,
    AttitudeSeries,
    Command,
    Frames,
    Gps,
    Imu,
    Motor,
    Scalar,
    Sonar,
    Truth,
    Velocity,
)

Array = NDArray[np.float64]


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
        present = [stream.folder for name, stream in STREAMS.items() if getattr(self, name) is not None]
        frames = 0 if self.frames is None else len(self.frames)
        return f"Flight({self.name!r}, streams=[{', '.join(present)}], frames={frames})"

    def _repr_html_(self) -> str:
        series = {stream.folder: getattr(self, name) for name, stream in STREAMS.items()}
        stamps = {folder: s.stamps_s for folder, s in series.items() if s is not None and len(s.stamps_s)}
        rows = [(folder, f"{len(s)} rows, {s[0]:.1f} to {s[-1]:.1f} s") for folder, s in stamps.items()]
        return table_html(f"Flight {self.name}", [*rows, ("warnings", str(len(self.messages)))])

    @property
    def warnings(self) -> tuple[str, ...]:
        """Texts of all messages."""
        return tuple(map(str, self.messages))

    def with_warning(self, *messages: Message) -> Flight:
        """Return the flight with more messages."""
        return replace(self, messages=(*self.messages, *messages))

    def restamped(self, fields: Iterable[str], stamps: Callable[[Array], Array]) -> Flight:
        """Return the flight with the stamps (n,) of some of its ``STREAMS`` changed by a function."""
        present = {name: getattr(self, name) for name in fields}
        changed: dict[str, Any] = {
            name: replace(series, stamps_s=stamps(series.stamps_s))
            for name, series in present.items()
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
