"""MAVLink telemetry logs: values worked out by hand from packets written here, clocks, and damage."""

from __future__ import annotations

import math
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.io.recordings.formats import open_recording
from slam.io.recordings.logs.mavlink import DECLARATIONS, checksum
from tests.slam.io.recordings.read_recording import read

SAMPLES = Path(os.environ.get("SLAM_DATA", "")) / "recordings" / "ardupilot"
measured = pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set")
EXTRA = {
    **{0: 50, 1: 124, 22: 220, 24: 24, 26: 170, 27: 144, 29: 115, 30: 39, 31: 246},
    **{65: 118, 105: 93, 106: 138, 132: 85, 173: 83},
}
"""The published CRC_EXTRA of each message."""
START_US = 1_600_000_000_000_000
BOOT_MS = 60_000
DELAY_US = 40_000
ARDUPILOT, PX4, QUADROTOR = 3, 12, 2


def crc(data: bytes) -> int:
    """CRC-16/MCRF4XX, bit by bit."""
    found = 0xFFFF
    for byte in data:
        found ^= byte
        for _ in range(8):
            found = found >> 1 ^ (0x8408 if found & 1 else 0)
    return found


def packet(
    number: int, layout: str, *values, version: int = 1, system: int = 1, signed: bool = False
) -> bytes:
    payload = struct.pack("<" + layout, *values)
    if version == 2:
        payload = payload.rstrip(b"\0") or b"\0"
        body = bytes((len(payload), int(signed), 0, 7, system, 1)) + number.to_bytes(3, "little") + payload
    else:
        body = bytes((len(payload), 7, system, 1, number)) + payload
    signature = bytes(13) if signed else b""
    end = struct.pack("<H", crc(body + bytes([EXTRA[number]])))
    return (b"\xfd" if version == 2 else b"\xfe") + body + end + signature


def at(seconds: float, data: bytes, delay_us: int = DELAY_US) -> bytes:
    return struct.pack(">Q", START_US + round(seconds * 1e6) + delay_us) + data


def heartbeat(autopilot: int = ARDUPILOT, kind: int = QUADROTOR, **more) -> bytes:
    return packet(0, "IBBBBB", 0, kind, autopilot, 0, 4, 3, **more)


def attitude(seconds: float, roll: float = 0, pitch: float = 0, yaw: float = 0, **more) -> bytes:
    return packet(30, "I6f", BOOT_MS + round(seconds * 1e3), roll, pitch, yaw, 0, 0, 0, **more)


def log(path: Path, *packets: bytes, autopilot: int = ARDUPILOT) -> Path:
    path.write_bytes(b"".join([at(0, heartbeat(autopilot)), *packets]))
    return path


def test_checksums_are_those_of_mavlink():
    assert checksum(b"123456789") == crc(b"123456789") == 0x6F91, "the check value of CRC-16/MCRF4XX"
    assert {number: each.extra for number, each in DECLARATIONS.items()} == EXTRA


@pytest.mark.parametrize("version", [1, 2])
def test_angles_of_the_aircraft(version, tmp_path):
    """Heading 90 degrees is east: yaw 0. Nose up 0.1 rad is a negative pitch; roll keeps its sign."""
    path = log(tmp_path / "a.tlog", at(0.5, attitude(0.5, 0.2, 0.1, math.pi / 2, version=version)))
    np.testing.assert_allclose(read(path).attitude.roll_pitch_yaw_rad, [[0.2, -0.1, 0.0]], atol=1e-6)


def test_a_signed_packet_and_a_quaternion(tmp_path):
    """Half a turn about down from north: the nose points to the south, yaw -90 degrees."""
    rows = at(0.1, packet(31, "I7f", BOOT_MS + 100, 0, 0, 0, 1, 0, 0, 0, version=2, signed=True))
    found = read(log(tmp_path / "a.tlog", rows, at(0.2, attitude(0.2)))).attitude.roll_pitch_yaw_rad
    np.testing.assert_allclose(found, [[0, 0, -math.pi / 2]], atol=1e-6)


def test_positions_of_integers(tmp_path):
    def fix(seconds: float, kind: int) -> bytes:
        time_us = round((BOOT_MS / 1e3 + seconds) * 1e6)
        return packet(24, "QiiiHHHHBB", time_us, -353_632_621, 1_491_652_373, 584_090, 0, 0, 0, 0, kind, 9)

    path = log(tmp_path / "a.tlog", *(at(k, fix(k, kind)) for k, kind in enumerate((3, 2, 1))))
    gps = read(path).gps
    np.testing.assert_allclose(gps.latitude_deg, -35.3632621, atol=1e-9)
    np.testing.assert_allclose(gps.longitude_deg, 149.1652373, atol=1e-9)
    assert gps.altitude_m[0] == pytest.approx(584.09)
    assert gps.height_system == "EPSG:5773", "sea level by EGM96"
    assert len(gps.stamps_s) == 2
    assert np.isnan(gps.altitude_m[1])


