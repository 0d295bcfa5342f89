"""Times of tables: dates, times of day, weeks of GPS, and those that cannot be read."""

from __future__ import annotations

import pytest

from slam.core.errors import InputError
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.tables.made_table import table

MAY_NS = 1_714_730_400 * 10**9
"""3 May 2024, 10:00 UTC."""


@pytest.mark.parametrize(
    ("header", "stamps", "epoch_ns"),
    [
        ("timestamp", ("2024-05-03T10:00:00.000Z", "2024-05-03T10:00:00.500Z"), MAY_NS),
        ("time [s]", ("2024-05-03T12:00:00.000+02:00", "2024-05-03T12:00:00.500+02:00"), MAY_NS),
        ("datetime(utc)", ("2024/05/03 10:00:00", "2024/05/03 10:00:00.5"), MAY_NS),
        ("time", ("23:59:59.75", "00:00:00.25"), (24 * 3600 - 0.25) * 1e9),
        ("time [local]", ("01:00:00.0 PM", "01:00:00.5 PM"), 13 * 3600 * 10**9),
        ("timestamp,time [s]", ("2024-05-03T10:00:00Z,7", "2024-05-03T10:00:00.5Z,7.5"), MAY_NS),
        ("gps_week,gps_tow [s]", ("2312,468000.0", "2312,468000.5"), MAY_NS),
        ("tow [ms]", ("1000", "1500"), 10**9),
    ],
)
def test_times_of_other_kinds_are_read(tmp_path, header, stamps, epoch_ns):
    flight = read(table(tmp_path / "a.csv", f"{header},range [m]", *(f"{stamp},1.5" for stamp in stamps)))
    assert flight.sonar.stamps_s == pytest.approx([0.0, 0.5])
    assert flight.epoch_ns == pytest.approx(epoch_ns, abs=1000)


@pytest.mark.parametrize(
    ("header", "stamp", "why"),
    [
        (
            "time [s]",
            "soon",
            r"column 'time \[s\]' has no time that can be read, first 'soon'; write seconds",
        ),
        ("time [s]", "1714730400000", r"median 1.71473e\+12, after the year 2096 .* \(in ms\?\)"),
        ("time", "12.5", r"column 'time' has no unit; write time \[s\]"),
    ],
)
def test_times_that_cannot_be_read_are_refused(tmp_path, header, stamp, why):
    path = table(tmp_path / "a.csv", f"{header},range [m]", f"{stamp},1.5", f"{stamp},1.6")
    with pytest.raises(InputError, match=why):
        read(path)
