"""Description of a flight: streams with rates and gaps, missing streams, and anomalies."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.core.fix_check import MAX_SPEED_M_S
from slam.core.flight import Flight
from slam.core.imu_at_rest import imu_anomalies
from slam.core.messages import Message, about
from slam.core.missing_streams import missing_streams
from slam.core.names import listed
from slam.core.repeated_readings import repeated_readings
from slam.core.stream_anomalies import (
    camera_anomalies,
    sonar_anomalies,
    velocity_anomalies,
)
from slam.core.stream_source import StreamSource
from slam.core.streams import STREAMS, AttitudeSeries
from slam.core.units import length

Array = NDArray[np.float64]

GAP_FACTOR, GAP_MIN_S = 3.0, 0.1
"""An interval is a gap if it exceeds this many median intervals and this many seconds."""
MOST_LISTED_FIXES = 40
"""Fixes that one line names."""

_MAY_MISS = {
    "sonar": "range_m",
    "attitude": "roll_pitch_yaw_rad",
    "velocity": "v_m_s",
    "command": "stick",
    "battery": "value",
    "gps": "altitude_m",
    "barometer": "value",
    "motor": "drive",
    "truth": "w_v_m_s",
}
"""Field of ``Flight`` -> array that may hold missing values; other streams drop such rows."""


@dataclass(frozen=True, kw_only=True)
class StreamInfo:
    """Figures of one stream."""

    name: str
    """Name of its folder."""
    count: int
    rate_hz: float
    """One over the median interval; NaN with fewer than two stamps."""
    start_s: float
    duration_s: float
    largest_gap_s: float
    """Longest interval between consecutive stamps; 0 with fewer than two stamps."""
    gaps: int
    """Number of intervals that exceed three median intervals and 0.1 s."""
    missing_values: int

    @property
    def end_s(self) -> float:
        """Time of the last stamp."""
        return self.start_s + self.duration_s


@dataclass(frozen=True, kw_only=True)
class FlightInfo:
    """Description of a flight for a reader."""

    name: str
    notes: dict[str, str]
    duration_s: float
    """Time from the first stamp of any stream to the last."""
    streams: tuple[StreamInfo, ...]
    landmarks: int
    missing: tuple[str, ...]
    """Streams that were not recorded, and the consequence for the map; one line each."""
    anomalies: tuple[str, ...]
    """Anomalies of the readings, one line each."""
    warnings: tuple[str, ...]
    """One line for everything that was dropped, repaired or assumed on reading."""
    sources: tuple[StreamSource, ...] = ()
    """Channels of the recording, taken and left; empty for a flight folder."""


def describe(flight: Flight) -> FlightInfo:
    """Describe streams, gaps, missing streams and anomalies. Reads no picture."""
    streams = _streams(flight)
    start = min((s.start_s for s in streams), default=0.0)
    end = max((s.end_s for s in streams), default=0.0)
    return FlightInfo(
        name=flight.name,
        notes=dict(flight.notes),
        duration_s=end - start,
        streams=tuple(streams),
        landmarks=len(flight.landmarks),
        missing=tuple(map(str, missing_streams(flight))),
        anomalies=tuple(map(str, anomalies(flight))),
        warnings=flight.warnings,
        sources=flight.sources,
    )


def _streams(flight: Flight) -> list[StreamInfo]:
    streams = []
    for field, stream in STREAMS.items():
        series = getattr(flight, field)
        if series is not None and len(series.stamps_s):
            values = getattr(series, _MAY_MISS[field]) if field in _MAY_MISS else None
            streams.append(_stream(stream.folder, series.stamps_s, values))
    return streams


def _stream(name: str, stamps_s: Array, values: Array | None) -> StreamInfo:
    steps = np.diff(stamps_s)
    median = float(np.median(steps)) if len(steps) else math.nan
    gaps = int((steps > max(GAP_FACTOR * median, GAP_MIN_S)).sum()) if len(steps) else 0
    return StreamInfo(
        name=name,
        count=len(stamps_s),
        rate_hz=1 / median if median > 0 else math.nan,
        start_s=float(stamps_s[0]),
        duration_s=float(stamps_s[-1] - stamps_s[0]),
        largest_gap_s=float(steps.max()) if len(steps) else 0.0,
        gaps=gaps,
        missing_values=0 if values is None else int((~np.isfinite(values)).sum()),
    )


def anomalies(flight: Flight) -> list[Message]:
    """Return what is odd about the streams of a flight."""
    if flight.parts:
        return [line.after(part.name) for part in flight.parts for line in anomalies(part)]
    streams = _streams(flight)
    lines = [
        about(
            s.name,
            f"{s.gaps} gap{'s' if s.gaps > 1 else ''}, the largest {s.largest_gap_s:.2f} s",
            "it measured nothing then: check the recorder",
        )
        for s in streams
        if s.gaps and not flight.all_keyframes  # photographs hold their readings in their tags
    ]
    lines += _not_overlapping(flight, streams)
    if flight.camera is not None:
        lines += camera_anomalies(flight.camera)
    if flight.sonar is not None:
        lines += sonar_anomalies(flight.sonar)
    if flight.attitude is not None:
        lines += _attitude_anomalies(flight.attitude, flight.all_keyframes)
    if flight.imu is not None:
        lines += imu_anomalies(flight.imu)
    if flight.velocity is not None:
        lines += velocity_anomalies(flight.velocity)
    lines += fix_anomalies(flight)
    lines += repeated_readings(flight)
    lines += [
        about(name, "its noise is given as zero, which no sensor has", "write its own into sensor.yaml")
        for name in _noiseless(flight)
    ]
    return lines


def _not_overlapping(flight: Flight, streams: list[StreamInfo]) -> list[Message]:
    """Return streams that share little or no time with the pictures, or else with the longest stream.

    Photographs of one set may be days apart: a stream of theirs is judged by how many it covers.
    """
    if not streams:
        return []
    reference = next((s for s in streams if s.name == "cam0"), max(streams, key=lambda s: s.duration_s))
    lines = []
    for s in streams:
        if s is reference:
            continue
        shared = min(s.end_s, reference.end_s) - max(s.start_s, reference.start_s)
        if shared < 0:
            lines.append(
                about(
                    s.name,
                    f"does not overlap in time with {reference.name} ({-shared:.1f} s apart), so "
                    f"nothing of it is used",
                    f"write its stamps on the clock of {reference.name}",
                )
            )
            continue
        share = shared / reference.duration_s if reference.duration_s else 1.0
        of = f"time of {reference.name}"
        if flight.all_keyframes and flight.frames is not None:
            stamps_s = flight.frames.stamps_s
            share, of = float(np.mean((stamps_s >= s.start_s) & (stamps_s <= s.end_s))), "photographs"
        if share < 0.5:
            lines.append(
                about(
                    s.name,
                    f"covers only {100 * share:.0f} % of the {of}",
                    "the rest is mapped without it: check whether its recording is complete",
                )
            )
    return lines


def _attitude_anomalies(attitude: AttitudeSeries, of_photographs: bool) -> list[Message]:
    """Return what is odd about angles. Those of photographs are judged at import, by what each shows."""
    lines = []
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        angle = attitude.roll_pitch_yaw_rad[:, axis]
        angle = angle[np.isfinite(angle)]
        if not len(angle):
            lines.append(
                about("attitude0", f"{name} was not recorded and is left open", "record it for a better map")
            )
        elif (far := float(np.abs(angle).max())) > math.pi + 1e-3:
            lines.append(
                about(
                    "attitude0",
                    f"{name} is unwrapped: it goes beyond ±pi, up to {far:.1f} rad",
                    "check that it is in radians",
                )
            )
        elif name != "yaw" and far > 1.0 and not of_photographs:
            lines.append(
                about(
                    "attitude0",
                    f"{name} reaches {math.degrees(far):.0f} deg, where pictures do not show the "
                    "ground below",
                    "check its unit and axes",
                )
            )
    return lines


def fix_anomalies(flight: Flight) -> list[Message]:
    """Return the fixes that contradict the other fixes, by picture or time."""
    check = flight.fix_check()
    if check is None or flight.gps is None:
        return []
    names = flight.picture_names(flight.gps.stamps_s)
    lines = []
    for bad, why in (
        (check.far, f"farther from the others than these are wide ({length(check.width_m)})"),
        (check.fast, f"out of reach of the others at {MAX_SPEED_M_S:g} m/s"),
        (check.jumps_up, f"at an altitude out of reach of the others at {MAX_SPEED_M_S:g} m/s"),
    ):
        if bad.any():
            which = np.flatnonzero(bad)
            verb = "lies" if len(which) == 1 else "lie"
            fixes = listed(
                [
                    f"{names[k]} ({length(float(check.distance_m[k]))})" if check.far[k] else names[k]
                    for k in which
                ],
                MOST_LISTED_FIXES,
            )
            lines.append(
                about("gps0", f"{len(which)} of {len(names)} fixes {verb} {why}: {fixes}", "check them")
            )
    return lines


def _noiseless(flight: Flight) -> list[str]:
    noise_std: dict[str, tuple[float, ...]] = {}
    if flight.imu is not None:
        noise_std["imu0"] = (flight.imu.gyro_noise_density, flight.imu.accel_noise_density)
    if flight.sonar is not None:
        noise_std["sonar0"] = (flight.sonar.noise_std_m,)
    if flight.attitude is not None:
        noise_std["attitude0"] = flight.attitude.noise_std_rad
    if flight.velocity is not None:
        noise_std["velocity0"] = flight.velocity.noise_std_m_s
    if flight.gps is not None:
        height = flight.gps.noise_std_m[2:] if np.isfinite(flight.gps.altitude_m).any() else ()
        noise_std["gps0"] = (*flight.gps.noise_std_m[:2], *height)
    return [name for name, noise in noise_std.items() if min(noise) <= 0]
