"""Tables of readings: names, units and angles of aviation."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest

from slam.cli.source import open_flight
from slam.core.errors import InputError
from slam.core.progress import silent
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.tables.made_table import table
from tests.slam.io.recordings.video.made_video import video


def test_units_and_spellings_become_those_of_a_flight(tmp_path):
    path = table(
        tmp_path / "a.csv",
        "time(millisecond),Lat,lng,abs_alt [ft],height_above_takeoff(feet),voltage(v),sonar_mm,note",
        "1000,51.5,-0.25,100,10,11.5,1500,hello",
        "1500,51.6,-0.25,200,20,11.4,,",
    )
    flight = read(path)
    assert flight.epoch_ns == 10**9
    assert flight.gps.stamps_s.tolist() == [0.0, 0.5]
    assert flight.gps.latitude_deg.tolist() == [51.5, 51.6]
    assert flight.gps.altitude_m == pytest.approx([30.48, 60.96])
    assert flight.barometer.value == pytest.approx([3.048, 6.096])
    assert flight.battery.value.tolist() == [11.5, 11.4]
    assert flight.sonar.range_m[0] == 1.5
    assert any(source.channel == "note" and not source.stream for source in flight.sources)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
def test_tables_in_other_encodings_are_read(tmp_path, encoding):
    text = "time [s],roll [\u00b0],pitch [\u00b0],yaw [\u00b0]\n0,10,0,0\n1,20,0,0\n"
    (tmp_path / "a.csv").write_bytes(text.encode(encoding))
    flight = read(tmp_path / "a.csv")
    assert flight.attitude.roll_pitch_yaw_rad[:, 0] == pytest.approx(np.radians([10, 20]))
    assumed = [line for line in flight.warnings if "neither UTF-8 nor UTF-16; Windows-1252 assumed" in line]
    assert len(assumed) == (encoding == "cp1252")
    assert not any("zeros" in line for line in flight.warnings)


@pytest.mark.parametrize(
    ("header", "row", "expected_deg"),
    [
        ("time_s,roll_deg,pitch_deg,heading_deg", "0,10,20,90", (10, -20, 0)),  # east, nose up
        ("t [s],roll [rad],pitch [rad],yaw [rad]", "0,0.1,0.2,0.3", np.degrees((0.1, 0.2, 0.3))),
        ("time [s],gb_yaw [°],gb_pitch [°],gb_roll [°]", "0,0,-90,0", (0, 0, 90)),  # straight down, top north
    ],
)
def test_angles_of_aviation_of_a_flight_folder_and_of_a_gimbal(tmp_path, header, row, expected_deg):
    flight = read(table(tmp_path / "a.csv", header, row, "1" + row[1:]))
    assert np.degrees(flight.attitude.roll_pitch_yaw_rad[0]) == pytest.approx(expected_deg, abs=1e-9)


def test_columns_of_a_flight_folder_are_read(tmp_path):
    names = [f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"] + [f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"]
    rows = [f"{k * 5_000_000},0.1,0.2,0.3,0,0,9.8" for k in range(9)]
    flight = read(table(tmp_path / "a.csv", ",".join(["#timestamp [ns]", *names]), *rows))
    assert flight.imu.gyro_rad_s[4].tolist() == [0.1, 0.2, 0.3]
    assert flight.imu.stamps_s[8] == pytest.approx(0.04)


def test_semicolons_and_decimal_commas(tmp_path):
    flight = read(table(tmp_path / "a.csv", "time [s];range [m]", "0,5;1,25", "1,5;1,75"))
    assert flight.sonar.range_m.tolist() == [1.25, 1.75]
    assert flight.sonar.stamps_s.tolist() == [0.0, 1.0]


def test_positions_that_are_held_and_those_before_a_fix_are_left_out(tmp_path):
    rows = [f"{k / 10},{(0, 10)[k > 1]}.0,{(0, 20)[k > 1]}.{k // 3},5" for k in range(12)]
    flight = read(table(tmp_path / "a.csv", "time [s],latitude,longitude,altitude [m]", *rows))
    assert flight.gps.stamps_s == pytest.approx([0.2, 0.3, 0.6, 0.9])
    assert flight.barometer is None


@pytest.mark.parametrize(
    ("header", "why"),
    [
        ("time [s],roll,pitch,yaw", r"column 'roll' has no unit; write roll \[rad\] or roll \[deg\]"),
        ("time [s],range [furlong]", "column 'range .furlong.' has the unit 'furlong'"),
        ("time,range [m]", r"column 'time' has no unit; write time \[s\]"),
        ("time [s],colour,taste", "without a stream of a flight"),
    ],
)
def test_a_table_whose_meaning_is_uncertain_is_one_line(tmp_path, header, why):
    with pytest.raises(InputError, match=why):
        read(table(tmp_path / "a.csv", header, "0,1,2,3"))


def test_an_archive_of_a_video_and_its_table(tmp_path):
    video(tmp_path / "a.mp4")
    table(tmp_path / "a.csv", "time [s],range [m]", *(f"{k},1.{k}" for k in range(4)))
    with zipfile.ZipFile(tmp_path / "both.zip", "w") as archive:
        for name in ("a.mp4", "a.csv"):
            archive.write(tmp_path / name, name)
    flight, _ = open_flight(tmp_path / "both.zip", silent)
    assert len(flight.frames) == 40
    assert len(flight.sonar.stamps_s) == 4


def test_a_table_with_two_attitudes_is_taken_once_and_not_listed_as_left(tmp_path):
    header = "time [s],gb_yaw [°],gb_pitch [°],gb_roll [°],roll [°],pitch [°],heading [°]"
    flight = read(table(tmp_path / "a.csv", header, "0,0,-90,0,1,2,3", "1,0,-90,0,1,2,3"))
    assert [source.stream for source in flight.sources if source.channel == "a.csv"] == ["attitude0"]
