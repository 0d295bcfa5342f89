"""Several sources of one flight on the command line: which channels come from where, and their clocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slam.core.errors import InputError
from slam.core.messages import warning
from slam.core.streams import FIELD_BY_FOLDER

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.core.progress import Progress
    from slam.io.recordings.choice import Request

_LARGEST_OFFSET_S = 1e9
"""A larger number is a stamp, in seconds since 1970, and no offset."""


def offsets_of(given: Sequence[str] | None) -> dict[str, float]:
    """Return the folder of a stream -> seconds, from ``--offset``. Raises ``InputError``."""
    offsets_s: dict[str, float] = {}
    for text in given or []:
        stream, _, seconds = text.partition("=")
        if stream in offsets_s:
            raise InputError(f"--offset {text}: {stream} is given twice; give one offset of each stream")
        try:
            offset_s = float(seconds)
        except ValueError:
            offset_s = math.nan
        if stream not in FIELD_BY_FOLDER or not abs(offset_s) <= _LARGEST_OFFSET_S:
            raise InputError(
                f"--offset {text}: is not of the form STREAM=SECONDS; write, for example, cam0=7.3"
            )
        offsets_s[stream] = offset_s
    return offsets_s


def open_one_flight(
    paths: Sequence[Path], progress: Progress, request: Request, offsets_s: dict[str, float]
) -> Flight:
    """Read several sources of one flight, and join them on one clock. Raises ``InputError``."""
    from slam.cli.source import kind_of
    from slam.io.recordings.archive import Unpacked, unpacked
    from slam.mapping.recording_clocks.join import join_recordings

    if len({path.resolve() for path in paths}) < len(paths):
        raise InputError(f"{paths[0]}: a source is given twice; give each source of the flight once")
    parts = _parts(paths)
    paths = [path for path in paths if path not in parts[1:]]
    sources = [unpacked(path, progress) if kind_of(path) == "archive" else Unpacked(path) for path in paths]
    for path, source in zip(paths, sources, strict=True):
        kind = kind_of(source.source)
        if kind in ("photos", "graph"):
            what = "photographs" if kind == "photos" else "a pose graph"
            raise InputError(f"{path}: is {what}, without a clock to align; give it alone")
    requests = _requests([each.source for each in sources], parts, request)
    flights = [
        source.warned(_without(_open(source.source, parts, progress, each), request, each))
        for source, each in zip(sources, requests, strict=True)
    ]
    return (
        flights[0] if len(flights) == 1 and not offsets_s else join_recordings(flights, offsets_s, progress)
    )


def _parts(paths: Sequence[Path]) -> tuple[Path, ...]:
    """Return the sources that are one recording in several files; nothing without such.

    These are the parts of a ROS 1 bag in their order, or a video and its subtitles under another name.
    """
    from slam.io.recordings.formats import format_of

    known = {path: format_of(path) for path in paths if path.is_file()}

    def of_kind(description: str) -> list[Path]:
        return [path for path, found in known.items() if getattr(found, "description", "") == description]

    bags, videos, subtitles = map(of_kind, ("a ROS 1 bag", "a video", "a file of subtitles"))
    if len(bags) > 1:
        from slam.io.recordings.ros.parts import parts_in_order

        return parts_in_order(bags)
    if len(videos) == len(subtitles) == 1:
        from slam.io.recordings.video.video import lasts_as_long

        return (*videos, *subtitles) if lasts_as_long(videos[0], subtitles[0]) else ()
    return ()


def _open(path: Path, parts: tuple[Path, ...], progress: Progress, request: Request) -> Flight:
    """Read one source; the first part stands for all of them."""
    from slam.cli.source import open_flight
    from slam.io.recordings.assemble import flight_of
    from slam.io.recordings.formats import open_recording

    if not parts or path != parts[0]:
        return open_flight(path, progress, request)[0]
    line = warning(f"{', '.join(part.name for part in parts)} are read as the parts of one recording")
    return flight_of(open_recording(*parts), request, progress).with_warning(line)


def _requests(paths: Sequence[Path], parts: tuple[Path, ...], request: Request) -> list[Request]:
    """Return what to take from each source. A channel is taken from the first source that has it alone.

    Raises ``InputError`` for a channel that no source has, and for a rate without a recording.
    """
    from slam.cli.source import kind_of
    from slam.io.recordings.choice import Request
    from slam.io.recordings.formats import open_recording

    found: list[Request] = []
    missing = {stream: channel for stream, channel in request.topics.items() if channel}
    for path in paths:
        if kind_of(path) != "recording":
            found.append(Request())
            continue
        files = parts if path in parts else (path,)
        offers = {(o.stream, o.channel) for o in open_recording(*files).offers} if missing else set()
        here = {stream: channel for stream, channel in missing.items() if (stream, channel) in offers}
        missing = {stream: channel for stream, channel in missing.items() if stream not in here}
        topics = {stream: here.get(stream, "") for stream in request.topics}
        found.append(Request(topics, request.picture_rate_hz))
    for stream, channel in missing.items():
        raise InputError(
            f"--topic {stream}={channel}: no source has this channel as {stream}; slam info of each source "
            "lists its channels"
        )
    if request.picture_rate_hz is not None and not any(each.picture_rate_hz for each in found):
        raise InputError("--picture-rate: no source is a recording; leave --picture-rate out")
    return found


def _without(flight: Flight, request: Request, taken: Request) -> Flight:
    """Return a flight without the streams that are taken from another source, or from none."""
    left: dict[str, Any] = {
        FIELD_BY_FOLDER[stream]: None
        for stream in request.topics
        if stream in FIELD_BY_FOLDER and not taken.topics.get(stream)
    }
    if "frames" in left:
        left["camera"] = None
    return replace(flight, **left)
