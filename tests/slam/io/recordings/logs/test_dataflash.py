"""ArduPilot's dataflash logs: values worked out by hand from bytes written here, and damage."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.core.rotations import rotation_of
from slam.io.flight_folder import read_flight, write_flight
from tests.slam.io.recordings.read_recording import read

SAMPLES = Path(os.environ.get("SLAM_DATA", "")) / "recordings" / "ardupilot"
measured = pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set")
PYTHON_CODE = {
    **dict(zip("bBhHiIfdqQ", "bBhHiIfdqQ", strict=True)),
    **dict(n="4s", N="16s", Z="64s", c="h", C="H", e="i", E="I", L="i", M="B"),
}
IMU = ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
FLOW = ("QBffff", "TimeUS,Qual,flowX,flowY,bodyX,bodyY")
RANGE = ("QBfBBb", "TimeUS,Instance,Dist,Stat,Orient,Quality")


def declaration(number: int, name: str, codes: str, labels: str) -> bytes:
    length = 3 + struct.calcsize("<" + "".join(PYTHON_CODE[code] for code in codes))
    body = struct.pack("<BB4s16s64s", number, length, name.encode(), codes.encode(), labels.encode())
    return b"\xa3\x95\x80" + body


def log(path: Path, messages: dict[str, tuple[str, str, list[tuple]]]) -> Path:
    """Write messages: name -> (codes, labels, rows)."""
    own = "Type,Length,Name,Format,Columns"
    parts = [b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 128, 89, b"FMT", b"BBnNZ", own.encode())]
    for number, (name, (codes, labels, rows)) in enumerate(messages.items(), 1):
        parts.append(declaration(number, name, codes, labels))
        layout = "<" + "".join(PYTHON_CODE[code] for code in codes)
        parts += [b"\xa3\x95" + bytes([number]) + struct.pack(layout, *row) for row in rows]
    path.write_bytes(b"".join(parts))
    return path


def imu_rows(count: int = 5, instance: int = 0) -> list[tuple]:
    return [(2_000_000 + 4000 * k, instance, 0.5, 0.25, 0.125, 1.0, 2.0, -9.75) for k in range(count)]


def test_forward_right_down_becomes_forward_left_up(tmp_path):
    flight = read(log(tmp_path / "a.bin", {"IMU": (*IMU, [*imu_rows(), *imu_rows(3, 1)])}))
    assert flight.imu.gyro_rad_s.tolist() == [[0.5, -0.25, -0.125]] * 5
    assert flight.imu.accel_m_s2[0].tolist() == [1.0, -2.0, 9.75]
    assert flight.epoch_ns == 2_000_000_000
    left = [source.channel for source in flight.sources if not source.stream]
    assert left == ["IMU[1]"]
    assert len(read(tmp_path / "a.bin", imu0="IMU[1]").imu.stamps_s) == 3


@pytest.mark.parametrize(
    ("roll_pitch_yaw_deg", "expected_deg"),
    [((0, 0, 0), (0, 0, 90)), ((10, 20, 90), (10, -20, 0)), ((0, 0, 270), (0, 0, 180))],
)
def test_angles_in_hundredths_of_a_degree(tmp_path, roll_pitch_yaw_deg, expected_deg):
    row = (1_000_000, *(100 * a for a in roll_pitch_yaw_deg[:2]), 100 * roll_pitch_yaw_deg[2])
    flight = read(log(tmp_path / "a.bin", {"ATT": ("QccC", "TimeUS,Roll,Pitch,Yaw", [row])}))
    angles = np.degrees(flight.attitude.roll_pitch_yaw_rad[0])
    assert (angles - expected_deg + 180) % 360 - 180 == pytest.approx([0, 0, 0], abs=1e-6)


def test_integer_positions_and_fixes(tmp_path):
    rows = [
        (1_000_000, 0, 3, -353_632_621, 1_491_652_373, 584.09),
        (1_200_000, 0, 2, -353_632_620, 1_491_652_374, 584.0),
        (1_400_000, 0, 1, 0, 0, 0.0),
    ]
    message = ("QBBLLf", "TimeUS,I,Status,Lat,Lng,Alt", rows)
    gps = read(log(tmp_path / "a.bin", {"GPS": message})).gps
    assert gps.latitude_deg == pytest.approx([-35.3632621, -35.3632620], abs=1e-9)
    assert gps.longitude_deg == pytest.approx([149.1652373, 149.1652374], abs=1e-9)
    assert gps.altitude_m[0] == pytest.approx(584.09, abs=1e-4)
    assert gps.height_system == "EPSG:5773", "sea level by EGM96"
    assert np.isnan(gps.altitude_m[1])


def test_ranges_that_are_good_and_look_down(tmp_path):
    rows = [
        (1_000_000 + k, 0, 2.5, status, orient, 90)
        for k, (status, orient) in enumerate(((4, 25), (2, 25), (4, 0)))
    ]
    flight = read(log(tmp_path / "a.bin", {"RFND": (*RANGE, rows)}))
    assert flight.sonar.range_m[0] == 2.5
    assert np.isnan(flight.sonar.range_m[1:]).all()


def test_ranges_of_older_logs_are_in_hundredths(tmp_path):
    rows = [(1_000_000, 250, 25)]
    flight = read(log(tmp_path / "a.bin", {"RFND": ("QCB", "TimeUS,Dist1,Orient1", rows)}))
    assert flight.sonar.range_m.tolist() == [2.5]


def test_an_older_range_sensor_that_looks_ahead_is_no_height(tmp_path):
    rows = [(1_000_000 + k, 500, 0) for k in range(3)]
    flight = read(log(tmp_path / "a.bin", {"RFND": ("QCB", "TimeUS,Dist1,Orient1", rows)}))
    assert flight.sonar is None
    assert any("sensors that do not look down" in line for line in flight.warnings)


def test_parameters_and_voltages_of_old_logs(tmp_path):
    """Parameters have no stamp, -1 reverses a channel, and voltages are hundredths."""
    sticks = ("IHHHH", "TimeMS,C1,C2,C3,C4", [(1000, 1700, 1500, 1100, 1500)])
    messages = {
        "PARM": ("Nf", "Name,Value", [(b"RC1_REV", -1.0), (b"RC2_REV", 1.0)]),
        "CURR": ("Ih", "TimeMS,Volt", [(1000, 1150)]),
        "RCIN": sticks,
    }
    flight = read(log(tmp_path / "a.bin", messages))
    assert flight.battery.value == pytest.approx([11.5])
    assert flight.command.stick[0] == pytest.approx([0.0, 0.5, -1.0, 0.0])


def test_ranges_of_the_oldest_logs_have_no_orientation(tmp_path):
    flight = read(log(tmp_path / "a.bin", {"RFND": ("QCC", "TimeUS,Dist1,Dist2", [(1_000_000, 250, 0)])}))
    assert flight.sonar.range_m.tolist() == [2.5]


@pytest.mark.parametrize(
    ("names", "limits"),
    [
        ((), None),
        (("RNGFND2_MIN_CM", "RNGFND2_MAX_CM"), (20, 8000)),
        (("RNGFND2_MIN", "RNGFND2_MAX"), (0.2, 80)),
    ],
)
def test_a_far_range_is_read_with_the_limits_of_the_parameters(tmp_path, names, limits):
    """The first sensor looks ahead, and leaves its place to the second one, which sees 50 m."""
    ranges = [(1_000_000 + k, i, 50.0 if i else 5.0, 4, 25 * i, 90) for k in range(3) for i in (0, 1)]
    messages = {"RFND": (*RANGE, ranges)}
    if names:
        rows = [(0, name.encode(), value) for name, value in zip(names, limits, strict=True)]
        messages["PARM"] = ("QNf", "TimeUS,Name,Value", rows)
    flight = read(log(tmp_path / "a.bin", messages))
    assert flight.sonar.range_m.tolist() == [50.0] * 3
    assert flight.sonar.max_range_m == (80.0 if names else np.inf)
    assert any("no max_range is stated" in line for line in flight.warnings) == (not names)
    write_flight(flight, tmp_path / "f")
    again = read_flight(tmp_path / "f").sonar
    assert (again.range_m.tolist(), again.max_range_m) == ([50.0] * 3, flight.sonar.max_range_m)


def test_a_receiver_states_its_accuracy(tmp_path):
    fixes = [(1_000_000 + 200_000 * k, 1, 3, 600_000_000, 80_000_000, 584.0) for k in range(3)]
    none = [(1_000_000 + 200_000 * k, 0, 1, 0, 0, 0.0) for k in range(3)]
    stated = [(row[0], row[1], 0.02 if row[1] else 99.0, 0.04) for row in [*none, *fixes]]
    messages = {"GPS": ("QBBLLf", "TimeUS,I,Status,Lat,Lng,Alt", [*none, *fixes])}
    messages["GPA"] = ("QBff", "TimeUS,I,HAcc,VAcc", stated)
    gps = read(log(tmp_path / "a.bin", messages)).gps
    assert gps.latitude_deg.tolist() == [60.0] * 3, "the second receiver; the first has no fix"
    assert gps.noise_std_m == pytest.approx((0.02, 0.02, 0.04), rel=1e-5)


def test_each_fix_has_its_own_accuracy_where_they_differ(tmp_path):
    """It is kept on disk; a fix that states no height's accuracy has the median."""
    fixes = [(1_000_000 + 200_000 * k, 1, 3, 600_000_000, 80_000_000, 584.0) for k in range(4)]
    stated = [
        (row[0], 1, h, v)
        for row, h, v in zip(fixes, (0.02, 0.02, 4.0, 0.03), (0.04, 0.0, 8.0, 0.04), strict=True)
    ]
    messages = {"GPS": ("QBBLLf", "TimeUS,I,Status,Lat,Lng,Alt", fixes)}
    messages["GPA"] = ("QBff", "TimeUS,I,HAcc,VAcc", stated)
    flight = read(log(tmp_path / "a.bin", messages))
    write_flight(flight, tmp_path / "f")
    for gps in (flight.gps, read_flight(tmp_path / "f").gps):
        expected = [[0.02, 0.02, 0.04], [0.02, 0.02, 0.04], [4.0, 4.0, 8.0], [0.03, 0.03, 0.04]]
        np.testing.assert_allclose(gps.stds_m, expected, rtol=1e-6)
        assert "noise_std" not in gps.assumed


