"""Damage of recordings that the fuzzer found: each is read or refused in one line."""

from __future__ import annotations

import struct

import pytest

from slam.core.errors import InputError
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.formats import open_recording
from slam.io.recordings.video.mp4 import read_tracks
from tests.slam.io.recordings.logs.made_ulog import HEADER, message
from tests.slam.io.recordings.logs.test_dataflash import IMU, imu_rows, log
from tests.slam.io.recordings.test_tum import folder
from tests.slam.io.recordings.video.made_video import file_of_samples


def test_an_imu_without_one_of_its_axes_is_no_imu(tmp_path):
    labels = IMU[1].replace("GyrZ", "GyrQ")
    with pytest.raises(InputError, match="without a stream of a flight"):
        flight_of(open_recording(log(tmp_path / "a.bin", {"IMU": (IMU[0], labels, imu_rows())})))


def test_stamps_beyond_any_clock_are_counted(tmp_path):
    rows = [*imu_rows(), (2**63, *imu_rows()[0][1:])]
    flight = flight_of(open_recording(log(tmp_path / "a.bin", {"IMU": (*IMU, rows)})))
    assert len(flight.imu.stamps_s) == 5
    assert any("1 message has a stamp that no clock has" in line for line in flight.warnings)


@pytest.mark.parametrize("stamp", ["9" * 5000, "9999999999.5"])
def test_a_stamp_of_too_many_digits_is_refused(stamp, tmp_path):
    root = folder(tmp_path / "a", f"{stamp} 1 2 3 0 0 0 1\n")
    with pytest.raises(InputError, match="has the stamp"):
        flight_of(open_recording(root))


@pytest.mark.parametrize(("table", "damage"), [(b"mdhd", b"\0\0\0\0"), (b"stco", b"\0\0\0\0")])
def test_a_track_without_units_or_places_is_damaged(table, damage, tmp_path):
    path = file_of_samples(tmp_path / "a.mp4", b"meta", b"gpmd", [1000], [b"1234"])
    data = bytearray(path.read_bytes())
    at = data.index(table) + 4 + {b"mdhd": 12, b"stco": 4}[table]
    data[at : at + 4] = damage
    path.write_bytes(data)
    with pytest.raises(InputError, match="damaged index"):
        read_tracks(path)


def test_a_px4_log_that_ends_in_an_unknown_message_ends(tmp_path):
    """pyulog steps back from a message beyond the end, and would read it again without end."""
    body = bytes(40) + struct.pack("<HB", 300, 0) + bytes(20)
    (tmp_path / "a.ulg").write_bytes(HEADER + struct.pack("<Q", 0) + message(b"B", bytes(40)) + body)
    with pytest.raises(InputError):
        flight_of(open_recording(tmp_path / "a.ulg"))
