"""GoPro's metadata: values worked out by hand from bytes written here, and recorded videos."""

from __future__ import annotations

import os
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.core.messages import warning
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.choice import Request
from slam.io.recordings.formats import open_recording
from slam.io.recordings.recording import COPY_AGAIN
from slam.io.recordings.video.gpmf import read_gopro
from slam.io.recordings.video.mp4 import read_tracks
from tests.slam.io.recordings.video.made_video import file_of_samples

SAMPLES = Path(os.environ.get("SLAM_DATA", "")) / "recordings" / "gopro"
measured = pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set")


def block(key: bytes, code: bytes, size: int, count: int, data: bytes) -> bytes:
    return struct.pack(">4scBH", key, code, size, count) + data + bytes(-len(data) % 4)


def nested(key: bytes, *blocks: bytes) -> bytes:
    content = b"".join(blocks)
    return block(key, b"\0", 1, len(content), content)


def scale(*factors: int) -> bytes:
    return block(b"SCAL", b"l", 4, len(factors), struct.pack(f">{len(factors)}i", *factors))


def gps5(fix: int, *rows: tuple[int, ...]) -> bytes:
    data = b"".join(struct.pack(">5i", *row) for row in rows)
    keys = (block(b"GPSF", b"L", 4, 1, struct.pack(">I", fix)), scale(10**7, 10**7, 1000, 1000, 100))
    return nested(b"DEVC", nested(b"STRM", *keys, block(b"GPS5", b"l", 20, len(rows), data)))


def positions(path: Path, payloads: list[bytes]):
    file_of_samples(path, b"meta", b"gpmd", [1000] * len(payloads), payloads)
    return read_gopro(path, read_tracks(path)[0])


def test_positions_of_a_payload_are_spread_over_its_second(tmp_path):
    row = (475_000_000, 82_500_000, 488_250, 0, 0)
    found = positions(tmp_path / "a.mp4", [gps5(3, row, row), gps5(2, row), gps5(0, row)])
    assert found.key == "GPS5"
    assert found.positions.stamps_ns.tolist() == [0, 500_000_000, 1_000_000_000, 2_000_000_000]
    assert found.positions.values[0].tolist() == [47.5, 8.25, 488.25]
    assert found.positions.values[2, :2].tolist() == [47.5, 8.25]
    assert np.isnan(found.positions.values[2, 2]), "a fix of two dimensions has no altitude"
    assert np.isnan(found.positions.values[3]).all(), "no fix"


def test_newer_cameras_hold_the_fix_in_each_sample(tmp_path):
    rows = [(475_000_000, 82_500_000, 488_250, 0, 0, 8000, 1000, 150, fix) for fix in (3, 0)]
    data = b"".join(struct.pack(">7i2H", *row) for row in rows)
    keys = (
        block(b"TYPE", b"c", 1, 9, b"lllllllSS"),
        scale(10**7, 10**7, 1000, 1000, 100, 1, 1000, 100, 1),
    )
    payload = nested(b"DEVC", nested(b"STRM", *keys, block(b"GPS9", b"?", 32, 2, data)))
    found = positions(tmp_path / "a.mp4", [payload])
    assert found.key == "GPS9"
    assert found.positions.values[0].tolist() == [47.5, 8.25, 488.25]
    assert np.isnan(found.positions.values[1]).all()


def without_scale(payload: bytes) -> bytes:
    at = payload.index(b"SCAL") + 8
    return payload[:at] + bytes(20) + payload[at + 20 :]