def test_stamps_of_old_logs_are_milliseconds(tmp_path):
    """``TimeMS`` of an old GPS message is that of the week; its stamp is ``T``."""
    ranges = [(1000 + 20 * k, 250, 25) for k in range(3)]
    fixes = [(3, 400_000_000 + 200 * k, 1800, 470_000_000, 80_000_000, 500.0, 1100 + 200 * k) for k in (0, 1)]
    messages = {
        "RFND": ("ICB", "TimeMS,Dist1,Orient1", ranges),
        "GPS": ("BIHLLfI", "Status,TimeMS,Week,Lat,Lng,Alt,T", fixes),
    }
    flight = read(log(tmp_path / "a.bin", messages))
    assert flight.epoch_ns == 1_000_000_000
    assert flight.sonar.stamps_s == pytest.approx([0.0, 0.02, 0.04])
    assert flight.gps.stamps_s == pytest.approx([0.1, 0.3])


def test_flow_times_the_range_at_its_time_is_the_speed(tmp_path):
    """The range grows from 2 to 4 m in a second; at 3 m, 0.5 rad/s about y is 1.5 m/s forward."""
    ranges = [(1_000_000, 0, 2.0, 4, 25, 90), (2_000_000, 0, 4.0, 4, 25, 90)]
    flows = [
        (1_500_000, 200, 0.0, 0.5, 0.0, 0.0),
        (1_600_000, 200, 0.25, 0.5, 0.0, 0.5),
        (1_700_000, 0, 0.25, 0.5, 0.0, 0.5),
    ]
    flight = read(log(tmp_path / "a.bin", {"RFND": (*RANGE, ranges), "OF": (*FLOW, flows)}))
    assert flight.velocity.v_m_s[:2] == pytest.approx(np.array([[1.5, 0.0], [0.0, 0.8]]), abs=1e-6)
    assert np.isnan(flight.velocity.v_m_s[2]).all()


