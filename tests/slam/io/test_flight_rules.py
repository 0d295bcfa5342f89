"""Rules of the flight format: what breaks the meaning is refused in one line, what does not is told."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from slam.errors import InputError
from slam.flight import Flight
from slam.io.flight_folder import read_flight, write_flight
from tests.slam.io.made_flight import made_flight, picture


@pytest.fixture
def folder(tmp_path):
    write_flight(made_flight(), tmp_path / "f")
    return tmp_path / "f"


def mav(folder, name):
    return folder / "mav0" / name


def change(path, *edits):
    """Replace text in a file; the text must be there."""
    text = path.read_text()
    for old, new in edits:
        assert re.search(old, text, re.MULTILINE), old
        text = re.sub(old, new, text, count=1, flags=re.MULTILINE)
    path.write_text(text)


def change_row(path, line, column, value):
    lines = path.read_text().splitlines()
    fields = lines[line - 1].split(",")
    fields[column] = value
    lines[line - 1] = ",".join(fields)
    path.write_text("\n".join(lines) + "\n")


def scale(path, columns, factor):
    lines = path.read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    for row in rows:
        for c in columns:
            row[c] = row[c] and repr(float(row[c]) * factor)
    path.write_text("\n".join([lines[0], *map(",".join, rows)]) + "\n")


def refused(folder, *words):
    with pytest.raises(InputError) as caught:
        read_flight(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert "; " in message  # what to do
    for word in words:
        assert word in message, message
    return message


def told(folder, *words):
    flight = read_flight(folder)
    assert any(all(w in line for w in words) for line in flight.warnings), flight.warnings
    return flight


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
    refused(folder, f"{stream}/data.csv, line 1", word)


ROWS = [
    ("imu0", 7, 0, "1603996430.5", "integers in nanoseconds"),
    ("imu0", 7, 0, "1.6039e18", "integers in nanoseconds"),
    ("imu0", 7, 0, "99999999999999999999", "2096"),
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
    refused(folder, f"{stream}/data.csv, line {line}", word)


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
    ("cam0", r"radial-tangential", "equidistant", "equidistant"),
    ("cam0", r"pinhole", "omni", "omni"),
    ("cam0", r"distortion_coefficients: .*", "distortion_coefficients: [1, 2]", "4 or 5"),
    ("imu0", r"rows: 4", "rows: 3", "4 x 4"),
    ("imu0", r"data: \[", "data: [0.5, ", "16 numbers"),
    ("imu0", r"data: \[[^,]*,", "data: [0.3,", "not a rotation"),
    ("attitude0", r"data: \[1.0,", "data: [-1.0,", "mirrored"),
    ("imu0", r"1.0\]", "2.0]", "0, 0, 0, 1"),
    ("imu0", r"gyroscope_noise_density: .*", "gyroscope_noise_density: -1", "positive"),
    ("imu0", r"rate_hz: .*", "rate_hz: often", "'often'"),
    ("sonar0", r"min_range: .*", "min_range: 9", "min_range < max_range"),
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
    message = refused(folder, word)
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
    refused(folder, "flight.yaml", word)


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
    refused(folder, "landmarks.csv", word)


def test_alias_bomb_and_huge_yaml_are_refused_at_once(folder):
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
    (folder / "flight.yaml").write_text("\n".join(lines))
    refused(folder, "aliases")
    (folder / "flight.yaml").write_text("notes: " + "x" * (2 << 20))
    refused(folder, "bytes")


def test_units_that_no_header_shows(folder):
    imu = mav(folder, "imu0") / "data.csv"
    whole = imu.read_text()
    scale(imu, (1, 2, 3), 180 / np.pi)
    refused(folder, "imu0", "deg/s")
    imu.write_text(whole)
    scale(imu, (4, 5, 6), 1 / 9.80665)
    refused(folder, "imu0", "in g?")
    imu.write_text(whole)
    scale(imu, (4, 5, 6), 1000)
    refused(folder, "imu0", "mm/s^2")
    imu.write_text(whole)
    attitude = mav(folder, "attitude0") / "data.csv"
    scale(attitude, (1, 2, 3), 180 / np.pi)
    refused(folder, "attitude0", "degrees?")
    scale(attitude, (1, 2, 3), 0.1)
    scale(imu, (1, 2, 3), 0.1)
    refused(folder, "attitude0", "degrees?")


def test_ranges_in_millimetres(folder):
    scale(mav(folder, "sonar0") / "data.csv", (1,), 1000)
    refused(folder, "sonar0", "millimetres?")


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
    refused(folder, "sonar0/data.csv", unit)


def test_missing_parts(folder):
    (mav(folder, "imu0") / "data.csv").unlink()
    refused(folder, "imu0/data.csv", "does not exist")


def test_camera_needs_its_yaml_others_do_without(folder):
    (mav(folder, "sonar0") / "sensor.yaml").unlink()
    assert told(folder, "sonar0", "no sensor.yaml").sonar.noise_std_m == 0.01
    (mav(folder, "cam0") / "sensor.yaml").unlink()
    refused(folder, "cam0/sensor.yaml")


def test_what_is_no_flight(folder, tmp_path):
    refused(tmp_path / "nope", "does not exist")
    refused(tmp_path, "holds flights: f")
    refused(folder / "mav0", "folder above")
    refused(folder / "flight.yaml", "not a folder")
    (tmp_path / "e" / "mav0").mkdir(parents=True)
    refused(tmp_path / "e", "no stream")
    (tmp_path / "photos").mkdir()
    refused(tmp_path / "photos", "is empty")
    (tmp_path / "photos" / "a.JPG").touch()
    refused(tmp_path / "photos", "slam import")


def test_links_out_of_the_folder(folder, tmp_path):
    (tmp_path / "secret.png").write_bytes((mav(folder, "cam0") / "data/000.png").read_bytes())
    one = mav(folder, "cam0") / "data/000.png"
    one.unlink()
    one.symlink_to(tmp_path / "secret.png")
    refused(folder, "000.png", "leads out")
    one.unlink()
    one.symlink_to("001.png")
    read_flight(folder)
    csv = mav(folder, "imu0") / "data.csv"
    csv.rename(tmp_path / "imu.csv")
    csv.symlink_to(tmp_path / "imu.csv")
    refused(folder, "imu0", "leads out")


def test_pipes_and_folders_for_files_do_not_hang(folder):
    csv = mav(folder, "imu0") / "data.csv"
    csv.unlink()
    os.mkfifo(csv)
    refused(folder, "named pipe")
    csv.unlink()
    csv.mkdir()
    refused(folder, "a folder")


def same_streams(a: Flight, b: Flight, *fields):
    for field in fields:
        x, y = getattr(a, field), getattr(b, field)
        for name in x.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(x, name), getattr(y, name))


def test_line_endings_bom_spaces_and_extra_columns(folder):
    before = read_flight(folder)
    for k, path in enumerate(sorted((folder / "mav0").glob("*/data.csv"))):
        data = path.read_bytes()
        data = data.replace(b"\n", [b"\r\n", b"\r", b"\n\n"][k % 3])
        path.write_bytes(b"\xef\xbb\xbf" + data)
    same_streams(before, read_flight(folder), "imu", "sonar", "command", "gps", "truth")
    csv = mav(folder, "sonar0") / "data.csv"
    rows = csv.read_text(encoding="utf-8-sig").split()
    rows = [r for r in csv.read_text(encoding="utf-8-sig").splitlines() if r]
    decoyed = ["#timestamp [ns], range_raw [m], range [m]"]
    decoyed += [f"{r.split(',')[0]} , 77.7, {r.split(',')[1]} " for r in rows[1:]]
    csv.write_text("\n".join(decoyed) + "\n")
    same_streams(before, told(folder, "sonar0", "range_raw"), "sonar")


def test_units_may_be_spelt_otherwise(folder):
    change(mav(folder, "velocity0") / "data.csv", (r"v_x \[m s\^-1\]", "v_x [m/s]"), (r"v_y \[.*\]", "v_y"))
    assert read_flight(folder).warnings == ()


def test_missing_values_stay_missing_or_go(folder):
    before = read_flight(folder)
    for stream, column in (("imu0", 2), ("sonar0", 1), ("attitude0", 1), ("gps0", 1), ("velocity0", 2)):
        change_row(mav(folder, stream) / "data.csv", 12, column, "NaN")
    change_row(mav(folder, "battery0") / "data.csv", 12, 1, "inf")
    after = told(folder, "imu0", "1 rows dropped")
    assert len(after.imu.stamps_s) == len(before.imu.stamps_s) - 1
    assert len(after.gps.stamps_s) == len(before.gps.stamps_s) - 1
    assert np.isnan(after.sonar.range_m[10])
    assert np.isnan(after.attitude.roll_pitch_yaw_rad[10, 0])
    assert np.isnan(after.velocity.v_m_s[10, 1])
    assert np.isnan(after.battery.value[10])
    told(folder, "battery0", "1 infinite")


def test_impossible_values_are_taken_out_and_counted(folder):
    change_row(mav(folder, "imu0") / "data.csv", 9, 4, "1e30")
    change_row(mav(folder, "sonar0") / "data.csv", 9, 1, "-0.5")
    change_row(mav(folder, "sonar0") / "data.csv", 11, 1, "65.535")
    flight = told(folder, "imu0", "a_RS_S_x", "line 9")
    assert np.abs(flight.imu.accel_m_s2).max() < 100
    assert np.isnan(flight.sonar.range_m[[7, 9]]).all()
    told(folder, "sonar0", "zero or less")
    told(folder, "sonar0", "max_range")


def test_quaternions(folder):
    csv = mav(folder, "state_groundtruth_estimate0") / "data.csv"
    for column in (4, 5, 6, 7):
        change_row(csv, 9, column, "0")
    before = len(made_flight().truth.stamps_s)
    assert (
        len(told(folder, "state_groundtruth_estimate0", "1 rows dropped", "quaternion").truth.stamps_s)
        == before - 1
    )
    scale(csv, (4, 5, 6, 7), 2)
    refused(folder, "state_groundtruth_estimate0/data.csv, line 2", "quaternion")


def test_first_fixes_at_zero_zero_go(folder):
    for column in (1, 2):
        change_row(mav(folder, "gps0") / "data.csv", 2, column, "0")
    assert abs(told(folder, "gps0", "no fix").geo_origin().latitude_deg - 47.3) < 0.01


def test_ends_of_a_recorder_without_power(folder):
    before = read_flight(folder)
    csv = mav(folder, "imu0") / "data.csv"
    whole = csv.read_bytes()
    csv.write_bytes(whole[:-1])
    same_streams(before, read_flight(folder), "imu")
    for end in (whole[:-40], whole[: len(whole) // 2]):
        csv.write_bytes(end)
        flight = told(folder, "imu0", "last line")
        n = len(flight.imu.stamps_s)
        assert n == end.count(b"\n") - 1
        np.testing.assert_array_equal(flight.imu.gyro_rad_s, before.imu.gyro_rad_s[:n])
    told(folder, "imu0", "s are lost")
    csv.write_bytes(whole[:-300] + b"\0" * 300)
    assert len(told(folder, "imu0", "zeros").imu.stamps_s) < len(before.imu.stamps_s)
    csv.write_bytes(b"\0" * 300)
    refused(folder, "imu0", "is empty")
    csv.write_bytes(whole.splitlines()[0] + b"\n")
    assert told(folder, "imu0", "no rows").imu is None


def test_a_cut_last_number_is_not_taken_for_a_whole_one(folder):
    csv = mav(folder, "barometer0") / "data.csv"
    header = csv.read_text().splitlines()[0]
    rows = [f"{10**18 + k * 10**8},{100 + k / 1000:.4f}" for k in range(20)]
    csv.write_text("\n".join([header, *rows])[:-5])
    flight = told(folder, "barometer0", "last line")
    assert len(flight.barometer.value) == 19


def test_pictures_missing_truncated_and_of_another_size(folder):
    data = mav(folder, "cam0") / "data"
    (data / "001.png").unlink()
    (data / "002.png").write_bytes((data / "002.png").read_bytes()[:-200])
    from PIL import Image

    Image.fromarray(picture(0, (50, 50))).save(data / "003.png")
    (data / "stray.png").touch()
    flight = told(folder, "1 of 30 pictures are missing")
    assert [frame.read() is None for frame in flight.frames][:5] == [False, True, True, True, False]
    assert flight.frames.load.failures == {1: "missing", 2: "truncated", 3: "is 50 x 50 px, not 48 x 36"}
    told(folder, "cam0", "not listed")
    told(folder, "cam0", "change their size")
    for path in data.iterdir():
        path.unlink()
    refused(folder, "none of the 30")


def test_unknown_folders_and_misspelt_keys_are_told(folder):
    (folder / "mav0/flow0").mkdir()
    change(mav(folder, "sonar0") / "sensor.yaml", ("noise_std", "noise_sdt"))
    told(folder, "flow0", "skipped")
    told(folder, "sonar0", "noise_sdt", "noise_std")


def test_rate_far_from_nominal_is_told(folder):
    change(mav(folder, "imu0") / "sensor.yaml", (r"rate_hz: .*", "rate_hz: 200"))
    told(folder, "imu0", "rate is 100 Hz", "200 Hz")


def test_unreadable_file(folder):
    csv = mav(folder, "imu0") / "data.csv"
    csv.chmod(0)
    if os.access(csv, os.R_OK):
        pytest.skip("this user may read everything")
    refused(folder, "cannot be read")


def test_hostile_names_are_shown_on_one_line(folder, tmp_path):
    evil = tmp_path / "a\nb\x1b[31m"
    folder.rename(evil)
    (evil / "flight.yaml").write_text('name: "x\\ny"\nnoise: [1]\n')
    assert "\n" not in read_flight(evil).name
    change_row(evil / "mav0/sonar0/data.csv", 3, 1, "\x1b[2J")
    assert "\x1b" not in refused(evil)


def test_flight_open_is_the_reader(folder):
    assert Flight.open(str(folder)).name == read_flight(Path(folder)).name
