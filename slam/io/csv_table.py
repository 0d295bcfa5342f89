"""Rows of one stream, read from a file or a recording, and the limits of their values."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted
from slam.core.errors import InputError
from slam.core.messages import Message, warning
from slam.io.csv_header import CsvColumn
from slam.io.files import refusal

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


@dataclass(frozen=True)
class CsvTable:
    """Rows of one ``data.csv``, in the order of the file."""

    path: Path
    stamps_ns: Stamps
    """(n,) stamps in nanoseconds."""
    values: Array
    """(n, c) one column for each requested ``CsvColumn``; NaN where missing."""
    names: tuple[str, ...]
    """(n,) a column as text, if requested; else empty."""
    lines: NDArray[np.int64]
    """(n,) line numbers in the file."""
    notes: tuple[Message, ...] = ()
    """One line for each loss of data, without the name of the file."""
    truncated: bool = False
    """Whether the file ends as after a power loss of the recorder."""
    row_word: str = "line"
    """Name of a row in messages: a line of a file, or a message of a recording."""

    def refuse(self, row: int, what: str, do: str) -> InputError:
        """Return the error to raise about one row."""
        return refusal(self.path, what, do, int(self.lines[row]), self.row_word)

    def rows(self, keep: NDArray[np.int64], stamps_ns: Stamps) -> CsvTable:
        """Return the rows ``keep`` in that order, with the given stamps."""
        names = tuple(self.names[k] for k in keep) if self.names else ()
        return CsvTable(
            path=self.path,
            stamps_ns=stamps_ns,
            values=self.values[keep],
            names=names,
            lines=self.lines[keep],
            notes=self.notes,
            truncated=self.truncated,
            row_word=self.row_word,
        )


def check_limits(table: CsvTable, columns: tuple[CsvColumn, ...]) -> CsvTable:
    """Set values beyond the limit of a column to missing. Raises ``InputError`` if most are beyond it."""
    notes = list(table.notes)
    for k, column in enumerate(columns):
        too_large = np.abs(table.values[:, k]) > column.limit
        count = int(too_large.sum())
        if not count:
            continue
        first = int(np.argmax(too_large))
        value = table.values[first, k]
        if count > 0.5 * np.isfinite(table.values[:, k]).sum() and count > 1:
            what = f"has {column.name} = {value:g} and most others beyond {column.most}"
            raise table.refuse(first, what, f"give the column in {column.in_unit}")
        table.values[too_large, k] = np.nan
        what = f"{column.name} beyond {column.most}"
        notes.append(
            warning(
                f"{counted(count, 'value')} of {what} treated as missing (first: {table.row_word} "
                f"{table.lines[first]})",
                "check the sensor there",
            )
        )
    return replace(table, notes=tuple(notes))
