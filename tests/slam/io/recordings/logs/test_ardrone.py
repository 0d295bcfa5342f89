"""An AR.Drone's navdata: values worked out by hand from packets written here, the clock, and damage."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.core.rotations import rotation_of
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.formats import open_recording

SAMPLE = Path(os.environ.get("SLAM_DATA", "")) / "recordings" / "ardrone" / "navdata.bin"
measured = pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set")


def option(tag: int, layout: str, *values) -> bytes:
    body = struct.pack("<" + layout, *values)
    return struct.pack("<HH", tag, 4 + len(body)) + body


def packet(*options: bytes, number: int = 1) -> bytes:
    data = struct.pack("<4I", 0x55667788, 0, number, 0) + b"".join(options)
    return data + struct.pack("<HHI", 0xFFFF, 8, sum(data))


def time(seconds: int, microseconds: int = 0) -> bytes:
    return option(1, "I", seconds << 21 | microseconds)


def demo(theta=0.0, phi=0.0, psi=0.0, altitude=0, velocity=(0.0, 0.0, 0.0)) -> bytes:
    return option(0, "IIfffi3f", 0, 80, theta, phi, psi, altitude, *velocity)


def read(path: Path, *packets: bytes):
    path.write_bytes(b"".join(packets))
    return flight_of(open_recording(path))


def test_angles_speeds_and_height_of_the_demo_option(tmp_path):
    """Nose up 10 degrees, right side down 5, a quarter turn clockwise: yaw 0; 0.5 m/s to the right."""
    flight = read(tmp_path / "a", packet(time(5), demo(10_000, 5_000, 90_000, 1250, (200.0, 500.0, 0.0))))
    np.testing.assert_allclose(np.degrees(flight.attitude.roll_pitch_yaw_rad), [[5, -10, 0]], atol=1e-5)
    np.testing.assert_allclose(flight.velocity.v_m_s, [[0.2, -0.5]])
    np.testing.assert_allclose(flight.sonar.range_m, [1.25])
    assert flight.epoch_ns == 5 * 10**9


def test_the_other_options(tmp_path):
    """A pressure of 990 hPa lies 195.3 m above that of the sea level in the standard atmosphere."""
    options = (
        option(2, "16xI", 11_500),
        option(3, "fH3f3f", 40.0, 0, 100.0, 200.0, -1000.0, 90.0, 45.0, -45.0),
        option(9, "4B8x", 0, 51, 102, 255),
        option(10, "ifii", 7, 0, 0, 840),
        option(21, "ihii", 0, 0, 250, 99_000),
    )
    flight = read(tmp_path / "a", packet(time(1), demo(altitude=999), *options))
    np.testing.assert_allclose(flight.imu.accel_m_s2, [[0.980665, -1.96133, 9.80665]], rtol=1e-6)
    np.testing.assert_allclose(np.degrees(flight.imu.gyro_rad_s), [[90, -45, 45]], rtol=1e-6)
    np.testing.assert_allclose(flight.sonar.range_m, [0.84])
    np.testing.assert_allclose(flight.battery.value, [11.5])
    np.testing.assert_allclose(flight.motor.drive, [[0, 0.2, 0.4, 1]])
    np.testing.assert_allclose(flight.barometer.value, [195.3], atol=0.1)


def test_no_echo_is_a_missing_range(tmp_path):
    rows = [packet(time(k), option(10, "ifii", 0, 0, 0, mm)) for k, mm in enumerate((0, 500), 1)]
    ranges = read(tmp_path / "a", *rows).sonar.range_m
    assert np.isnan(ranges[0])
    assert ranges[1] == 0.5


def test_the_clock_begins_again_after_2048_seconds(tmp_path):
    times = [(2047, 500_000), (0, 250_000), (1, 0)]
    flight = read(tmp_path / "a", *(packet(time(*each), demo()) for each in times))
    np.testing.assert_allclose(flight.attitude.stamps_s, [0, 0.75, 1.5])


def test_damaged_packets_are_passed_over_and_counted(tmp_path):
    good = [packet(time(k), demo(), number=k) for k in range(1, 6)]
    damaged = bytearray(good[2])
    damaged[30] ^= 0xFF
    flight = read(tmp_path / "a", *good[:2], bytes(damaged), *good[3:], good[0][:-3])
    assert len(flight.attitude.stamps_s) == 4
    lost = len(damaged) + len(good[0]) - 3
    assert any(f"{lost} bytes hold no packet" in line for line in flight.warnings)


def test_packets_of_the_demo_mode_have_no_time(tmp_path):
    with pytest.raises(InputError, match="without a time in its packets; record with all options"):
        read(tmp_path / "a", packet(demo()))
    flight = read(tmp_path / "a", packet(time(1), demo()), packet(demo()))
    assert any("1 packet has no time" in line for line in flight.warnings)


def test_a_file_without_a_complete_packet_is_refused(tmp_path):
    with pytest.raises(InputError, match="without a complete packet"):
        read(tmp_path / "a", packet(time(1), demo())[:40])


@measured
def test_a_recorded_packet_agrees_with_gravity():
    """The drone stands: its accelerometer shows the same tilt as its attitude, to a few degrees."""
    flight = flight_of(open_recording(SAMPLE))
    up = rotation_of(flight.attitude.roll_pitch_yaw_rad[0]).T @ [0, 0, 1]
    accel = flight.imu.accel_m_s2[0]
    assert np.degrees(np.arccos(up @ accel / np.linalg.norm(accel))) < 3
    assert np.linalg.norm(accel) == pytest.approx(9.3, abs=0.1)
    assert np.sign(up[:2]).tolist() == np.sign(accel[:2]).tolist()
    assert flight.battery.value[0] == pytest.approx(11.686)
    assert flight.sonar.range_m[0] == pytest.approx(0.243)
    assert not any("no packet" in line for line in flight.warnings)
