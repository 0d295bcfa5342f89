"""Tables of numbers, read in blocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import slam.io.csv_stream
from slam.io.csv_header import CsvColumn
from slam.io.csv_stream import read_numbers
from slam.io.csv_table import CsvTable

COLUMNS = (CsvColumn("height", "m", 1e3), CsvColumn("speed", "m s^-1", 1e3))


def written(folder: Path, rows: list[str]) -> Path:
    path = folder / "data.csv"
    path.write_text("#timestamp [ns],height [m],speed [m s^-1]\n" + "\n".join(rows) + "\n")
    return path


def read(path: Path) -> CsvTable:
    return read_numbers(path, path.parent, COLUMNS)


@pytest.mark.parametrize("block", [1, 3, 4, 11, 12, 100])
@pytest.mark.parametrize("without_stamp", [None, 0, 10])
def test_result_does_not_depend_on_the_block_size(
    block: int, without_stamp: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor on the block of a row without a stamp."""
    rows = [f"{10**18 + 10**7 * k},{0.1 * k},{'' if k % 5 == 4 else -k}" for k in range(12)]
    if without_stamp is not None:
        rows[without_stamp] = f"nan,{without_stamp},1"
    path = written(tmp_path, rows)
    whole = read(path)
    assert len(whole.stamps_ns) == (12 if without_stamp is None else 11)
    monkeypatch.setattr(slam.io.csv_stream, "BLOCK_ROWS", block)
    some = read(path)
    np.testing.assert_array_equal(some.stamps_ns, whole.stamps_ns)
    np.testing.assert_array_equal(some.values, whole.values)
    np.testing.assert_array_equal(some.lines, whole.lines)
    assert some.notes == whole.notes
