"""Tables of readings (CSV): one row for each moment, and columns with their units in the header.

A column is found by its name and converted from its unit, written ``roll [deg]``, ``roll (deg)`` or
``roll_deg``. The names of a flight folder are known, and some that loggers and flight records use.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2
from backend.wording import counted, either
from slam.core.geodesy import position_fault
from slam.core.messages import Note
from slam.core.rotations import roll_pitch_yaw_of
from slam.io.body_axes import angles_from_aviation
from slam.io.files import brief, read_bytes, refusal, refuse_other_content, without_zero_tail
from slam.io.gimbal import GIMBAL_STD_DEG, body_from_gimbal
from slam.io.recordings.logs.field_rules import FieldRule, FieldSeries, field_recording
from slam.io.recordings.logs.field_values import Converted, Fields, columns, single
from slam.io.recordings.recording import Recording
from slam.io.recordings.video.subtitles import changed_rows
from slam.io.text_encoding import decode_text, wide_encoding

Array = NDArray[np.float64]

DESCRIPTION = "a table of readings"
KIND = "table"
_MAX_BYTES = 1 << 28
_FOOT, _KMH, _MPH, _KNOT = 0.3048, 1 / 3.6, 0.44704, 1852 / 3600
_DEG = np.pi / 180
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": _FOOT}
_ANGLE = {"rad": 1.0, "deg": _DEG}
_POSITION = {"deg": 1.0, "": 1.0}
_RATE = {"rad/s": 1.0, "deg/s": _DEG}
_SPEED = {"m/s": 1.0, "km/h": _KMH, "mph": _MPH, "kn": _KNOT}
_FORCE = {"m/s^2": 1.0, "g": GRAVITY_M_S2}
_VOLTAGE = {"V": 1.0, "mV": 1e-3}
_UNIT_SPELLINGS = {
    **dict.fromkeys(("second", "seconds", "sec"), "s"),
    **dict.fromkeys(("millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("microsecond", "microseconds", "µs"), "us"),
    **dict.fromkeys(("nanosecond", "nanoseconds"), "ns"),
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("foot", "feet"), "ft"),
    **dict.fromkeys(("degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("rads", "rad s^-1", "radps"), "rad/s"),
    **dict.fromkeys(("deg s^-1", "dps", "°/s"), "deg/s"),
    **dict.fromkeys(("m s^-1", "mps"), "m/s"),
    **dict.fromkeys(("m s^-2", "m/s2", "m/s²"), "m/s^2"),
    **dict.fromkeys(("volt", "volts", "v"), "V"),
    **dict.fromkeys(("millivolt", "mv"), "mV"),
}


@dataclass(frozen=True)
class _Quantity:
    """A quantity that a column can hold."""

    name: str
    """Name of its field in the series; the first of its spellings."""
    units: Mapping[str, float]
    """Unit -> factor to the unit of the flight format."""
    spellings: tuple[str, ...] = ()


_QUANTITIES = (
    _Quantity("time", _TIME, ("timestamp", "stamp", "t", "#timestamp", "flighttime")),
    _Quantity("latitude", _POSITION, ("lat",)),
    _Quantity("longitude", _POSITION, ("lon", "lng", "longtitude")),
    _Quantity("altitude", _LENGTH, ("alt", "abs_alt", "altitude_above_sealevel")),
    _Quantity("height", _LENGTH, ("rel_alt", "relative_altitude", "height_above_takeoff")),
    _Quantity("range", _LENGTH, ("sonar", "lidar", "height_sonar")),
    _Quantity("roll", _ANGLE),
    _Quantity("pitch", _ANGLE),
    _Quantity("yaw", _ANGLE),
    _Quantity("heading", _ANGLE, ("compass_heading",)),
    _Quantity("gimbal_roll", _ANGLE, ("gb_roll",)),
    _Quantity("gimbal_pitch", _ANGLE, ("gb_pitch",)),
    _Quantity("gimbal_heading", _ANGLE, ("gimbal_yaw", "gb_yaw")),
    *(_Quantity(f"gyro_{axis}", _RATE, (f"w_RS_S_{axis}",)) for axis in "xyz"),
    *(_Quantity(f"accel_{axis}", _FORCE, (f"a_RS_S_{axis}", f"acc_{axis}")) for axis in "xyz"),
    *(_Quantity(f"v_{axis}", _SPEED) for axis in "xy"),
    _Quantity("voltage", _VOLTAGE),
)


def _plain(name: str) -> str:
    return re.sub(r"[\s_#-]", "", name).lower()


_BY_NAME = {_plain(name): each for each in _QUANTITIES for name in (each.name, *each.spellings)}


def _position(fields: Fields) -> Converted:
    names = ("latitude", "longitude")
    altitude = fields["altitude"] if "altitude" in fields else np.full(len(fields["time"]), np.nan)
    values = np.column_stack([columns(fields, *names), altitude])
    for k, (latitude, longitude) in enumerate(values[:, :2]):
        if position_fault(latitude, longitude):
            values[k] = np.nan
    return _unless_held(values)


def _unless_held(values: Array) -> Converted:
    """Return the rows that differ from the row before, and the others as missing."""
    keep = changed_rows(values)
    held = int(np.isfinite(values[:, 0]).sum() - keep.sum())
    repeat = counted(held, "row repeats", "rows repeat")
    notes = (Note(f"{repeat} the value before and {either(held, 'is', 'are')} left out"),)
    return np.where(keep[:, None], values, np.nan), notes * bool(held)


def _height(fields: Fields) -> Converted:
    return _unless_held(columns(fields, "height"))


def _is_of_positions(series: FieldSeries) -> str:
    return "the altitude belongs to the positions" if "latitude" in series.fields else ""


def _aviation(fields: Fields) -> Converted:
    return angles_from_aviation(columns(fields, "roll", "pitch", "heading")), ()


def _gimbal(fields: Fields) -> Converted:
    degrees = columns(fields, "gimbal_heading", "gimbal_pitch", "gimbal_roll") / _DEG
    known = np.isfinite(degrees).all(axis=1)
    values = np.full(degrees.shape, np.nan)
    if known.any():
        values[known] = roll_pitch_yaw_of(np.array([body_from_gimbal(*row) for row in degrees[known]]))
    return values, ()


def _as_is(stream: str, reading: str, *names: str) -> FieldRule:
    return FieldRule(stream, KIND, names, lambda fields: (columns(fields, *names), ()), reading)


_IMU = tuple(f"{kind}_{axis}" for kind in ("gyro", "accel") for axis in "xyz")
RULES: tuple[FieldRule, ...] = (
    _as_is("imu0", "body axes forward, left, up", *_IMU),
    _as_is("sonar0", "along the line of sight, down", "range"),
    FieldRule(
        "attitude0",
        KIND,
        ("gimbal_heading", "gimbal_pitch", "gimbal_roll"),
        _gimbal,
        "gimbal; heading clockwise from north, pitch -90 degrees straight down",
        lambda fields: {"noise_std": [repr(v * _DEG) for v in GIMBAL_STD_DEG], "assumed": ["noise_std"]},
    ),
    FieldRule(
        "attitude0", KIND, ("roll", "pitch", "heading"), _aviation, "heading clockwise from north, pitch up"
    ),
    _as_is("attitude0", "as in a flight folder: yaw from east to north, pitch down", "roll", "pitch", "yaw"),
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
    notes: tuple[str, ...]


def open_recording(path: Path) -> Recording:
    """Open a table. Raises ``InputError`` where its header has no time or lacks a unit."""
    return recording_of(path, read_table(path))


def recording_of(path: Path, table: Table) -> Recording:
    """Return the recording of a table."""
    return field_recording(path, DESCRIPTION, {path.name: table.series}, RULES, table.notes, {}, table.unread)


def read_table(path: Path) -> Table:
    """Return the readings of a table. Raises ``InputError``."""
    text, notes = _text_of(path)
    lines = text.splitlines()
    first = lines[0] if lines else ""
    delimiter = max(",;\t", key=first.count)
    titles = [title.strip().strip('"') for title in first.split(delimiter)]
    found, unread = _columns(path, titles)
    if "time" not in found:
        raise refusal(path, f"is {DESCRIPTION} without a time", "name a column time [s]", 1)
    rows = list(csv.reader(lines[1:], delimiter=delimiter))
    decimal = "," if delimiter == ";" else "."
    fields = {name: _numbers(rows, k, decimal) * factor for name, (k, factor) in found.items()}
    known = np.isfinite(fields["time"])
    if lost := int((~known).sum()):
        notes.append(
            f"{path.name}: {counted(lost, 'row has', 'rows have')} no time; write times there if they "
            "should count"
        )
    fields = {name: values[known] for name, values in fields.items()}
    stamps_ns = np.round(fields["time"] * 1e9).astype(np.int64)
    left = tuple((title, "column", len(stamps_ns)) for title in unread)
    return Table(FieldSeries(KIND, stamps_ns, fields), left, tuple(notes))


def _text_of(path: Path) -> tuple[str, list[str]]:
    """Return the text of a table, and what was dropped or assumed."""
    data, notes = read_bytes(path, path.parent, _MAX_BYTES), list[str]()
    if not wide_encoding(data):  # half of its last letter is zero
        data, notes = without_zero_tail(data)
    refuse_other_content(path, data)
    text, encoding = decode_text(data)
    if encoding == "Windows-1252":
        notes.append(f"is neither UTF-8 nor UTF-16; {encoding} assumed; save it as UTF-8 if names look wrong")
    return text, [f"{path.name}: {note}" for note in notes]


def _columns(path: Path, titles: list[str]) -> tuple[dict[str, tuple[int, float]], list[str]]:
    """Return quantity -> number and factor of its column, and the titles of the columns of no quantity."""
    found: dict[str, tuple[int, float]] = {}
    unread = []
    for k, title in enumerate(titles):
        name, unit = _split(title)
        quantity = _BY_NAME.get(_plain(name))
        if quantity is None or quantity.name in found:
            unread.append(brief(title, 60))
            continue
        unit = _UNIT_SPELLINGS.get(unit.lower(), unit) if unit not in quantity.units else unit
        if unit not in quantity.units:
            known = " or ".join(f"{name} [{each}]" for each in quantity.units if each)
            what = f"has the unit {brief(unit, 20)!r}" if unit else "has no unit"
            raise refusal(path, f"column {brief(title, 40)!r} {what}", f"write {known}", 1)
        found[quantity.name] = k, quantity.units[unit]
    return found, unread


def _split(title: str) -> tuple[str, str]:
    """Return name and unit of a title; the unit is empty where there is none."""
    bracketed = re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]", title)
    if bracketed:
        return bracketed[1], bracketed[2]
    if _plain(title) in _BY_NAME:
        return title, ""
    name, _, unit = title.rpartition("_")
    if _plain(name) in _BY_NAME and unit.lower() in (*_TIME, *_LENGTH, *_ANGLE, "v", "mv"):
        return name, unit
    return title, ""


def _numbers(rows: list[list[str]], k: int, decimal: str) -> Array:
    """Return column k (n,); NaN where a cell is missing or no number."""
    values = np.full(len(rows), np.nan)
    for row, cells in enumerate(rows):
        try:
            values[row] = float(cells[k].replace(decimal, "."))
        except (IndexError, ValueError):
            continue
    return values
