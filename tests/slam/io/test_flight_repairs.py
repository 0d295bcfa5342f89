"""What does not break the meaning of a flight is repaired or left out, and reported."""

import os
import shutil

import cv2
import numpy as np
import pytest

from slam.core.flight import Flight
from slam.io.flight_folder import read_flight, write_flight
from tests.slam.io.flight_edits import assert_refused, assert_warned, change, change_row, mav, scale
from tests.slam.io.made_flight import made_flight, picture


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A flight in a folder; tests copy it before they change it."""
    path = tmp_path_factory.mktemp("written") / "f"
    write_flight(made_flight(), path)
    return path


@pytest.fixture
def folder(written, tmp_path):
    return shutil.copytree(written, tmp_path / "f")


def assert_same_streams(a: Flight, b: Flight, *fields):
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
    assert_same_streams(before, read_flight(folder), "imu", "sonar", "command", "gps", "truth")
    csv = mav(folder, "sonar0") / "data.csv"
    rows = csv.read_text(encoding="utf-8-sig").split()
    rows = [r for r in csv.read_text(encoding="utf-8-sig").splitlines() if r]
    decoyed = ["#timestamp [ns], range_raw [m], range [m]"]
    decoyed += [f"{r.split(',')[0]} , 77.7, {r.split(',')[1]} " for r in rows[1:]]
    csv.write_text("\n".join(decoyed) + "\n")
    assert_same_streams(before, assert_warned(folder, "sonar0", "range_raw"), "sonar")


def test_units_may_be_spelt_otherwise(folder):
    change(mav(folder, "velocity0") / "data.csv", (r"v_x \[m s\^-1\]", "v_x [m/s]"), (r"v_y \[.*\]", "v_y"))
    assert read_flight(folder).warnings == ()


def test_missing_values_are_kept_or_their_rows_dropped(folder):
    before = read_flight(folder)
    for stream, column in (("imu0", 2), ("sonar0", 1), ("attitude0", 1), ("gps0", 1), ("velocity0", 2)):
        change_row(mav(folder, stream) / "data.csv", 12, column, "NaN")
    change_row(mav(folder, "battery0") / "data.csv", 12, 1, "inf")
    after = assert_warned(folder, "imu0", "1 of 600 rows dropped")
    assert len(after.imu.stamps_s) == len(before.imu.stamps_s) - 1
    assert len(after.gps.stamps_s) == len(before.gps.stamps_s) - 1
    assert np.isnan(after.sonar.range_m[10])
    assert np.isnan(after.attitude.roll_pitch_yaw_rad[10, 0])
    assert np.isnan(after.velocity.v_m_s[10, 1])
    assert np.isnan(after.battery.value[10])
    assert_warned(folder, "battery0", "1 infinite")


def test_impossible_values_are_removed_and_counted(folder):
    change_row(mav(folder, "imu0") / "data.csv", 9, 4, "1e30")
    change_row(mav(folder, "sonar0") / "data.csv", 9, 1, "-0.5")
    change_row(mav(folder, "sonar0") / "data.csv", 11, 1, "65.535")
    flight = assert_warned(folder, "imu0", "a_RS_S_x", "line 9")
    assert np.abs(flight.imu.accel_m_s2).max() < 100
    assert np.isnan(flight.sonar.range_m[[7, 9]]).all()
    assert_warned(folder, "sonar0", "zero or less")
    assert_warned(folder, "sonar0", "max_range")


def test_quaternions(folder):
    csv = mav(folder, "state_groundtruth_estimate0") / "data.csv"
    for column in (4, 5, 6, 7):
        change_row(csv, 9, column, "0")
    before = len(made_flight().truth.stamps_s)
    assert (
        len(
            assert_warned(
                folder, "state_groundtruth_estimate0", "1 of 300 rows dropped", "quaternion"
            ).truth.stamps_s
        )
        == before - 1
    )
    scale(csv, (4, 5, 6, 7), 2)
    assert_refused(folder, "state_groundtruth_estimate0/data.csv, line 2", "quaternion")


def test_fixes_at_zero_zero_are_dropped(folder):
    for column in (1, 2):
        change_row(mav(folder, "gps0") / "data.csv", 2, column, "0")
    assert abs(assert_warned(folder, "gps0", "no fix").geo_origin().latitude_deg - 47.3) < 0.01


def test_traces_of_a_power_loss_are_dropped(folder):
    before = read_flight(folder)
    csv = mav(folder, "imu0") / "data.csv"
    whole = csv.read_bytes()
    csv.write_bytes(whole[:-1])
    assert_same_streams(before, read_flight(folder), "imu")
    for end in (whole[:-40], whole[: len(whole) // 2]):
        csv.write_bytes(end)
        flight = assert_warned(folder, "imu0", "last line")
        n = len(flight.imu.stamps_s)
        assert n == end.count(b"\n") - 1
        np.testing.assert_array_equal(flight.imu.gyro_rad_s, before.imu.gyro_rad_s[:n])
    assert_warned(folder, "imu0", "s are lost")
    csv.write_bytes(whole[:-300] + b"\0" * 300)
    assert len(assert_warned(folder, "imu0", "zeros").imu.stamps_s) < len(before.imu.stamps_s)
    csv.write_bytes(b"\0" * 300)
    assert_refused(folder, "imu0", "is empty")
    csv.write_bytes(whole.splitlines()[0] + b"\n")
    assert assert_warned(folder, "imu0", "no rows").imu is None


def test_truncated_last_number_is_dropped(folder):
    csv = mav(folder, "barometer0") / "data.csv"
    header = csv.read_text().splitlines()[0]
    rows = [f"{10**18 + k * 10**8},{100 + k / 1000:.4f}" for k in range(20)]
    csv.write_text("\n".join([header, *rows])[:-5])
    flight = assert_warned(folder, "barometer0", "last line")
    assert len(flight.barometer.value) == 19


def test_pictures_missing_truncated_and_of_another_size(folder):
    data = mav(folder, "cam0") / "data"
    (data / "001.png").unlink()
    (data / "002.png").write_bytes((data / "002.png").read_bytes()[:-200])
    from PIL import Image

    Image.fromarray(picture(0, (50, 50))).save(data / "003.png")
    (data / "stray.png").touch()
    flight = assert_warned(folder, "1 of 30 pictures is missing")
    assert [frame.read() is None for frame in flight.frames][:5] == [False, True, True, True, False]
    assert flight.frames.load.failures == {1: "missing", 2: "truncated", 3: "is 50 x 50 px, not 48 x 36"}
    assert_warned(folder, "cam0", "not listed")
    assert_warned(folder, "cam0", "change their size")
    for path in data.iterdir():
        path.unlink()
    assert_refused(folder, "none of the 30")


def test_pictures_of_twelve_bits_in_sixteen_are_noted_and_read_alike(folder):
    pictures = sorted((mav(folder, "cam0") / "data").glob("*.png"))
    before = [cv2.imread(str(path)) for path in pictures]
    before[1] //= 32  # a dark one stays dark beside the others
    for path, pixels in zip(pictures, before, strict=True):
        cv2.imwrite(str(path), pixels.astype(np.uint16) * 16)
    flight = assert_warned(folder, "more than 8 bits per pixel", "values 0 to 4096")
    for frame, pixels in zip(flight.frames, before, strict=True):
        np.testing.assert_array_equal(frame.read(), pixels)


def test_unknown_folders_and_misspelt_keys_are_noted(folder):
    (folder / "mav0/flow0").mkdir()
    change(mav(folder, "sonar0") / "sensor.yaml", ("noise_std", "noise_sdt"))
    assert_warned(folder, "flow0", "skipped")
    assert_warned(folder, "sonar0", "noise_sdt", "noise_std")


def test_rate_far_from_nominal_is_noted(folder):
    change(mav(folder, "imu0") / "sensor.yaml", (r"rate_hz: .*", "rate_hz: 200"))
    assert_warned(folder, "imu0", "rate is 100 Hz", "200 Hz")


def test_unreadable_file(folder):
    csv = mav(folder, "imu0") / "data.csv"
    csv.chmod(0)
    if os.access(csv, os.R_OK):
        pytest.skip("this user may read everything")
    assert_refused(folder, "cannot be read")


def test_unsafe_names_are_shown_on_one_line(folder, tmp_path):
    evil = tmp_path / "a\nb\x1b[31m"
    folder.rename(evil)
    (evil / "flight.yaml").write_text('name: "x\\ny"\nnoise: [1]\n')
    assert "\n" not in read_flight(evil).name
    change_row(evil / "mav0/sonar0/data.csv", 3, 1, "\x1b[2J")
    assert "\x1b" not in assert_refused(evil)