@pytest.mark.parametrize(
    "damage",
    [
        lambda payload: payload[:-9],
        without_scale,
        lambda payload: payload.replace(b"GPS5l", b"GPS5x"),
        lambda payload: payload.replace(b"GPS5l\x14", b"GPS5l\x12"),
        lambda payload: payload.replace(b"SCALl\x04\0\5", b"SCALl\x02\0\5"),
    ],
    ids=["cut short", "scale zero", "unknown type", "another size", "odd scale"],
)
def test_a_damaged_payload_is_passed_over_and_counted(damage, tmp_path):
    row = (475_000_000, 82_500_000, 488_250, 0, 0)
    whole = gps5(3, row)
    assert damage(whole) != whole
    found = positions(tmp_path / "a.mp4", [damage(whole), whole])
    assert found.positions.stamps_ns.tolist() == [1_000_000_000]
    assert found.positions.values.tolist() == [[47.5, 8.25, 488.25]]
    damaged = "1 of 2 payloads of GoPro's metadata is damaged or of an unknown layout"
    assert found.damage == (warning(damaged, COPY_AGAIN),)
    assert positions(tmp_path / "a.mp4", [whole + bytes(12)]).damage == (), "zeros pad a payload"


def test_payloads_beyond_the_end_of_the_file_are_counted(tmp_path):
    row = (475_000_000, 82_500_000, 488_250, 0, 0)
    path = tmp_path / "a.mp4"
    file_of_samples(path, b"meta", b"gpmd", [1000] * 2, [gps5(3, row)] * 2)
    (track,) = read_tracks(path)
    beyond = replace(track, offsets=track.offsets + [0, path.stat().st_size])
    found = read_gopro(path, beyond)
    assert found.positions.stamps_ns.tolist() == [0]
    assert len(found.damage) == 1


def test_the_largest_turn_of_the_stabilisation_is_found(tmp_path):
    turned = [(32767, 0, 0, 0), (28377, 16384, 0, 0), (0, 0, 0, 0)]  # none, 60 degrees, not recorded
    data = b"".join(struct.pack(">4h", *row) for row in turned)
    payload = nested(b"DEVC", nested(b"STRM", block(b"IORI", b"s", 8, len(turned), data)))
    assert positions(tmp_path / "a.mp4", [payload, payload]).stabilised_deg == pytest.approx(60, abs=0.01)
    still = nested(b"DEVC", nested(b"STRM", block(b"IORI", b"s", 8, 1, data[:8])))
    assert positions(tmp_path / "b.mp4", [still]).stabilised_deg == pytest.approx(0)


FAST = (1000, 2000, 3000)
SLOW = (100, -200, 300)


def of_imu(
    gyro: list[tuple], accel: list[tuple], keys: tuple[bytes, ...] = (), model: bytes = b"HERO9 Black"
) -> bytes:
    """A payload with both instruments, 1000 counts to rad/s and 100 to m/s²."""
    streams = [
        nested(
            b"STRM",
            *keys,
            block(b"SCAL", b"s", 2, 1, struct.pack(">h", factor)),
            block(key, b"s", 6, len(rows), b"".join(struct.pack(">3h", *row) for row in rows)),
        )
        for key, factor, rows in ((b"GYRO", 1000, gyro), (b"ACCL", 100, accel))
    ]
    return nested(b"DEVC", block(b"DVNM", b"c", 1, len(model), model), *streams)


def orin(axes: bytes) -> bytes:
    return block(b"ORIN", b"c", 1, 3, axes)


def named(text: bytes) -> bytes:
    return block(b"STNM", b"c", 1, len(text), text)