def test_a_receiver_states_its_accuracy_in_version_2(tmp_path):
    def fix(seconds: float, version: int) -> bytes:
        time_us = round((BOOT_MS / 1e3 + seconds) * 1e6)
        place = (600_000_000, 80_000_000, 500_000, 0, 0, 0, 0, 3, 9)
        more = ("iII", 0, 20, 40) if version == 2 else ("",)
        return packet(24, f"QiiiHHHHBB{more[0]}", time_us, *place, *more[1:], version=version)

    for version, noise in ((1, (5.0, 5.0, 10.0)), (2, (0.02, 0.02, 0.04))):
        path = log(tmp_path / f"{version}.tlog", *(at(k, fix(k, version)) for k in range(3)))
        assert read(path).gps.noise_std_m == pytest.approx(noise, rel=1e-5)


def test_ranges_state_their_limits(tmp_path):
    """A sensor that looks ahead has other limits than the one that looks down."""
    rows = [
        at(k / 10, packet(132, "IHHHBBBB", BOOT_MS + 100 * k, 20, most, 4000, 0, 0, facing, 0))
        for k, (most, facing) in enumerate(((5000, 25), (9000, 0), (5000, 25), (9000, 0), (9000, 0)))
    ]
    sonar = read(log(tmp_path / "a.tlog", *rows)).sonar
    assert (sonar.min_range_m, sonar.max_range_m) == pytest.approx((0.2, 50.0))
    assert sonar.range_m[[0, 2]].tolist() == [40.0, 40.0]


def test_imus_in_their_units(tmp_path):
    """1000 thousandths of g up along -z of forward-right-down axes; 500 mrad/s about each axis."""
    scaled = [
        at(k / 100, packet(26, "I9h", BOOT_MS + 10 * k, 100, 200, -1000, 500, 500, 500, 0, 0, 0))
        for k in range(9)
    ]
    imu = read(log(tmp_path / "a.tlog", *scaled)).imu
    np.testing.assert_allclose(imu.gyro_rad_s[0], [0.5, -0.5, -0.5])
    np.testing.assert_allclose(imu.accel_m_s2[0], [0.980665, -1.96133, 9.80665])
    fine = [
        at(k / 100, packet(105, "Q13fH", (BOOT_MS + 10 * k) * 1000, 1, 2, -9.8, 0.1, 0.2, 0.3, *[0] * 7, 63))
        for k in range(9)
    ]
    imu = read(log(tmp_path / "b.tlog", *scaled, *fine)).imu
    np.testing.assert_allclose(imu.accel_m_s2[0], [1, -2, 9.8], rtol=1e-6)


def test_a_slow_imu_is_taken_on_request_only(tmp_path):
    rows = [at(k / 4, packet(27, "Q9h", (BOOT_MS + 250 * k) * 1000, 0, 0, -1000, *[0] * 6)) for k in range(9)]
    path = log(tmp_path / "a.tlog", *rows, at(0.1, attitude(0.1)))
    assert read(path).imu is None
    assert any("too few to be integrated" in source.reading for source in read(path).sources)
    assert len(read(path, imu0="RAW_IMU").imu.stamps_s) == 9
    log(tmp_path / "b.tlog", *rows, at(0.1, attitude(0.1)), autopilot=PX4)
    with pytest.raises(InputError, match="no channel RAW_IMU"):
        read(tmp_path / "b.tlog", imu0="RAW_IMU")


def test_ranges_flow_voltage_and_pressure(tmp_path):
    """0.05 rad about y less 0.01 of a turn, in 0.1 s, at 2 m: 0.8 m/s forward. 1000 hPa: 110.9 m."""
    rows = [
        *(
            at(0.1 + k / 10, packet(132, "IHHHBBBB", BOOT_MS + 100 + 100 * k, 20, 400, cm, 0, 0, facing, 0))
            for k, (cm, facing) in enumerate([(250, 25), (500, 25), (250, 0)])
        ),
        at(
            0.5,
            packet(106, "QI5fIfhBB", (BOOT_MS + 500) * 1000, 100_000, 0.0, 0.05, 0, 0.01, 0, 0, 2.0, 0, 0, 9),
        ),
        at(0.6, packet(1, "IIIHHhHHHHHHb", 0, 0, 0, 0, 11_500, *[0] * 8)),
        at(0.7, packet(29, "Iffh", BOOT_MS + 700, 1000.0, 0, 0)),
    ]
    flight = read(log(tmp_path / "a.tlog", *rows))
    assert flight.sonar.range_m[0] == 2.5
    assert np.isnan(flight.sonar.range_m[1:]).all()
    np.testing.assert_allclose(flight.velocity.v_m_s, [[0.8, 0.0]], atol=1e-6)
    np.testing.assert_allclose(flight.battery.value, [11.5])
    assert flight.barometer.value[0] == pytest.approx(110.9, abs=0.1)


