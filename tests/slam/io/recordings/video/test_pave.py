"""Video packets of the AR.Drone 2: pictures by the drone's time, damage, and codes that are not read."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from slam.core.errors import InputError
from tests.slam.io.recordings.read_recording import read

SAMPLE = Path(os.environ.get("SLAM_DATA", "")) / "recordings" / "ardrone" / "pave.bin"
measured = pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set")
KEY_PICTURE, FOLLOWING_PICTURE = 1, 3


def packet(number: int, kind: int, codec: int = 4, payload: bytes = b"\0\0\0\1picture") -> bytes:
    sizes = struct.pack("<HI4H", 64, len(payload), 640, 368, 640, 360)
    head = b"PaVE" + bytes([2, codec]) + sizes + struct.pack("<II4B", number, 33 * number, 1, 0, kind, 0)
    return head.ljust(64, b"\0") + payload


@measured
def test_recorded_packets_are_pictures_on_the_drone_s_clock():
    flight = read(SAMPLE)
    assert len(flight.frames) == 17  # of 20 packets, three come before the first key picture
    assert flight.frames.stamps_s[[1, -1]] == pytest.approx([0.023, 0.511])  # 1792577271 - 1792577248 ms
    pictures = [frame.read() for frame in flight.frames]
    assert {picture.shape for picture in pictures} == {(360, 640, 3)}
    for k in (16, 0, 8, 9, 3):  # a stream without an index is counted from its start
        assert np.array_equal(flight.frames[k].read(), pictures[k])
    assert any("3 pictures before the first key picture" in line for line in flight.warnings)


@measured
def test_damaged_packets_are_passed_over_and_counted(tmp_path):
    content = SAMPLE.read_bytes()
    starts = [k for k in range(len(content)) if content.startswith(b"PaVE", k)]
    path = tmp_path / "damaged.pave"
    path.write_bytes(content[: starts[10]] + b"XXXX" + content[starts[10] + 4 : -100])
    flight = read(path)
    lost = starts[11] - starts[10] + len(content) - 100 - starts[-1]
    assert len(flight.frames) == 15
    assert any(f"{lost} bytes hold no picture" in line for line in flight.warnings)
    assert any("1 pictures were not received" in line for line in flight.warnings)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (packet(1, FOLLOWING_PICTURE), "without a complete key picture"),
        (packet(1, KEY_PICTURE)[:-1], "without a complete key picture"),
        (packet(1, KEY_PICTURE, codec=2), r"another code than H\.264 \(codecs \[2\]\)"),
        (b"PaVE", "without a complete key picture"),
    ],
)
def test_what_cannot_be_decoded_is_refused(tmp_path, content, why):
    path = tmp_path / "a.pave"
    path.write_bytes(content)
    with pytest.raises(InputError, match=why):
        read(path)


def test_pictures_without_content_are_refused(tmp_path):
    path = tmp_path / "a.pave"
    path.write_bytes(packet(1, KEY_PICTURE))
    with pytest.raises(InputError, match=r"no picture can be decoded|cannot be decoded"):
        read(path)