@pytest.mark.parametrize(
    ("keys", "model", "forward_left_up"),
    [
        ((orin(b"ZXY"),), b"HERO9 Black", (1, 2, 3)),  # forward is Z (the camera's top), left X, up Y
        ((orin(b"XzY"),), b"GoPro Max", (-2, 1, 3)),
        ((orin(b"YxZ"),), b"HERO8 Black", (3, -2, 1)),
        ((named(b"Gyroscope (z,x,y)"),), b"Camera", (1, 2, 3)),
        ((named(b"Accelerometer (up/down, right/left, forward/back)"),), b"Camera", (1, 2, 3)),
        ((), b"HERO5 Black", (1, 2, 3)),
        ((), b"HERO6 Black", (3, -2, 1)),
        ((), b"Fusion", (3, 2, -1)),
    ],
    ids=["ORIN", "Max", "HERO8", "named", "words", "HERO5", "HERO6", "Fusion"],
)
def test_axes_of_each_model_become_forward_left_up(tmp_path, keys, model, forward_left_up):
    """Counts 1000, 2000, 3000 are 1, 2, 3 rad/s; 100, -200, 300 are 1, -2, 3 m/s²."""
    found = positions(tmp_path / "a.mp4", [of_imu([FAST] * 2, [SLOW] * 2, keys, model)])
    assert found.imu.values[0, :3].tolist() == list(forward_left_up)
    accel = dict(zip((1, 2, 3), (1, -2, 3), strict=True))
    assert found.imu.values[0, 3:].tolist() == [np.sign(k) * accel[abs(k)] for k in forward_left_up]
    assert not {"GYRO", "ACCL"} & dict(found.others).keys()


@pytest.mark.parametrize("keys", [(), (orin(b"XYz"),), (orin(b"XXY"),)], ids=["none", "left-handed", "two"])
def test_an_imu_without_known_axes_is_left(tmp_path, keys):
    found = positions(tmp_path / "a.mp4", [of_imu([FAST] * 2, [SLOW] * 2, keys, b"HERO77")])
    assert len(found.imu.stamps_ns) == 0
    assert {"GYRO", "ACCL"} <= dict(found.others).keys()


def test_a_slower_accelerometer_is_interpolated_at_the_gyro(tmp_path):
    gyro = [(1000 * k, 0, 0) for k in range(4)]  # each 250 ms
    found = positions(tmp_path / "a.mp4", [of_imu(gyro, [(0, 0, 0), (100, 0, 0)], (orin(b"ZXY"),))])
    assert (found.imu.stamps_ns / 1e9).tolist() == [0, 0.25, 0.5], "no accelerometer behind 0.5 s"
    assert found.imu.values[:, 0].tolist() == [0, 1, 2]
    assert found.imu.values[:, 3].tolist() == [0, 0.5, 1]


@measured
def test_a_recorded_imu_agrees_with_gravity_and_with_the_drone_that_carries_it():
    """The Karma's camera looks ahead with its top up. From 0.5 to 5 s the autopilot's speed ahead grows from
    2.68 to 8.26 m/s, so the axis to the back measures -1.24 m/s².
    """
    recording = open_recording(SAMPLES / "karma.mp4")
    flight = flight_of(recording, Request({"imu0": "GYRO"}))
    forward, left, up = flight.imu.accel_m_s2[200:2000].mean(axis=0)
    assert (forward, left) == pytest.approx((9.81, 0), abs=0.5), "the camera's top is up"
    assert up == pytest.approx(-1.24, abs=0.4)
    without = flight_of(recording)
    assert without.imu is None
    assert any("looks 91 degrees away from straight down" in line for line in without.warnings)


@measured
def test_a_recorded_video_has_positions_at_18_hz():
    flight = flight_of(open_recording(SAMPLES / "max-heromode.mp4"))
    assert any("stabilised electronically, by up to 19 degrees" in line for line in flight.warnings)
    assert len(flight.frames) == 315
    assert 17 < 1 / np.median(np.diff(flight.gps.stamps_s)) < 19.5
    assert flight.gps.latitude_deg[0] == pytest.approx(33.126, abs=0.01)
    assert flight.gps.longitude_deg[0] == pytest.approx(-117.327, abs=0.01)
    left = {source.channel for source in flight.sources if not source.stream}
    assert {"CORI", "GYRO"} <= left, "pictures that are stabilised turn otherwise than the camera"


@measured
def test_a_recorded_video_of_a_drone_without_positions_of_the_camera():
    flight = flight_of(open_recording(SAMPLES / "karma.mp4"))
    assert (len(flight.frames), flight.gps) == (362, None)
    assert "GPRI" in {source.channel for source in flight.sources}
