"""Reading of one ``data.csv``: a header with names and units of columns, then rows of a stamp and numbers.

Rows are parsed in bulk. If that fails, a line-by-line pass finds the faulty line. Traces of a power loss (a
zeroed tail, a truncated last line, stamps that are not numbers) are dropped, counted and noted. Faults that
change the meaning (units, missing columns, text in a number) raise an error.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.core.messages import Message, warning
from slam.io.csv_header import CsvColumn, column_indices, extra_columns, header_of, parse_header
from slam.io.csv_table import Array, CsvTable, Stamps, check_limits
from slam.io.files import brief, read_bytes, refusal, refuse_other_content, without_zero_tail

MAX_BYTES = 1 << 31
MAX_STAMP_NS = 4 * 10**18
"""Largest stamp, in the year 2096. Differences of larger stamps would overflow."""
BLOCK_ROWS = 5000


_LONGER = "copy the file again if the recording is longer"
_LAST_LINE = "last line, cut short, dropped", _LONGER
_NO_STAMP = "rows without a finite stamp dropped", "check the clock that stamps them"
_INFINITE = "infinite values treated as missing", "check the sensor"


@dataclass(frozen=True)
class _CsvText:
    """Lines of a file after the header, with notes about repairs of its end."""

    path: Path
    header: list[str]
    lines: list[bytes]
    numbers: list[int]
    notes: list[Message]
    unterminated: bool


def read_numbers(path: Path, root: Path, columns: tuple[CsvColumn, ...]) -> CsvTable:
    """Read a csv of numbers. Raises ``InputError``, with file and line, if its meaning is uncertain."""
    text = _read_text(path, root, header_of(columns))
    indices = column_indices(path, text.header, columns)
    width = len(text.header)
    notes, cut = list(text.notes), bool(text.notes)
    if text.lines and text.unterminated and _last_row_is_truncated(text.lines, width):
        text.lines.pop(), text.numbers.pop()
        notes.append(warning("the last line is cut short and was dropped (1 row)", _LONGER))
        cut = True
    if not text.lines:
        empty = np.empty((0, len(columns)))
        return CsvTable(
            path=path,
            stamps_ns=np.empty(0, np.int64),
            values=empty,
            names=(),
            lines=np.empty(0, np.int64),
            notes=tuple(notes),
            truncated=cut,
        )
    try:
        stamps, values = _parse_in_bulk(text.lines, width, indices)
        lines = np.array(text.numbers)
    except (ValueError, OverflowError):
        stamps, values, lines, found = _parse_line_by_line(text, indices, columns)
        notes += _counted(found)
    if extra := extra_columns(text.header, columns):
        ignored = brief(", ".join(extra), 120)
        notes.append(
            warning(
                f"columns not of this stream ignored: {ignored}", "check their names if they should count"
            )
        )
    return check_limits(
        CsvTable(
            path=path,
            stamps_ns=stamps,
            values=values,
            names=(),
            lines=lines,
            notes=tuple(notes),
            truncated=cut,
        ),
        columns,
    )


def read_names(path: Path, root: Path, title: str, numbers: tuple[CsvColumn, ...] = ()) -> CsvTable:
    """Read a csv of stamps with one text each (of the camera), and numbers that may lack. Raises
    ``InputError`` as ``read_numbers`` does.
    """
    text = _read_text(path, root, f"#timestamp [ns],{title}")
    names_at = [c.split("[")[0].strip().lower() for c in text.header]
    if title not in names_at:
        raise refusal(path, f"has no column {title}", f"write the header #timestamp [ns],{title}", 1)
    at, width = names_at.index(title), len(names_at)
    indices = column_indices(path, text.header, numbers)
    stamps, names, lines, values = [], [], [], []
    lost: Counter[tuple[str, str]] = Counter()
    cut = bool(text.notes)
    if text.lines and text.unterminated and _last_name_is_truncated(text.lines):
        text.lines.pop(), text.numbers.pop()
        lost[_LAST_LINE] += 1
        cut = True
    for raw, number in zip(text.lines, text.numbers, strict=True):
        try:
            fields = next(csv.reader([raw.decode("utf-8")]))
        except (UnicodeDecodeError, csv.Error):
            raise refusal(path, "is not UTF-8 text", "repair or remove the line", number) from None
        if len(fields) != width or not fields[at].strip():
            if text.unterminated and number == text.numbers[-1]:
                lost[_LAST_LINE] += 1
                cut = True
                continue
            raise refusal(
                path, f"has {len(fields)} fields instead of {width} or no name", "repair the line", number
            )
        stamp = _stamp(fields[0], path, number)
        if stamp is None:
            lost[_NO_STAMP] += 1
            continue
        stamps.append(stamp)
        names.append(fields[at].strip())
        lines.append(number)
        values.append(
            [
                np.nan if k is None else _number(fields[k].strip(), column, path, number)
                for column, k in zip(numbers, indices, strict=True)
            ]
        )
    notes = (*text.notes, *_counted(lost))
    table = CsvTable(
        path=path,
        stamps_ns=np.array(stamps, np.int64),
        values=np.array(values).reshape(len(stamps), len(numbers)),
        names=tuple(names),
        lines=np.array(lines, np.int64),
        notes=notes,
        truncated=cut,
    )
    return check_limits(table, numbers)


def _read_text(path: Path, root: Path, expected: str) -> _CsvText:
    data = read_bytes(path, root, MAX_BYTES)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise refusal(path, "is UTF-16 text", "save it as UTF-8")
    data = data.removeprefix(b"\xef\xbb\xbf")
    data, notes = without_zero_tail(data)
    if not data.strip():
        raise refusal(path, "is empty", f"write the header {expected}, or remove the folder")
    refuse_other_content(path, data)
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    first, *lines = data.split(b"\n")
    unterminated = bool(lines and lines[-1].strip())
    numbers = list(range(2, len(lines) + 2))
    if not all(lines) or b"#" in data[len(first) :] or any(not x.strip() for x in lines if x[:1].isspace()):
        kept = [(x, n) for x, n in zip(lines, numbers, strict=True) if x.strip() and not x.startswith(b"#")]
        lines, numbers = [x for x, _ in kept], [n for _, n in kept]
    return _CsvText(path, parse_header(path, first, expected), lines, numbers, notes, unterminated)


def _last_row_is_truncated(lines: list[bytes], width: int) -> bool:
    """Return whether a last line without a line end lost fields, or digits of its (shortest) last number."""
    fields = lines[-1].split(b",")
    if len(fields) != width:
        return True
    others = [len(line.rsplit(b",", 1)[-1].strip()) for line in lines[-50:-1]]
    return bool(others) and len(fields[-1].strip()) < min(others)


def _last_name_is_truncated(lines: list[bytes]) -> bool:
    """Return whether a last line without a line end lost the end of its name. The line before has a complete
    one.
    """
    if len(lines) < 2:
        return False
    before, last = (line.strip().rpartition(b".")[2] for line in lines[-2:])
    return len(before) <= 4 and last != before and (len(last) > 4 or before.startswith(last))


def _parse_in_bulk(lines: list[bytes], width: int, indices: list[int | None]) -> tuple[Stamps, Array]:
    """Parse all rows in bulk. Raises ``ValueError`` or ``OverflowError`` if a field has an unusual form."""
    # Blocks limit memory, as a separate field object takes ten times its length.
    blocks = [
        _parse_block(lines[k : k + BLOCK_ROWS], width, indices) for k in range(0, len(lines), BLOCK_ROWS)
    ]
    stamps, values = zip(*blocks, strict=True)
    return np.concatenate(stamps), np.concatenate(values)


def _parse_block(lines: list[bytes], width: int, indices: list[int | None]) -> tuple[Stamps, Array]:
    commas = width - 1
    if any(line.count(b",") != commas for line in lines):
        raise ValueError("uneven rows")
    joined = b",".join(lines)
    if b"_" in joined or b'"' in joined:
        raise ValueError("no number holds this")
    tokens = joined.split(b",")
    stamps = np.array(list(map(int, tokens[::width])), dtype=np.int64)
    if stamps.max() > MAX_STAMP_NS or stamps.min() < -MAX_STAMP_NS:  # abs() of the smallest one overflows
        raise OverflowError("stamp")
    values = np.full((len(lines), len(indices)), np.nan)
    for k, at in enumerate(indices):
        if at is not None:
            values[:, k] = [float(t) if t else np.nan for t in tokens[at::width]]
    if np.isinf(values).any():
        raise ValueError("infinite")
    return stamps, values


def _parse_line_by_line(
    text: _CsvText, indices: list[int | None], columns: tuple[CsvColumn, ...]
) -> tuple[Stamps, Array, NDArray[np.int64], Counter[tuple[str, str]]]:
    """Parse line by line. Raises ``InputError`` for a faulty line; drops and counts rows without a stamp."""
    width = len(text.header)
    stamps, values, lines = [], [], []
    found: Counter[tuple[str, str]] = Counter()
    for raw, number in zip(text.lines, text.numbers, strict=True):
        fields = [f.strip().strip('"') for f in raw.decode("utf-8", "backslashreplace").split(",")]
        if len(fields) != width:
            raise refusal(
                text.path, f"has {len(fields)} fields instead of {width}", "repair or remove the line", number
            )
        stamp = _stamp(fields[0], text.path, number)
        if stamp is None:
            found[_NO_STAMP] += 1
            continue
        row = []
        for column, at in zip(columns, indices, strict=True):
            value = np.nan if at is None else _number(fields[at], column, text.path, number)
            if np.isinf(value):
                found[_INFINITE] += 1
                value = np.nan
            row.append(value)
        stamps.append(stamp)
        values.append(row)
        lines.append(number)
    return (
        np.array(stamps, np.int64),
        np.array(values).reshape(-1, len(columns)),
        np.array(lines, np.int64),
        found,
    )


def _counted(lost: Counter[tuple[str, str]]) -> list[Message]:
    """Return a message for each kind of loss, of which the key holds the clauses."""
    return [warning(f"{count} {what}", do) for (what, do), count in lost.items()]


def _stamp(field: str, path: Path, line: int) -> int | None:
    """Return a stamp, or None if it is empty, NaN or infinite. Raises ``InputError`` for other text."""
    field = field.strip()
    if field.lower().lstrip("+-") in ("", "nan", "inf", "infinity"):
        return None
    if not re.fullmatch(r"[+-]?[0-9]+", field):
        seconds = re.fullmatch(r"[+-]?[0-9]+\.[0-9]*([eE][+-]?[0-9]+)?", field)
        guess = " (seconds?)" if seconds and "e" not in field.lower() else ""
        raise refusal(path, f"has the stamp {field[:40]!r}{guess}", "write integers in nanoseconds", line)
    if len(field) > 20 or abs(int(field)) > MAX_STAMP_NS:
        raise refusal(
            path, f"has the stamp {field[:40]}, beyond the year 2096", "repair or remove the line", line
        )
    return int(field)


def _number(field: str, column: CsvColumn, path: Path, line: int) -> float:
    try:
        if "_" in field:
            raise ValueError
        return float(field) if field else float("nan")
    except ValueError:
        what = f"has {field[:40]!r} where {column.title} belongs"
        raise refusal(path, what, "write a number, or nothing where it is missing", line) from None