def test_a_flow_without_a_range_is_named_as_left_out(tmp_path):
    flows = [(1_000_000, 200, 0.25, 0.5, 0.0, 0.5)]
    flight = read(log(tmp_path / "a.bin", {"IMU": (*IMU, imu_rows()), "OF": (*FLOW, flows)}))
    assert flight.velocity is None
    assert [source.channel for source in flight.sources if not source.stream] == ["OF"]


def test_sticks_by_the_calibration_of_the_log(tmp_path):
    """Right and back give longer pulses; channel 2 is trimmed to 1520 and channel 4 is reversed."""
    parameters = {
        **{"RC1_MIN": 1100, "RC1_TRIM": 1500, "RC1_MAX": 1900, "RC2_TRIM": 1520, "RC2_MIN": 1120},
        **{"RC3_MIN": 1000, "RC3_MAX": 2000, "RC4_TRIM": 1500, "RC4_MAX": 1900, "RC4_REVERSED": 1},
    }
    stored = [(900_000, name.encode(), float(value)) for name, value in parameters.items()]
    rows = [(1_000_000, 1700, 1320, 1750, 1700), (1_100_000, 0, 1520, 1000, 1500)]
    flight = read(
        log(
            tmp_path / "a.bin",
            {"PARM": ("QNf", "TimeUS,Name,Value", stored), "RCIN": ("QHHHH", "TimeUS,C1,C2,C3,C4", rows)},
        )
    )
    assert flight.command.stick[0] == pytest.approx([0.5, -0.5, 0.5, 0.5])
    assert np.isnan(flight.command.stick[1, 1]), "no signal"
    assert flight.command.stick[1, [0, 2, 3]] == pytest.approx([0, -1, 0])


