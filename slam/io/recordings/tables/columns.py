"""The quantities that columns of a table can hold: their names, units and spellings."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from backend.measurements import GRAVITY_M_S2
from slam.core.errors import InputError
from slam.core.units import FOOT_M
from slam.io.files import brief, refusal

_KMH, _MPH, _KNOT = 1 / 3.6, 0.44704, 1852 / 3600
DEG = np.pi / 180
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": FOOT_M}
_ANGLE = {"rad": 1.0, "deg": DEG}
_POSITION = {"deg": 1.0, "rad": 1 / DEG, "degE7": 1e-7, "": 1.0}
_RATE = {"rad/s": 1.0, "deg/s": DEG}
_SPEED = {"m/s": 1.0, "km/h": _KMH, "mph": _MPH, "kn": _KNOT}
_FORCE = {"m/s^2": 1.0, "g": GRAVITY_M_S2, "mg": 1e-3 * GRAVITY_M_S2}
_VOLTAGE = {"V": 1.0, "mV": 1e-3}
_NUMBER = {"": 1.0}
_UNIT_SPELLINGS = {
    **dict.fromkeys(("second", "seconds", "sec"), "s"),
    **dict.fromkeys(("millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("microsecond", "microseconds", "µs"), "us"),
    **dict.fromkeys(("nanosecond", "nanoseconds"), "ns"),
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("foot", "feet"), "ft"),
    **dict.fromkeys(("degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("1e-7 deg", "1e7 deg", "dege7", "deg*1e7"), "degE7"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("rads", "rad s^-1", "radps"), "rad/s"),
    **dict.fromkeys(("deg s^-1", "dps", "°/s"), "deg/s"),
    **dict.fromkeys(("m s^-1", "mps"), "m/s"),
    **dict.fromkeys(("m s^-2", "m/s2", "m/s²"), "m/s^2"),
    **dict.fromkeys(("volt", "volts", "v"), "V"),
    **dict.fromkeys(("millivolt", "mv"), "mV"),
}


@dataclass(frozen=True)
class Quantity:
    """A quantity that a column can hold."""

    name: str
    """Name of its field in the series; the first of its spellings."""
    units: Mapping[str, float]
    """Unit -> factor to the unit of the flight format."""
    spellings: tuple[str, ...] = ()


QUANTITIES = (
    Quantity("time", TIME, ("timestamp", "stamp", "t", "#timestamp", "flighttime", "flytime", "osd.flytime")),
    Quantity(
        "clock",
        _NUMBER,
        ("datetime", "date_time", "utc", "utc_time", "timestamp_utc", "custom.updatetime"),
    ),
    Quantity("week", _NUMBER, ("gps_week",)),
    Quantity("time_of_week", TIME, ("tow", "gps_tow", "gps_time_of_week")),
    Quantity("picture", _NUMBER, ("filename", "file", "image", "image_name", "photo", "sourcefile", "label")),
    Quantity("latitude", _POSITION, ("lat", "osd.latitude", "y/latitude")),
    Quantity("longitude", _POSITION, ("lon", "lng", "longtitude", "osd.longitude", "x/longitude")),
    Quantity(
        "altitude", _LENGTH, ("alt", "abs_alt", "altitude_above_sealevel", "osd.altitude", "z/altitude")
    ),
    Quantity(
        "height", _LENGTH, ("rel_alt", "relative_altitude", "height_above_takeoff", "osd.height", "baroAlt")
    ),
    Quantity("range", _LENGTH, ("sonar", "lidar", "height_sonar", "osd.vpsheight")),
    Quantity("roll", _ANGLE, ("osd.roll",)),
    Quantity("pitch", _ANGLE, ("osd.pitch",)),
    Quantity("yaw", _ANGLE),
    Quantity("yaw_from_east", _ANGLE),
    Quantity("heading", _ANGLE, ("compass_heading", "osd.yaw")),
    Quantity("gimbal_roll", _ANGLE, ("gb_roll", "gimbal.roll")),
    Quantity("gimbal_pitch", _ANGLE, ("gb_pitch", "gimbal.pitch")),
    Quantity("gimbal_heading", _ANGLE, ("gimbal_yaw", "gb_yaw", "gimbal.yaw")),
    *(Quantity(f"gyro_{axis}", _RATE, (f"w_RS_S_{axis}",)) for axis in "xyz"),
    *(Quantity(f"accel_{axis}", _FORCE, (f"a_RS_S_{axis}", f"acc_{axis}")) for axis in "xyz"),
    *(Quantity(f"v_{axis}", _SPEED) for axis in "xy"),
    Quantity("voltage", _VOLTAGE, ("vbatLatest", "battery.voltage")),
    Quantity("is_video", _NUMBER, ("custom.isVideo", "camera.isVideo")),
)
TIMES = ("time", "clock", "time_of_week")
"""Quantities that tell the time of a row, in the order of preference."""


def _plain(name: str) -> str:
    return re.sub(r"[\s_#-]", "", name).lower()


_BY_NAME = {_plain(name): each for each in QUANTITIES for name in (each.name, *each.spellings)}
_DECODED_UNITS: Mapping[str, str] = dict.fromkeys(
    ("osd.roll", "osd.pitch", "osd.yaw", "gimbal.roll", "gimbal.pitch", "gimbal.yaw"), "deg"
)
"""Units that decoders of DJI's flight records leave out of the titles of their columns."""


