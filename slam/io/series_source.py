"""Inputs of a series: the rows of a table, its ``sensor.yaml`` and the epoch of the flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.core.messages import Message, note, warning
from slam.io.csv_table import CsvTable
from slam.io.sensor_yaml import YamlFile

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Source:
    """Sorted rows of one stream, its nominal values, and the list that collects notes."""

    table: CsvTable
    sensor: YamlFile
    epoch_ns: int
    notes: list[Message]

    @property
    def stamps_s(self) -> Array:
        """(n,) seconds since the flight's epoch."""
        return ((self.table.stamps_ns - self.epoch_ns) * 1e-9).astype(float)

    def keep_rows(self, rows: NDArray[np.bool_] | np.bool_, why: str) -> Source:
        """Return the source with the rows that pass, and note the number of dropped rows and the reason."""
        rows = np.atleast_1d(rows)
        if rows.all():
            return self
        dropped = f"{int((~rows).sum())} of {len(self.table.stamps_ns)} rows dropped: {why}"
        self.notes.append(note(dropped))
        keep = np.flatnonzero(rows)
        return Source(
            self.table.rows(keep, self.table.stamps_ns[keep]), self.sensor, self.epoch_ns, self.notes
        )

    def set_missing(self, bad: NDArray[np.bool_], column: int, why: str) -> None:
        """Set values of one column to missing, and note their number and the reason."""
        if bad.any():
            self.notes.append(note(f"{int(bad.sum())} of {len(bad)} values treated as missing: {why}"))
            self.table.values[bad, column] = np.nan

    def row_error(self, row: int, what: str, do: str) -> Exception:
        """Return the error to raise about one row."""
        return self.table.refuse(row, what, do)

    def noise(self, default: tuple[float, ...], largest: Sequence[float]) -> tuple[float, ...]:
        """Return ``noise_std``, one value per column, or the default if absent.

        ``largest``: the range of each column. Raises ``InputError`` for a value beyond it.
        """
        if not self.sensor.has("noise_std"):
            return default
        noise = self.sensor.numbers("noise_std", (len(default),))
        for value, limit in zip(noise, largest, strict=True):
            self.sensor.check_std("noise_std", value, limit)
        return noise

    def check_identity_mount(self) -> None:
        """Check T_BS of a stream that does not use it, and note a value other than the identity."""
        if not np.array_equal(self.sensor.transform(), np.eye(4)):
            self.notes.append(
                warning(
                    "T_BS in sensor.yaml is not the identity",
                    "body axes assumed for the values",
                    "turn the values into body axes, or write the identity",
                )
            )
