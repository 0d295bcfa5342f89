"""Subtitles that drones write beside a video (``.SRT``): positions, heights and gimbal angles.

The makers' dialects differ from model to model, and one tolerant reader covers them. Positions change 5 to 10
times a second, but every picture has a subtitle: a value that is only held is no reading. Coordinates in
``GPS(a, b, c)`` or ``RTK(a, b, c)`` are longitude, latitude and the number of satellites. Where the third
value is a height (it has decimals or its unit, as on the Matrice 300), they are latitude, longitude and
altitude. Autel's ``GPS(W: a, N: b, c)`` names the order, and ends with the altitude.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from slam.core.geodesy import position_fault
from slam.core.units import FOOT_M

Array = NDArray[np.float64]

FIELDS = (
    *("latitude", "longitude", "altitude", "height"),
    *("gimbal_yaw", "gimbal_pitch", "gimbal_roll"),
    *("focal_mm", "zoom"),
)
"""Columns of a subtitle: degrees and metres; focal length on 35 mm film."""

_LONGEST_S = 100_000 * 3600.0
"""Largest time of the five digits that subtitles have for hours. A date farther away is damaged."""
_NUMBER = r"[-+]?\d+(?:[.,]\d+)?"
_TIMES = re.compile(r"(?<!\d)(\d{1,5}):(\d\d):(\d\d)[,.](\d{1,3})\s*-->")
_DATE = re.compile(r"(\d{4})[-.](\d{1,2})[-.](\d{1,2})\s+(\d\d):(\d\d):(\d\d)(?:[.,](\d{3}))?")
_KEYED = re.compile(rf"\b([a-z_]+)\s*:\s*({_NUMBER})(?![\d/])(?:\s*(ft|[nsew])\b(?!\s*:))?", re.IGNORECASE)
"""A number with its key, and the letter of a hemisphere or feet behind it."""
_POINT = r"([-+]?\d+(?:\.\d+)?)"
_LETTER = r"(?:([NSEW])\s*:\s*)?"
_GPS = re.compile(
    rf"\b(?:GPS|RTK)\s*\(\s*{_LETTER}{_POINT}\s*,\s*{_LETTER}{_POINT}\s*,\s*{_POINT}\s*(M?)\s*\)",
    re.IGNORECASE,
)
_HEIGHT = re.compile(rf"(?:BAROMETER\s*[:(]|\bHb\s*:|[, ]H\s)\s*({_NUMBER})")
_GIMBAL = re.compile(rf"G\.PRY\s*\(\s*({_NUMBER})\D*?,\s*({_NUMBER})\D*?,\s*({_NUMBER})")
_EIS = re.compile(r"\[eis:\s*(\w+)\]", re.IGNORECASE)
_NOT_STABILISED = ("close", "closed", "off", "none")
_FACTORS = {"s": -1.0, "w": -1.0, "ft": FOOT_M}
"""Factor of a number by the letter beside it: south and west are negative, feet become metres."""
_KEYS = {
    "latitude": "latitude",
    "longitude": "longitude",
    "longtitude": "longitude",
    "abs_alt": "altitude",
    "altitude": "altitude",
    "rel_alt": "height",
    "gb_yaw": "gimbal_yaw",
    "gb_pitch": "gimbal_pitch",
    "gb_roll": "gimbal_roll",
    "focal_len": "focal_mm",
    "dzoom_ratio": "zoom",
}


@dataclass(frozen=True)
class Subtitles:
    """The subtitles of a video in the order of the file."""

    stamps_s: Array
    """(n,) from the start of the video."""
    values: Array
    """(n, c) in the order of ``FIELDS``; NaN where a subtitle does not say it."""
    date: str
    """Date of the first subtitle, empty where unknown."""
    latitude_first: bool
    """Whether coordinates in brackets are latitude, longitude, altitude."""
    position_step_deg: float
    """Resolution of the coordinates; NaN without coordinates."""
    stabilised: bool
    """Whether a subtitle says that the pictures are stabilised electronically."""
    unknown: str = ""
    """First line of the text where no subtitle has a known field; else empty."""

    def column(self, name: str) -> Array:
        """Return (n,) the values of one field."""
        return self.values[:, FIELDS.index(name)]


def parse_subtitles(text: str) -> Subtitles:
    """Return the subtitles of a text; those without a time, or with an absurd one, are left out."""
    stamps, rows, decimals, dates, first_is_latitude = [], [], [], [], False
    begin: datetime | None = None
    for cue in _cues(text):
        when = _DATE.search(cue)
        date = None if when is None else _date(when)
        begin = begin or date
        times = _TIMES.search(cue)
        if times is not None:
            h, m, s, ms = times.groups()
            stamp = int(h) * 3600 + int(m) * 60 + int(s) + int(ms.ljust(3, "0")) * 1e-3
        elif date is not None and begin is not None:
            stamp = (date - begin).total_seconds()
        else:
            continue
        if abs(stamp) > _LONGEST_S:
            continue
        values, digits, latitude_first = _values(cue)
        stamps.append(stamp)
        rows.append([values.get(name, np.nan) for name in FIELDS])
        decimals.append(digits)
        first_is_latitude |= latitude_first
        dates.append(date)
    known = [digits for digits in decimals if digits >= 0]
    table = np.array(rows, dtype=float).reshape(-1, len(FIELDS))
    is_unknown = len(table) > 0 and not np.isfinite(table).any()
    return Subtitles(
        stamps_s=np.array(stamps, dtype=float),
        values=table,
        date=next((date.date().isoformat() for date in dates if date is not None), ""),
        latitude_first=first_is_latitude,
        position_step_deg=10.0 ** -max(known) if known else np.nan,
        stabilised=any(mode.lower() not in _NOT_STABILISED for mode in _EIS.findall(text)),
        unknown=_first_line(text) if is_unknown else "",
    )


def changed_rows(values: Array) -> NDArray[np.bool_]:
    """Return (n,) whether a row (n, c) is complete and differs from the last complete one.

    The last row is among them where it is held for longer than all others: the instrument went on until then.
    """
    keep = np.zeros(len(values), dtype=bool)
    known = np.flatnonzero(np.isfinite(values[:, :2]).all(axis=1))
    if len(known):
        steps = np.nan_to_num(values[known[1:]]) != np.nan_to_num(values[known[:-1]])
        keep[known[0]] = True
        keep[known[1:][steps.any(axis=1)]] = True
        changes = np.flatnonzero(keep[known])
        keep[known[-1]] |= len(known) - 1 - changes[-1] > np.diff(changes).max(initial=0)
    return keep


def _cues(text: str) -> Iterator[str]:
    """Yield the subtitles: blocks that begin with a line that holds only a number."""
    lines: list[str] = []
    for line in text.lstrip("\ufeff").replace("\r", "\n").split("\n"):
        if line.strip().lstrip("\ufeff").isdecimal():
            if lines:
                yield "\n".join(lines)
            lines = []
        elif line.strip():
            lines.append(line)
    if lines:
        yield "\n".join(lines)


def _first_line(text: str) -> str:
    """Return the first line that is neither a number nor a time."""
    lines = (line.strip() for cue in _cues(text) for line in cue.split("\n"))
    return next((line for line in lines if not _TIMES.search(line)), "")


def _date(found: re.Match[str]) -> datetime | None:
    year, month, day, hour, minute, second, ms = found.groups()
    try:
        return datetime(
            int(year), int(month), int(day), int(hour), int(minute), int(second), int(ms or 0) * 1000
        )
    except ValueError:
        return None


def _values(cue: str) -> tuple[dict[str, float], int, bool]:
    """Return the values of one subtitle, the decimals of its coordinates (-1 without), and their order."""
    values: dict[str, float] = {}
    digits, latitude_first = -1, False
    if height := _HEIGHT.search(cue):
        values["height"] = _number(height[1])
    if gps := _GPS.search(cue):
        place, latitude_first = _place(gps)
        values |= place
        digits = len(gps[2].partition(".")[2])
    if gimbal := _GIMBAL.search(cue):
        angles = ("gimbal_pitch", "gimbal_roll", "gimbal_yaw")
        values |= dict(zip(angles, map(_number, gimbal.groups()), strict=True))
    for key, number, letter in _KEYED.findall(cue):
        name = _KEYS.get(key.lower())
        if name is not None and (key.lower() != "altitude" or "altitude" not in values):
            values[name] = _number(number) * _FACTORS.get(letter.lower(), 1.0)
            if name == "latitude":
                digits = len(re.split(r"[.,]", number)[-1]) if re.search(r"[.,]", number) else 0
    if "focal_mm" in values and values["focal_mm"] >= 100:
        values["focal_mm"] /= 10  # 240 is 24.0 mm
    if "zoom" in values and values["zoom"] >= 100:
        values["zoom"] /= 10_000  # 10000 is 1.0000
    return _with_position(values), digits, latitude_first


def _place(gps: re.Match[str]) -> tuple[dict[str, float], bool]:
    """Return the values of coordinates in brackets, and whether their order is latitude, longitude, altitude.

    Letters of hemispheres tell the order and the signs; a longitude west or a latitude south is negative.
    """
    letters = [(letter or "").upper() for letter in (gps[1], gps[3])]
    numbers = [
        _number(text) * _FACTORS.get(letter.lower(), 1.0)
        for letter, text in zip(letters, (gps[2], gps[4]), strict=True)
    ]
    has_letters = all(letters)
    has_altitude = has_letters or "." in gps[5] or bool(gps[6])
    latitude_first = letters[0] in "NS" if has_letters else has_altitude
    names = ("latitude", "longitude") if latitude_first else ("longitude", "latitude")
    values = dict(zip(names, numbers, strict=True))
    return values | ({"altitude": _number(gps[5])} if has_altitude else {}), latitude_first


def _with_position(values: dict[str, float]) -> dict[str, float]:
    """Return the values without a position that is none: 0, 0 before a fix, or off the Earth."""
    place = values.get("latitude"), values.get("longitude")
    if place[0] is not None and place[1] is not None and not position_fault(place[0], place[1]):
        return values
    return {key: value for key, value in values.items() if key not in ("latitude", "longitude")}


def _number(text: str) -> float:
    return float(text.replace(",", "."))
