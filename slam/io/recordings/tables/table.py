"""Tables of readings (CSV): one row for each moment, and columns with their units in the header.

A column is found by its name and converted from its unit, written ``roll [deg]``, ``roll (deg)`` or
``roll_deg``. The names of a flight folder are known, and some that loggers and flight records use.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted, either
from slam.core.geodesy import position_fault
from slam.core.messages import Message, note, warning
from slam.core.rotations import roll_pitch_yaw_of
from slam.io.body_axes import angles_from_aviation
from slam.io.files import read_bytes, refuse_other_content, without_zero_tail
from slam.io.gimbal import GIMBAL_STD_DEG, body_from_gimbal
from slam.io.recordings.logs.field_rules import FieldRule, FieldSeries, field_recording
from slam.io.recordings.logs.field_values import Converted, Fields, columns, single
from slam.io.recordings.recording import Recording
from slam.io.recordings.tables.cells import decimal_mark, numbers, text_of
from slam.io.recordings.tables.columns import DEG, TIMES, columns_of
from slam.io.recordings.tables.layout import layout_of
from slam.io.recordings.tables.pictures import with_pictures
from slam.io.recordings.tables.times import row_times
from slam.io.recordings.tables.yaw_sense import with_sense
from slam.io.recordings.video.subtitles import changed_rows
from slam.io.text_encoding import decode_text, wide_encoding

Array = NDArray[np.float64]

DESCRIPTION = "a table of readings"
KIND = "table"
_MAX_BYTES = 1 << 28
_TITLE_BYTES = 1 << 16
"""Bytes that hold the titles of a table, and the settings that some loggers write above them."""
_GIMBAL = ("gimbal_heading", "gimbal_pitch", "gimbal_roll")
_LARGEST_DEGREES_MINUTES = 18_060.0
"""Largest number of degrees and minutes that NMEA writes as one: 180 degrees and 60 minutes."""


def _position(fields: Fields) -> Converted:
    names = ("latitude", "longitude")
    altitude = fields["altitude"] if "altitude" in fields else np.full(len(fields["time"]), np.nan)
    values = np.column_stack([columns(fields, *names), altitude])
    known = np.isfinite(values[:, :2]).all(axis=1)
    rows = np.flatnonzero(known).tolist()
    faults = {k: why for k in rows if (why := position_fault(*values[k, :2]))}
    values[list(faults)] = np.nan
    values, notes = _unless_held(values)
    return values, (*_fault_notes(fields, faults, int(known.sum())), *notes)


def _fault_notes(fields: Fields, faults: Mapping[int, str], count: int) -> tuple[Message, ...]:
    """Return a line about positions that are none; row -> why it is none. 0, 0 is no fix, and no fault."""
    place = columns(fields, "latitude", "longitude")
    beyond = [k for k in faults if place[k].any()]
    if not beyond:
        return ()
    if len(beyond) < count / 2:
        do = "check the receiver there"
    elif np.abs(place[beyond[0]]).max() > _LARGEST_DEGREES_MINUTES:
        do = "in 1e-7 degrees? write latitude [degE7], longitude [degE7]"
    else:
        do = "degrees and minutes as in NMEA? convert them to degrees"
    return (warning(f"{len(beyond)} of {count} positions are none and left out: {faults[beyond[0]]}", do),)


def _unless_held(values: Array) -> Converted:
    """Return the rows that differ from the row before, and the others as missing."""
    keep = changed_rows(values)
    repeated = int(np.isfinite(values[:, 0]).sum() - keep.sum())
    kept = np.where(keep[:, None], values, np.nan)
    if repeated == 0:
        return kept, ()
    repeat = counted(repeated, "row repeats", "rows repeat")
    return kept, (note(f"{repeat} the value before and {either(repeated, 'is', 'are')} left out"),)


def _height(fields: Fields) -> Converted:
    return _unless_held(columns(fields, "height"))


def _is_of_positions(series: FieldSeries) -> str:
    return "the altitude belongs to the positions" if "latitude" in series.fields else ""


def _aviation(fields: Fields) -> Converted:
    return angles_from_aviation(columns(fields, "roll", "pitch", "heading")), ()


def _gimbal(fields: Fields) -> Converted:
    degrees = columns(fields, *_GIMBAL) / DEG
    known = np.isfinite(degrees).all(axis=1)
    values = np.full(degrees.shape, np.nan)
    if known.any():
        values[known] = roll_pitch_yaw_of(np.array([body_from_gimbal(*row) for row in degrees[known]]))
    return values, ()


def _as_is(stream: str, reading: str, *names: str) -> FieldRule:
    return FieldRule(stream, KIND, names, lambda fields: (columns(fields, *names), ()), reading)


def _has_gimbal(fields: Fields) -> bool:
    """Return whether any row has the angles of the gimbal, which are preferred."""
    is_there = set(_GIMBAL) <= fields.keys()
    return is_there and bool(np.isfinite(columns(fields, *_GIMBAL)).all(axis=1).any())


_IMU = tuple(f"{kind}_{axis}" for kind in ("gyro", "accel") for axis in "xyz")
_FROM_EAST = _as_is(
    "attitude0", "as in a flight folder: yaw from east to north, pitch down", "roll", "pitch", "yaw"
)
RULES: tuple[FieldRule, ...] = (
    _as_is("imu0", "body axes forward, left, up", *_IMU),
    _as_is("sonar0", "along the line of sight, down", "range"),
    FieldRule(
        "attitude0",
        KIND,
        _GIMBAL,
        _gimbal,
        "gimbal; heading clockwise from north, pitch -90 degrees straight down",
        lambda fields: {"noise_std": [repr(v * DEG) for v in GIMBAL_STD_DEG], "assumed": ["noise_std"]},
    ),
    FieldRule(
        "attitude0", KIND, ("roll", "pitch", "heading"), _aviation, "heading clockwise from north, pitch up"
    ),
    _FROM_EAST,
    _as_is("velocity0", "forward and left, level", "v_x", "v_y"),
    FieldRule("battery0", KIND, ("voltage",), single("voltage"), "V"),
    FieldRule("gps0", KIND, ("latitude", "longitude"), _position, "deg, m"),
    FieldRule("barometer0", KIND, ("height",), _height, "above the take-off"),
    FieldRule("barometer0", KIND, ("altitude",), single("altitude"), "m", doubt=_is_of_positions),
)
"""The quantities of a table and what they become, in the order of preference."""


@dataclass(frozen=True)
class Table:
    """The readings of a table on its own clock."""

    series: FieldSeries
    unread: tuple[tuple[str, str, int], ...]
    """Name, type and number of rows of the columns that are not read."""
    notes: tuple[Message, ...]
    pictures: tuple[str, ...] = ()
    """Name of the picture of each reading, from the folder of the table; empty without a column of them."""
    yaw_doubt: str = ""
    """Why ``roll``, ``pitch`` and ``yaw`` are not read without a request; empty for none."""


def open_recording(path: Path) -> Recording:
    """Open a table. Raises ``InputError`` where its header has no time or lacks a unit."""
    table = read_table(path)
    return with_pictures(recording_of(path, table), table.series.stamps_ns, table.pictures)


def check_titles(path: Path) -> None:
    """Raise ``InputError`` where no line at the beginning of a file names a time."""
    with path.open("rb") as file:
        head = file.read(_TITLE_BYTES)
    layout_of(path, decode_text(head)[0])


def recording_of(path: Path, table: Table) -> Recording:
    """Return the recording of a table."""
    rules = [
        replace(rule, doubt=lambda series: table.yaw_doubt) if rule is _FROM_EAST else rule for rule in RULES
    ]
    return field_recording(path, DESCRIPTION, {path.name: table.series}, rules, table.notes, {}, table.unread)


def read_table(path: Path) -> Table:
    """Return the readings of a table. Raises ``InputError``."""
    text, notes = _text_of(path)
    layout = layout_of(path, text)
    found, unread = columns_of(path, layout.titles, layout.units, layout.line)
    columns = [each for name, each in found.items() if name not in (*TIMES, "week", "picture")]
    mark = decimal_mark(path, layout, found.values())
    times_s, lines = row_times(path, layout, found, mark)
    known = np.isfinite(times_s)
    fields: Fields = {"time": times_s[known]}
    for column in columns:
        values, faults = numbers(layout, column, mark)
        fields = {**fields, column.quantity: values[known]}
        lines += faults
    doubt = ""
    if "yaw_from_east" in fields:
        fields = {**fields, "yaw": fields["yaw_from_east"]}
    elif {"roll", "pitch", "yaw"} <= fields.keys() and "heading" not in fields:
        sense = with_sense(found["yaw"], fields)
        fields, doubt = sense.fields, sense.doubt
        lines += sense.lines * (not _has_gimbal(fields))
    stamps_ns = np.round(times_s[known] * 1e9).astype(np.int64)
    left = tuple((title, "column", len(stamps_ns)) for title in unread)
    pictures = text_of(layout, found["picture"]) if "picture" in found else []
    names = tuple(name for name, has_time in zip(pictures, known, strict=bool(pictures)) if has_time)
    return Table(
        FieldSeries(KIND, stamps_ns, fields),
        left,
        (*notes, *(line.named(path.name) for line in lines)),
        names,
        doubt,
    )


def _text_of(path: Path) -> tuple[str, list[Message]]:
    """Return the text of a table, and what was dropped or assumed."""
    data, notes = read_bytes(path, path.parent, _MAX_BYTES), list[Message]()
    if not wide_encoding(data):  # half of its last letter is zero
        data, notes = without_zero_tail(data)
    refuse_other_content(path, data)
    text, encoding = decode_text(data)
    if encoding == "Windows-1252":
        notes.append(
            warning(
                "is neither UTF-8 nor UTF-16", f"{encoding} assumed", "save it as UTF-8 if names look wrong"
            )
        )
    return text, [note.after(path.name) for note in notes]
