"""Rules of the flight format: what breaks the meaning is refused in one line."""

import os
import shutil

import numpy as np
import pytest

from slam.io.flight_folder import read_flight, write_flight
from tests.slam.io.flight_edits import assert_refused, assert_warned, change, change_row, mav, scale
from tests.slam.io.made_flight import made_flight


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A flight in a folder; tests copy it before they change it."""
    path = tmp_path_factory.mktemp("written") / "f"
    write_flight(made_flight(), path)
    return path


@pytest.fixture
def folder(written, tmp_path):
    return shutil.copytree(written, tmp_path / "f")


HEADERS = [
    ("imu0", r"w_RS_S_x \[rad s\^-1\]", "w_RS_S_x [deg s^-1]", "pi/180"),
    ("imu0", r"a_RS_S_z \[m s\^-2\]", "a_RS_S_z [g]", "9.80665"),
    ("imu0", r",a_RS_S_z \[m s\^-2\]", "", "a_RS_S_z"),
    ("sonar0", r"\[m\]", "[mm]", "0.001"),
    ("sonar0", r"\[ns\]", "[us]", "microseconds"),
    ("sonar0", r"\[ns\]", "[s]", "seconds"),
    ("sonar0", r"\[ns\]", "[jiffies]", "jiffies"),
    ("sonar0", "range", "distance", "range [m]"),
    ("attitude0", r"roll \[rad\]", "roll [deg]", "pi/180"),
    ("attitude0", r"^.*\n", "", "no header line"),
    ("velocity0", ",", ";", "starts with"),
    ("cam0", "filename", "picture", "filename"),
    ("command0", r"left \[1\]", "forward [1]", "twice"),
]


@pytest.mark.parametrize(("stream", "old", "new", "word"), HEADERS)
def test_headers(folder, stream, old, new, word):
    change(mav(folder, stream) / "data.csv", (old, new))
    assert_refused(folder, f"{stream}/data.csv, line 1", word)


ROWS = [
    ("imu0", 7, 0, "1603996430.5", "integers in nanoseconds"),
    ("imu0", 7, 0, "1.6039e18", "integers in nanoseconds"),
    ("imu0", 7, 0, "99999999999999999999", "2096"),
    ("imu0", 7, 0, "-9223372036854775808", "2096"),
    ("imu0", 9, 3, "fast", "'fast'"),
    ("imu0", 9, 3, "1_0", "'1_0'"),
    ("imu0", 9, 3, "1,2", "8 fields instead of 7"),
    ("sonar0", 4, 1, "1.2 m", "range [m]"),
    ("command0", 5, 2, "1.5", "1.5"),
    ("command0", 5, 2, "-85", "percent"),
    ("gps0", 3, 1, "90.5", "latitude"),
    ("gps0", 3, 2, "190", "longitude"),
    ("gps0", 3, 1, "473000000", "1e7"),
    ("cam0", 3, 1, "../../../../../etc/passwd", "outside data/"),
    ("cam0", 3, 1, "/etc/passwd", "outside data/"),
    ("cam0", 3, 0, "x", "'x'"),
]


@pytest.mark.parametrize(("stream", "line", "column", "value", "word"), ROWS)
def test_rows(folder, stream, line, column, value, word):
    change_row(mav(folder, stream) / "data.csv", line, column, value)
    assert_refused(folder, f"{stream}/data.csv, line {line}", word)


YAML = [
    ("cam0", r"intrinsics: .*\n", "", "no intrinsics"),
    ("cam0", r"intrinsics: .*", "intrinsics: [40, 0, 20, 20]", "focal"),
    ("cam0", r"intrinsics: .*", "intrinsics: [1e9, 1e9, 20, 20]", "focal length 1e+09"),
    ("cam0", r"intrinsics: .*", "intrinsics: [40, 40, 20]", "4 numbers"),
    ("cam0", r"intrinsics: .*", "intrinsics: [40, 40, nan, 20]", "nan"),
    ("cam0", r"intrinsics: .*", "intrinsics: [40, 40, 900, 20]", "centre"),
    ("cam0", r"resolution: .*\n", "", "no resolution"),
    ("cam0", r"resolution: .*", "resolution: [50, 36]", "48 x 36"),
    ("cam0", r"resolution: .*", "resolution: [-48, 36]", "positive"),
    ("cam0", r"radial-tangential", "double-sphere", "double-sphere"),
    ("cam0", r"pinhole", "omni", "omni"),
    ("cam0", r"pinhole", "pinhole\nreadout: 30", "readout is 30 s"),
    ("cam0", r"distortion_coefficients: .*", "distortion_coefficients: [1, 2]", "4 or 5"),
    ("imu0", r"rows: 4", "rows: 3", "4 x 4"),
    ("imu0", r"data: \[", "data: [0.5, ", "16 numbers"),
    ("imu0", r"data: \[[^,]*,", "data: [0.3,", "not a rotation"),
    ("imu0", r"data: \[[^,]*,", "data: [1e308,", "not a rotation"),
    ("sonar0", r"data: \[[^]]*\]", "data: [1,0,0,1e308, 0,1,0,0, 0,0,1,0, 0,0,0,1]", "from the body"),
    ("attitude0", r"data: \[1.0,", "data: [-1.0,", "mirrored"),
    ("imu0", r"1.0\]", "2.0]", "0, 0, 0, 1"),
    ("imu0", r"gyroscope_noise_density: .*", "gyroscope_noise_density: -1", "positive"),
    ("imu0", r"gyroscope_noise_density: .*", "gyroscope_noise_density: 1e9", "gyroscope_noise_density"),
    ("imu0", r"gyroscope_random_walk: .*", "gyroscope_random_walk: 1e300", "gyroscope_random_walk"),
    ("imu0", r"accelerometer_noise_density: .*", "accelerometer_noise_density: 1e9", "noise_density"),
    ("imu0", r"accelerometer_random_walk: .*", "accelerometer_random_walk: 1e9", "random_walk"),
    ("imu0", r"gyroscope_noise_density: .*", "gyroscope_noise_density: 1e-300", "rounded"),
    ("imu0", r"accelerometer_random_walk: .*", "accelerometer_random_walk: 1e-300", "rounded"),
    ("sonar0", r"noise_std: .*", "noise_std: [1e-300]", "rounded"),
    ("cam0", r"pinhole", "pinhole\nmount_std: 1e-300", "rounded"),
    ("cam0", r"pinhole", "pinhole\nfocal_std_ratio: 1e9", "focal_std_ratio"),
    ("cam0", r"pinhole", "pinhole\nradial_std: 1e9", "radial_std"),
    ("cam0", r"pinhole", "pinhole\nmount_std: 57.3", "mount_std"),
    ("sonar0", r"noise_std: .*", "noise_std: [1e9]", "noise_std"),
    ("attitude0", r"noise_std: .*", "noise_std: [1, 57.3, 1]", "noise_std"),
    ("velocity0", r"noise_std: .*", "noise_std: [1e9, 1]", "noise_std"),
    ("velocity0", r"noise_std: .*", "scale_std: 1e9", "scale_std"),
    ("gps0", r"noise_std: .*", "noise_std: [1e9, 1e9, 1e9]", "noise_std"),
    ("barometer0", r"noise_std: .*", "noise_std: [1e9]", "noise_std"),
    ("battery0", r"noise_std: .*", "noise_std: [1e9]", "noise_std"),
    ("command0", r"max_tilt: .*", "max_tilt: 30", "degrees?"),
    ("imu0", r"rate_hz: .*", "rate_hz: often", "'often'"),
    ("sonar0", r"min_range: .*", "min_range: 9", "min_range < max_range"),
    ("sonar0", r"max_range: .*", "max_range: 1e300", "max_range is 1e+300"),
    ("sonar0", r"noise_std: .*", "noise_std: 0.1", "write 1 number in"),
    ("sonar0", r"beam_width: .*", "beam_width: 25", "degrees?"),
    ("sonar0", r"data: \[[^]]*\]", "data: [1,0,0,30, 0,1,0,0, 0,0,1,0, 0,0,0,1]", "30 m from the body"),
    ("attitude0", r"noise_std: .*", "noise_std: [1, 2]", "3 numbers"),
    ("gps0", r"sensor_type: ", "sensor_type: &a ", "anchors"),
    ("gps0", r"sensor_type: gps", "sensor_type: !!python/object/apply:os.system [ls]", "tag"),
    ("gps0", r"sensor_type: ", "rate_hz: 5\nsensor_type: ", "twice"),
    ("gps0", r"sensor_type: ", "sensor_type: [", "YAML"),
    ("gps0", r"sensor_type: gps", "sensor_type: " + "[" * 40 + "]" * 40, "deeper"),
]


@pytest.mark.parametrize(("stream", "old", "new", "word"), YAML)
def test_sensor_yaml(folder, stream, old, new, word):
    change(mav(folder, stream) / "sensor.yaml", (old, new))
    message = assert_refused(folder, word)
    assert f"{stream}/sensor.yaml" in message or "48 x 36" in message


ABOUT = [
    ("landmark_pairs: [[A, Z]]", "'Z'"),
    ("landmark_pairs: [[A]]", "pairs"),
    ("landmark_pairs: A-B", "pairs"),
    ("all_keyframes: perhaps", "true or false"),
    ("name: [1]", "name"),
    ("- a\n- b", "key: value"),
]


@pytest.mark.parametrize(("text", "word"), ABOUT)
def test_flight_yaml(folder, text, word):
    (folder / "flight.yaml").write_text(text)
    assert_refused(folder, "flight.yaml", word)


LANDMARKS = [
    ("name,x [mm],y [m],z [m]\nA,1,2,3\n", "line 1"),
    ("name,x [m],y [m],z [m]\nA,1,2,\n", "line 2"),
    ("name,x [m],y [m],z [m]\nA,1,2,3\nA,1,2,3\n", "twice"),
    ("name,x [m],y [m],z [m]\nA,1,2\n", "3 fields"),
    ("", "header"),
]


@pytest.mark.parametrize(("text", "word"), LANDMARKS)
def test_landmarks(folder, text, word):
    (folder / "landmarks.csv").write_text(text)
    assert_refused(folder, "landmarks.csv", word)


def test_alias_bomb_and_huge_yaml_are_refused_at_once(folder):
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
    (folder / "flight.yaml").write_text("\n".join(lines))
    assert_refused(folder, "aliases")
    (folder / "flight.yaml").write_text("notes: " + "x" * (2 << 20))
    assert_refused(folder, "bytes")


def test_implausible_units_are_refused(folder):
    imu = mav(folder, "imu0") / "data.csv"
    whole = imu.read_text()
    scale(imu, (1, 2, 3), 180 / np.pi)
    assert_refused(folder, "imu0", "deg/s")
    imu.write_text(whole)
    scale(imu, (4, 5, 6), 1 / 9.80665)
    assert_refused(folder, "imu0", "in g?")
    imu.write_text(whole)
    scale(imu, (4, 5, 6), 1000)
    assert_refused(folder, "imu0", "mm/s^2")
    imu.write_text(whole)
    attitude = mav(folder, "attitude0") / "data.csv"
    scale(attitude, (1, 2, 3), 180 / np.pi)
    assert_refused(folder, "attitude0", "degrees?")
    scale(attitude, (1, 2, 3), 0.1)
    scale(imu, (1, 2, 3), 0.1)
    assert_refused(folder, "attitude0", "degrees?")


def test_ranges_in_millimetres(folder):
    scale(mav(folder, "sonar0") / "data.csv", (1,), 1000)
    assert_refused(folder, "sonar0", "millimetres?")


@pytest.mark.parametrize("with_rate", [True, False])
@pytest.mark.parametrize(
    ("factor", "unit"), [(1000, "microseconds"), (10**6, "milliseconds"), (10**9, "seconds")]
)
def test_stamps_in_another_unit(folder, factor, unit, with_rate):
    csv = mav(folder, "sonar0") / "data.csv"
    header, *rows = csv.read_text().splitlines()
    csv.write_text(
        "\n".join([header, *(f"{int(r.split(',')[0]) // factor},{r.split(',')[1]}" for r in rows)])
    )
    if not with_rate:
        change(mav(folder, "sonar0") / "sensor.yaml", (r"rate_hz: .*\n", ""))
    assert_refused(folder, "sonar0/data.csv", unit)


def test_missing_parts(folder):
    (mav(folder, "imu0") / "data.csv").unlink()
    assert_refused(folder, "imu0/data.csv", "does not exist")


def test_only_the_camera_requires_its_yaml(folder):
    (mav(folder, "sonar0") / "sensor.yaml").unlink()
    assert assert_warned(folder, "sonar0", "no sensor.yaml").sonar.noise_std_m == 0.01
    (mav(folder, "cam0") / "sensor.yaml").unlink()
    assert_refused(folder, "cam0/sensor.yaml")


def test_folders_that_are_not_flights_are_refused(folder, tmp_path):
    assert_refused(tmp_path / "nope", "does not exist")
    assert_refused(tmp_path, "holds flights: f")
    assert_refused(folder / "mav0", "folder above")
    assert_refused(folder / "flight.yaml", "not a folder")
    (tmp_path / "e" / "mav0").mkdir(parents=True)
    assert_refused(tmp_path / "e", "no known stream")
    (tmp_path / "photos").mkdir()
    assert_refused(tmp_path / "photos", "is empty")
    (tmp_path / "photos" / "a.JPG").touch()
    assert_refused(tmp_path / "photos", "slam import")


def test_links_out_of_the_folder(folder, tmp_path):
    (tmp_path / "secret.png").write_bytes((mav(folder, "cam0") / "data/000.png").read_bytes())
    one = mav(folder, "cam0") / "data/000.png"
    one.unlink()
    one.symlink_to(tmp_path / "secret.png")
    assert_refused(folder, "000.png", "leads out")
    one.unlink()
    one.symlink_to("001.png")
    read_flight(folder)
    csv = mav(folder, "imu0") / "data.csv"
    csv.rename(tmp_path / "imu.csv")
    csv.symlink_to(tmp_path / "imu.csv")
    assert_refused(folder, "imu0", "leads out")


def test_pipes_and_folders_instead_of_files_are_refused(folder):
    csv = mav(folder, "imu0") / "data.csv"
    csv.unlink()
    os.mkfifo(csv)
    assert_refused(folder, "named pipe")
    csv.unlink()
    csv.mkdir()
    assert_refused(folder, "a folder")


def test_column_without_a_unit_is_described(folder):
    scale(mav(folder, "command0") / "data.csv", (1,), 1e9)
    message = assert_refused(folder, "command0/data.csv", "plain numbers, 1 for the whole")
    assert "[1]" not in message
    assert "1e+06 1" not in message
