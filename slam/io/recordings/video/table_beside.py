"""The table of readings with the name of a video, on the video's clock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.core.errors import InputError
from slam.core.messages import Message, note, parsed, warning
from slam.io.recordings.recording import Recording
from slam.io.recordings.tables.table import Table, read_table, recording_of

Array = NDArray[np.float64]

_SWITCH_S = 1.0
"""Longest time between the switch of a camera and the first or last picture of its video: it opens or closes
the file meanwhile. A record of the flight tells the switch.
"""


def table_beside(path: Path, stamps_s: Array) -> tuple[Recording | None, tuple[Message, ...]]:
    """Return the table with the name of a video, and lines about its times or why it is not used.

    ``stamps_s`` (n,) are those of the pictures. A table that tells when the camera filmed is that of the
    whole flight; any other counts from the start of the video.
    """
    found = [p for p in path.parent.iterdir() if p.stem == path.stem and p.suffix.lower() == ".csv"]
    if not found or not len(stamps_s):
        return None, ()
    name, video_s = found[0].name, float(stamps_s[-1])
    try:
        table = read_table(found[0])
    except InputError as fault:
        return None, (parsed(f"{name} beside the video is not used: {fault}"),)
    remarks: tuple[Message, ...] = ()
    if "is_video" in table.series.fields:
        start_s, why = _start_of_video(table, video_s)
        if start_s is None:
            return None, (warning(f"{name} is not used: {why}", _as_a_source(path, name)),)
        rows = len(table.series.stamps_ns)
        table = _cut(table, start_s, video_s)
        used = f"{len(table.series.stamps_ns)} of {rows} rows"
        remarks = (note(f"{name}: {used}, from {start_s:.1f} s on, belong to the video by {why}"),)
    times_s: Array = np.asarray(table.series.stamps_ns * 1e-9, float)
    slack_s = 2 * _SWITCH_S  # a logger that the camera switches may begin before it and end after it
    if not len(times_s) or times_s.min() < -slack_s or times_s.max() > video_s + slack_s:
        span = f", {times_s.min():.1f} to {times_s.max():.1f} s" if len(times_s) else ""
        why = f"its times are not those of the video{span} and 0 to {video_s:.1f} s"
        return None, (warning(f"{name} is not used: {why}", _as_a_source(path, name)),)
    return recording_of(found[0], table), (*remarks, *coverage(name, times_s, video_s))


def _as_a_source(path: Path, name: str) -> str:
    return (
        f"give it as a source of its own: slam import {path.name} {name} --out FLIGHT, and say where the "
        "video begins by --offset cam0=SECONDS if motion cannot tell it"
    )


def _start_of_video(table: Table, video_s: float) -> tuple[float | None, str]:
    """Return when a video begins in the record of a flight, or None; and by what, or why not.

    It is the only stretch of filming as long as the video.
    """
    times_s, filming = table.series.stamps_ns * 1e-9, table.series.fields["is_video"] == 1
    edges = np.flatnonzero(np.diff(filming.astype(int), prepend=0, append=0)).reshape(-1, 2)
    step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
    lengths_s = np.array([times_s[end - 1] - times_s[start] for start, end in edges])
    fits = edges[np.abs(lengths_s - video_s) <= 2 * (_SWITCH_S + step_s)]
    if len(fits) == 1:
        return float(times_s[fits[0, 0]]), "its column isVideo"
    lengths = ", ".join(f"{length_s:.1f}" for length_s in lengths_s) or "none"
    which = "no" if not len(fits) else "more than one"
    return None, (
        f"its column isVideo tells {which} stretch as long as the video, {video_s:.1f} s (in s: {lengths})"
    )


def _cut(table: Table, start_s: float, video_s: float) -> Table:
    """Return the readings during a video, with times from its start."""
    stamps_ns = table.series.stamps_ns - round(start_s * 1e9)
    during = (stamps_ns >= -_SWITCH_S * 1e9) & (stamps_ns <= (video_s + _SWITCH_S) * 1e9)
    fields = {name: values[during] for name, values in table.series.fields.items()}
    return replace(table, series=replace(table.series, stamps_ns=stamps_ns[during], fields=fields))


def coverage(name: str, stamps_s: Array, video_s: float) -> tuple[Message, ...]:
    """Return a warning where readings (n,) beside a video begin late or end early."""
    # Each reading holds until the next; the last one for as long as the others. A switch starts loggers too.
    stamps_s = np.sort(stamps_s)
    step_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else 0.0
    begin_s, end_s = float(stamps_s[0]), float(stamps_s[-1]) + step_s
    if begin_s <= max(2 * step_s, _SWITCH_S) and end_s >= video_s - max(step_s, _SWITCH_S):
        return ()
    covered = f"{begin_s:.1f} to {end_s:.1f} s of a video of {video_s:.1f} s"
    return (
        warning(f"{name} covers {covered}", "beyond, there is no reading", "copy it again if it is longer"),
    )
