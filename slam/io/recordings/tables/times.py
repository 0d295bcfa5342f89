"""The times of the rows of a table: numbers, dates with a time (ISO 8601), times of day, or weeks of GPS."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted
from slam.core.errors import InputError
from slam.core.messages import Message, note, warning
from slam.io.csv_stream import MAX_STAMP_NS
from slam.io.files import brief, refusal
from slam.io.recordings.tables.cells import cells_of, numbers
from slam.io.recordings.tables.columns import TIME, TIMES, Column, unknown_unit
from slam.io.recordings.tables.layout import Layout

Array = NDArray[np.float64]

_GPS_EPOCH_S = 315_964_800.0
"""Begin of the first week of GPS, 6 January 1980, in seconds since 1970."""
_WEEK_S, _DAY_S = 7 * 86_400.0, 86_400.0
_DATE = re.compile(
    r"(\d{4})[-/](\d\d)[-/](\d\d)[T ]+(\d\d:\d\d:\d\d)(?:[.,](\d+))?\s*(Z|UTC|[-+]\d\d:?\d\d)?"
)
_DAYTIME = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)(?:\s*([AP])M)?", re.IGNORECASE)
_WRITE = "write seconds, dates such as 2024-05-03T10:00:00.25Z, or times of day such as 10:00:00.25"


def row_times(
    path: Path, layout: Layout, columns: Mapping[str, Column], mark: str
) -> tuple[Array, tuple[Message, ...]]:
    """Return the time of each row in seconds (n,), NaN where none can be read, and lines about them.

    ``columns``: quantity -> column; ``mark``: the decimal mark. Raises ``InputError`` where the unit of the
    times is not told, or no time can be read.
    """
    named = [(columns[name], cells_of(layout, columns[name])) for name in TIMES if name in columns]
    column, cells = next((each for each in named if _is_time(*each)), named[0])
    written = _first(cells)
    notes: tuple[Message, ...] = ()
    if _DATE.fullmatch(written):
        times_s = np.array([_date_s(cell) for cell in cells])
    elif _DAYTIME.fullmatch(written):
        times_s = _without_midnights(np.array([_daytime_s(cell) for cell in cells]))
    else:
        times_s, notes = _numbers(path, layout, column, mark)
        if column.quantity == "time_of_week" and "week" in columns:
            week, _ = numbers(layout, columns["week"], mark)
            times_s = _GPS_EPOCH_S + week * _WEEK_S + times_s
            notes += (note("times are of GPS, ahead of UTC by the leap seconds"),)
    if cells and not np.isfinite(times_s).any():
        what = (
            f"column {brief(column.title, 40)!r} has no time that can be read, first {brief(written, 40)!r}"
        )
        raise refusal(path, what, _WRITE, layout.lines[0])
    lost = int((~np.isfinite(times_s)).sum())
    if lost:
        said = f"{counted(lost, 'row has', 'rows have')} no time"
        notes = (*notes, warning(said, "write times there if they should count"))
    return times_s, notes


def _first(cells: Sequence[str]) -> str:
    """Return the first cell that is not empty; empty for none."""
    return next((cell for cell in cells if cell), "")


def _is_time(column: Column, cells: Sequence[str]) -> bool:
    """Return whether the unit of a column or its first cell tells which times they are."""
    written = _first(cells)
    is_clock = _DATE.fullmatch(written) or _DAYTIME.fullmatch(written)
    return is_clock is not None or (bool(written) and not np.isnan(column.factor))


def _numbers(path: Path, layout: Layout, column: Column, mark: str) -> tuple[Array, tuple[Message, ...]]:
    """Return the times of a column of numbers in seconds (n,). Raises ``InputError``."""
    if np.isnan(column.factor):
        raise unknown_unit(path, column, layout.line)
    times_s, notes = numbers(layout, column, mark)
    limit_s = MAX_STAMP_NS * 1e-9
    known_s = np.abs(times_s[np.isfinite(times_s)])
    if len(known_s) and np.median(known_s) > limit_s:
        raise _too_late(path, layout, column, float(np.median(known_s)) / column.factor, limit_s)
    times_s[~(np.abs(times_s) <= limit_s)] = np.nan
    return times_s, notes


def _too_late(path: Path, layout: Layout, column: Column, median: float, limit_s: float) -> InputError:
    """Return the error to raise about times that no stamp can hold, with the unit in which they fit."""
    unit = next((unit for unit, factor in TIME.items() if median * factor <= limit_s), "")
    what = f"column {brief(column.title, 40)!r} has the median {median:g}, after the year 2096 in its unit"
    return refusal(path, what, f"correct the unit ({f'in {unit}?' if unit else 'no time?'})", layout.line)


def _date_s(cell: str) -> float:
    """Return a date with a time as seconds since 1970, of UTC where no zone is written; NaN for none."""
    found = _DATE.fullmatch(cell)
    if found is None:
        return np.nan
    year, month, day, time, part, zone = found.groups()
    zone = "+00:00" if zone in (None, "Z", "UTC") else zone
    try:
        whole = datetime.fromisoformat(f"{year}-{month}-{day}T{time}{zone}").astimezone(UTC).timestamp()
    except (ValueError, OverflowError):
        return np.nan
    return whole + float(f"0.{part or 0}")


def _daytime_s(cell: str) -> float:
    """Return a time of day in seconds; NaN for none."""
    found = _DAYTIME.fullmatch(cell)
    if found is None:
        return np.nan
    hours = int(found[1])
    if found[4]:
        hours = hours % 12 + 12 * (found[4].upper() == "P")
    return hours * 3600 + int(found[2]) * 60 + float(found[3].replace(",", "."))


def _without_midnights(times_s: Array) -> Array:
    """Return times of day (n,) that go on after midnight."""
    known = np.flatnonzero(np.isfinite(times_s))
    days = np.cumsum(np.diff(times_s[known], prepend=times_s[known[:1]]) < -_DAY_S / 2)
    times_s[known] += days * _DAY_S
    return times_s