@dataclass(frozen=True)
class Column:
    """A column of a table that holds a quantity."""

    quantity: str
    title: str
    k: int
    """Its number, from 0."""
    unit: str
    """As written, or in its usual spelling; empty for none."""
    factor: float
    """Factor to the unit of the flight format; NaN for times of an unknown unit, which may be dates."""


def known_names() -> str:
    """Return the names of the columns that are read, for a message."""
    return ", ".join(quantity.name for quantity in QUANTITIES)


def quantities_of(titles: Sequence[str]) -> set[str]:
    """Return the names of the quantities that the titles of a line name."""
    found = (_BY_NAME.get(_plain(_split(title)[0])) for title in titles)
    return {quantity.name for quantity in found if quantity is not None}


def is_unit(text: str) -> bool:
    """Return whether a cell can be a unit below the title of its column; an empty one has none."""
    return not text or any(_unit(text, quantity) in quantity.units for quantity in QUANTITIES)


def columns_of(
    path: Path,
    titles: Sequence[str],
    units: Sequence[str],
    line: int,
    usual: Mapping[str, str] = _DECODED_UNITS,
) -> tuple[dict[str, Column], list[str]]:
    """Return quantity -> its first column of a known unit, else its first, and the titles of all others.

    ``units``: those of a row below the titles; ``usual``: those of names without one. Raises ``InputError``
    for a quantity without a unit, or with an unknown one, except times, which may be dates.
    """
    named: dict[str, list[Column]] = {}
    for k, title in enumerate(titles):
        name, unit = _split(title)
        quantity = _BY_NAME.get(_plain(name))
        if quantity is None:
            continue
        unit = unit or (units[k] if k < len(units) else "") or usual.get(_plain(name), "")
        unit = _unit(unit, quantity)
        if unit and not any(quantity.units) and quantity.name not in TIMES:
            continue  # another quantity of the same name
        column = Column(quantity.name, title, k, unit, quantity.units.get(unit, np.nan))
        named.setdefault(quantity.name, []).append(column)
    found = {name: _preferred(columns) for name, columns in named.items()}
    for column in found.values():
        if np.isnan(column.factor) and column.quantity not in TIMES:
            raise unknown_unit(path, column, line)
    taken = {column.k for column in found.values()}
    unread = [brief(title, 60) for k, title in enumerate(titles) if k not in taken]
    return found, unread


def _preferred(columns: Sequence[Column]) -> Column:
    """Return the first column of a known unit, else the first.

    A time without a unit may be dates: it yields to a column of the same name only.
    """
    names = [_plain(_split(each.title)[0]) for each in columns]
    known = (
        each
        for each, name in zip(columns, names, strict=True)
        if not np.isnan(each.factor) and (each.quantity not in TIMES or name == names[0])
    )
    return next(known, columns[0])


def unknown_unit(path: Path, column: Column, line: int) -> InputError:
    """Return the error to raise about a column without a unit, or with an unknown one."""
    name, units = _split(column.title)[0], _BY_NAME[_plain(column.quantity)].units
    known = " or ".join(f"{name} [{each}]" for each in units if each)
    what = f"has the unit {brief(column.unit, 20)!r}" if column.unit else "has no unit"
    return refusal(path, f"column {brief(column.title, 40)!r} {what}", f"write {known}", line)


def _unit(text: str, quantity: Quantity) -> str:
    return text if text in quantity.units else _UNIT_SPELLINGS.get(text.lower(), text)


def _split(title: str) -> tuple[str, str]:
    """Return name and unit of a title; the unit is empty where there is none."""
    bracketed = re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]", title)
    if bracketed:
        return bracketed[1], bracketed[2]
    if _plain(title) in _BY_NAME:
        return title, ""
    name, _, unit = title.rpartition("_")
    if _plain(name) in _BY_NAME and unit.lower() in (*TIME, *_LENGTH, *_ANGLE, "v", "mv"):
        return name, unit
    return title, ""