def test_battery_barometer_and_vehicle(tmp_path):
    messages = {
        "MSG": ("QZ", "TimeUS,Message", [(1, b"ArduCopter V4.6.2")]),
        "BAT": ("QBf", "TimeUS,Inst,Volt", [(1_000_000, 0, 11.5)]),
        "BARO": ("QBf", "TimeUS,I,Alt", [(1_000_000, 0, 12.25)]),
    }
    flight = read(log(tmp_path / "a.bin", messages))
    assert (flight.battery.value[0], flight.barometer.value[0]) == (11.5, 12.25)
    assert flight.notes["vehicle"] == "ArduCopter V4.6.2"


def test_damaged_bytes_are_passed_over_and_counted(tmp_path):
    path = log(tmp_path / "a.bin", {"IMU": (*IMU, imu_rows(20))})
    content = bytearray(path.read_bytes())
    size = 3 + struct.calcsize("<QBffffff")
    at = len(content) - 10 * size
    content[at : at + 2] = b"\0\0"
    path.write_bytes(bytes(content[:-7]))
    flight = read(path)
    assert len(flight.imu.stamps_s) == 18, "one damaged, one cut short"
    assert any(f"{size + size - 7} bytes of the log hold no message" in line for line in flight.warnings)


@pytest.mark.parametrize("content", [b"", b"hello", b"\xa3\x95\x80"])
def test_a_log_without_messages_is_one_line(tmp_path, content):
    (tmp_path / "a.bin").write_bytes(content)
    with pytest.raises(
        InputError, match=r"a\.bin: (is empty|has the name of an ArduPilot log|is an ArduPilot log)"
    ):
        read(tmp_path / "a.bin")


@measured
def test_a_recorded_log():
    """80 KiB of a real flight on the ground: the accelerometer and the attitude agree on what is up."""
    flight = read(SAMPLES / "backend_log_80k.bin")
    assert flight.notes["vehicle"].startswith("ArduCopter V4.6.2")
    assert (len(flight.imu.stamps_s), len(flight.gps.stamps_s), len(flight.barometer.stamps_s)) == (10, 2, 5)
    up = rotation_of(flight.attitude.roll_pitch_yaw_rad[0]) @ flight.imu.accel_m_s2.mean(axis=0)
    assert up / np.linalg.norm(up) == pytest.approx([0, 0, 1], abs=0.05)
    assert np.abs(flight.command.stick).max() <= 1