def test_sticks_by_the_parameters_that_were_received(tmp_path):
    """Right and back give longer pulses; channel 4 is reversed, and its range is 1000 to 2000."""
    parameters = {"RC4_REVERSED": 1, "RC4_MIN": 1000, "RC4_TRIM": 1500, "RC4_MAX": 2000}
    rows = [
        at(0.1, packet(22, "fHH16sB", value, 4, k, name.encode(), 9))
        for k, (name, value) in enumerate(parameters.items())
    ]
    pulses = (1700, 1300, 1500, 1750, *[65535] * 14)
    rows.append(at(0.5, packet(65, "I18HBB", BOOT_MS + 500, *pulses, 4, 0)))
    flight = read(log(tmp_path / "a.tlog", *rows))
    np.testing.assert_allclose(flight.command.stick, [[0.5, -0.5, 0.0, 0.5]])


def test_stamps_are_those_of_the_autopilot_after_the_earliest_reception(tmp_path):
    """Packets arrive 40 to 400 ms late. The autopilot's start is known to the smallest of these delays."""
    delays_us = (400_000, 90_000, DELAY_US, 250_000)
    rows = [at(k, attitude(k), delay_us=delay) for k, delay in enumerate(delays_us)]
    flight = read(log(tmp_path / "a.tlog", *rows, rows[-1]))
    first_ns = (START_US + DELAY_US) * 1000
    stamps_ns = flight.epoch_ns + np.round(flight.attitude.stamps_s * 1e9).astype(np.int64)
    assert (stamps_ns - first_ns).tolist() == [0, 10**9, 2 * 10**9, 3 * 10**9]
    assert any("1 message was received twice" in line for line in flight.warnings)


def test_a_second_start_of_the_autopilot(tmp_path):
    before = [at(k, attitude(k)) for k in range(3)]
    after = [at(100 + k, attitude(k - 50)) for k in range(3)]
    stamps_s = read(log(tmp_path / "a.tlog", *before, *after)).attitude.stamps_s
    np.testing.assert_allclose(stamps_s - stamps_s[0], [0, 1, 2, 100, 101, 102], atol=1e-6)


def test_ground_stations_and_other_vehicles_are_left(tmp_path):
    rows = [
        *[at(0, heartbeat(autopilot=8, kind=6, system=255))] * 9,
        *[at(k, attitude(k, 0.1, system=1)) for k in range(2)],
        *[at(k, attitude(k, 0.3, system=2)) for k in range(5)],
        at(1, heartbeat()),
        at(1, heartbeat(system=2)),
    ]
    found = read(log(tmp_path / "a.tlog", *rows)).attitude.roll_pitch_yaw_rad[:, 0]
    np.testing.assert_allclose(found, [0.1, 0.1], atol=1e-6)


def test_damaged_bytes_are_passed_over_and_counted(tmp_path):
    rows = [at(k / 10, attitude(k / 10)) for k in range(20)]
    path = log(tmp_path / "a.tlog", *rows)
    data = bytearray(path.read_bytes())
    place = len(at(0, heartbeat())) + 3 * len(rows[0]) + 20
    data[place] ^= 0xFF
    path.write_bytes(bytes(data) + b"\0" * 5)
    flight = read(path)
    assert len(flight.attitude.stamps_s) == 19
    assert any(f"{len(rows[0]) + 5} bytes of the log hold no packet" in line for line in flight.warnings)


def test_a_damaged_packet_of_an_unknown_message_hides_no_whole_one(tmp_path):
    """With number 200 there is no checksum to check, and a length of 60 bytes leads into the next packet."""
    rows = [at(k / 10, attitude(k / 10)) for k in range(20)]
    damaged = bytearray(rows[3])
    damaged[9], damaged[13] = 60, 200
    flight = read(log(tmp_path / "a.tlog", *rows[:3], bytes(damaged), *rows[4:]))
    assert len(flight.attitude.stamps_s) == 19
    assert any(f"{len(damaged)} bytes of the log hold no packet" in line for line in flight.warnings)


def test_a_log_without_an_autopilot_is_refused(tmp_path):
    path = tmp_path / "a.tlog"
    path.write_bytes(at(0, heartbeat(autopilot=8, kind=6, system=255)) + at(1, attitude(1)))
    with pytest.raises(InputError, match="without a heartbeat of an autopilot"):
        open_recording(path)


@measured
def test_a_recorded_log():
    flight = read(SAMPLES / "vtol.tlog")
    assert flight.notes["vehicle"] == "ArduPilot"
    assert len(flight.attitude.stamps_s) == 888
    assert not any("no packet" in line for line in flight.warnings)
    # A simulated flight over Canberra.
    assert np.abs(flight.gps.latitude_deg + 35.4).max() < 0.5
    assert np.abs(flight.gps.longitude_deg - 149.2).max() < 0.5
