"""One flight from several recordings of it: streams from each, on the clock of the vehicle's own log."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from backend.clocks.picture_clock import SURE
from backend.wording import counted
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.messages import warning
from slam.core.progress import Progress, silent
from slam.core.stream_source import StreamSource
from slam.core.streams import FIELD_BY_FOLDER, STREAMS
from slam.mapping.recording_clocks.align import KnownClock, align
from slam.mapping.recording_clocks.cameras import chosen_camera
from slam.mapping.recording_clocks.motion import RecordedMotion

_WITH_PICTURES = ("frames", "camera")
_IN_BODY_AXES = ("imu", "sonar", "attitude", "velocity", "command")
"""Streams that are left out where the axes of the body are others; pictures and truth are turned instead."""
_OTHER_AXES = "its body axes are not those of the reference"
_LEAST_TURN_RAD = 0.3
"""A smaller error of the mount is left to the map, which estimates it
(`slam.mapping.calibration.camera_mount`)."""


def join_recordings(
    flights: Sequence[Flight], offsets_s: Mapping[str, float], progress: Progress = silent
) -> Flight:
    """Return one flight with the streams of several recordings of it, in their order on the command line.

    ``offsets_s`` maps the folder of a stream to the seconds by which the recording that it is taken from
    begins after the reference; such a clock is not estimated. Raises ``InputError`` where clocks cannot be
    aligned.
    """
    camera = chosen_camera(flights, progress)
    if camera is not None:
        flights = [camera.alone(k, flight) for k, flight in enumerate(flights)]
    motions = [RecordedMotion(flight, progress) for flight in flights]
    reference = motions[_reference_of(flights)]
    taken = _taken(flights, reference.flight)
    _check_offsets(offsets_s, taken, flights)
    moved: dict[int, Flight] = {}
    for k, motion in enumerate(motions):
        streams = [folder for folder, number in taken.items() if number == k]
        if motion is reference:
            continue
        if not streams:
            moved[k] = motion.flight.with_warning(
                warning(
                    f"nothing of {motion.flight.name} is used, since other sources have its streams",
                    "if it goes on where another one ends, give both to slam optimize, as several flights "
                    "of one camera",
                )
            )
            continue
        given = next((offsets_s[folder] for folder in streams if folder in offsets_s), None)
        clock = (
            align(motion, reference, streams[0]) if given is None else KnownClock(-given, "given by --offset")
        )
        moved[k] = _moved(motion.flight, clock, reference.flight.name)
    joined = _joined([moved.get(k, flight) for k, flight in enumerate(flights)], taken, reference.flight)
    return joined if camera is None else joined.with_warning(camera.remark)


def _reference_of(flights: Sequence[Flight]) -> int:
    """Return the number of the recording whose clock holds: with a gyro, else an attitude, no pictures.

    A recording of which nothing is left has no clock to hold.
    """

    def rank(k: int) -> tuple[bool, ...]:
        flight = flights[k]
        is_empty = all(getattr(flight, name) is None for name in STREAMS)
        return is_empty, flight.imu is None, flight.attitude is None, flight.frames is not None

    return min(range(len(flights)), key=rank)


def _taken(flights: Sequence[Flight], reference: Flight) -> dict[str, int]:
    """Return the folder of each stream -> the number of its recording: the reference, else the first."""
    order = sorted(range(len(flights)), key=lambda k: flights[k] is not reference)
    taken = {}
    for name, stream in STREAMS.items():
        holders = [k for k in order if getattr(flights[k], name) is not None]
        if holders:
            taken[stream.folder] = holders[0]
    return taken


def _check_offsets(
    offsets_s: Mapping[str, float], taken: Mapping[str, int], flights: Sequence[Flight]
) -> None:
    """Raise ``InputError`` for an offset that could not be used: each recording but the reference has one."""
    first: dict[int, str] = {}
    for folder, offset_s in offsets_s.items():
        given = f"--offset {folder}={offset_s:g}"
        if folder not in taken:
            raise InputError(f"{given}: no recording has this stream; there are {', '.join(taken)}")
        k = taken[folder]
        if k == _reference_of(flights):
            raise InputError(
                f"{given}: {folder} is taken from {flights[k].name}, whose clock is the reference; give the "
                "offset of a stream of another source"
            )
        if offsets_s[first.setdefault(k, folder)] != offset_s:
            raise InputError(
                f"{given}: {first[k]}, of the same source {flights[k].name}, has another offset; give one of "
                "the two"
            )


def _moved(flight: Flight, clock: KnownClock, reference: str) -> Flight:
    """Return a recording on the clock of the reference, with what was found in the descriptions of its
    streams."""
    found = f"{flight.name} {clock.begins().replace('after it', f'after {reference}')}"
    sources = [replace(s, reading=f"{s.reading}; {found}") if s.stream else s for s in _sources(flight)]
    moved = replace(flight.restamped(STREAMS, clock.on_reference), sources=tuple(sources))
    if clock.steps:
        moved = moved.with_warning(
            warning(
                f"{flight.name}: its clock steps {counted(clock.steps, 'time')} against that of {reference}",
                "a map looks for steps of cam0, and other streams keep them",
            )
        )
    return _turned(moved, clock, reference)


def _turned(flight: Flight, clock: KnownClock, reference: str) -> Flight:
    """Return a recording in the body axes of the reference, where the two surely differ."""
    if clock.turned is None:
        return flight
    turn = Rotation.from_matrix(clock.turned)
    if turn.magnitude() < max(_LEAST_TURN_RAD, SURE * clock.turned_std_rad):
        return flight
    vector = ", ".join(f"{degrees:.0f}°" for degrees in np.degrees(turn.as_rotvec()))
    changed: dict[str, Any] = {name: None for name in _IN_BODY_AXES}
    if flight.camera is not None:
        b_T_b = np.eye(4)
        b_T_b[:3, :3] = clock.turned
        mount = b_T_b @ flight.camera.b_T_c
        mount[:3, 3] = flight.camera.b_T_c[:3, 3]
        changed["camera"] = replace(flight.camera, b_T_c=mount)
    if flight.truth is not None:
        w_T_b = flight.truth.w_T_b.copy()
        w_T_b[:, :3, :3] = w_T_b[:, :3, :3] @ clock.turned.T
        changed["truth"] = replace(flight.truth, w_T_b=w_T_b)
    lost = [STREAMS[name].folder for name in _IN_BODY_AXES if getattr(flight, name) is not None]
    also = f"{', '.join(lost)} of it, in its own axes, left out" if lost else ""
    return replace(flight, **changed).with_warning(
        warning(
            f"{flight.name}: its body axes are turned by ({vector}) against those of {reference}, as both "
            "show by their turns",
            "its camera and truth follow",
            also,
        )
    )


def _joined(flights: Sequence[Flight], taken: Mapping[str, int], reference: Flight) -> Flight:
    chosen: dict[str, Any] = {}
    sources: list[StreamSource] = []
    for folder, k in taken.items():
        name = FIELD_BY_FOLDER[folder]
        for field in _WITH_PICTURES if name == "frames" else (name,):
            chosen[field] = getattr(flights[k], field)
    for k, flight in enumerate(flights):
        for source in _sources(flight):
            winner = taken.get(source.stream, k)
            named = replace(source, channel=f"{flight.name}: {source.channel}")
            if winner != k:
                reason = f"that of {flights[winner].name} taken as {source.stream}"
                named = replace(named, stream="", rate_hz=math.nan, reading=reason)
            elif source.stream and getattr(flight, FIELD_BY_FOLDER[source.stream]) is None:
                named = replace(named, stream="", rate_hz=math.nan, reading=_OTHER_AXES)
            sources.append(named)
    joined = replace(
        reference,
        name=flights[0].name,
        notes={key: text for flight in reversed(flights) for key, text in flight.notes.items()},
        messages=tuple(message for flight in flights for message in flight.messages),
        sources=tuple(sources),
        **chosen,
    )
    return _from_zero(joined)


def _sources(flight: Flight) -> tuple[StreamSource, ...]:
    """Return the sources of a recording's streams; a flight folder has none: they are named."""
    if flight.sources:
        return flight.sources
    found = []
    for name, stream in STREAMS.items():
        series = getattr(flight, name)
        if series is not None:
            stamps_s = series.stamps_s
            span_s = float(stamps_s[-1] - stamps_s[0]) if len(stamps_s) > 1 else 0.0
            found.append(
                StreamSource(
                    stream=stream.folder,
                    channel=stream.folder,
                    kind="flight folder",
                    rows=len(stamps_s),
                    rate_hz=(len(stamps_s) - 1) / span_s if span_s > 0 else math.nan,
                    reading="as it is",
                )
            )
    return tuple(found)


def _from_zero(flight: Flight) -> Flight:
    """Return the flight with second 0 at its first row; clocks that begin at a start have no time before."""
    series = [getattr(flight, name) for name in STREAMS]
    first_s = min((float(s.stamps_s[0]) for s in series if s is not None and len(s.stamps_s)), default=0.0)
    if first_s == 0.0:
        return flight
    epoch_ns = max(flight.epoch_ns + round(first_s * 1e9), 0)
    return replace(flight.restamped(STREAMS, lambda stamps_s: stamps_s - first_s), epoch_ns=epoch_ns)
