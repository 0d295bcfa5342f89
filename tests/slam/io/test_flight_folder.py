"""Flight folders: what is written comes back as it was."""

import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.messages import parsed
from slam.core.streams import (
    FIELD_BY_FOLDER,
    STREAMS,
    AttitudeSeries,
    Command,
    Frames,
    Gps,
    Imu,
    Motor,
    Scalar,
    Sonar,
    Truth,
    Velocity,
)
from slam.io.flight_folder import read_flight, write_flight
from slam.io.streams import COLUMNS
from tests.slam.io.made_flight import made_flight, ns, picture


def assert_same(a, b, tolerance=0.0):
    """Two dataclasses of arrays hold the same, NaN where NaN."""
    assert type(a) is type(b)
    for field in dataclasses.fields(a):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if x is None or y is None or isinstance(x, str):
            assert x == y, field.name
        else:
            np.testing.assert_allclose(y, x, rtol=tolerance, atol=tolerance, err_msg=field.name)


def test_every_stream_is_read_back(tmp_path):
    flight = made_flight()
    write_flight(flight, tmp_path / "f")
    back = read_flight(tmp_path / "f")
    for field in map(FIELD_BY_FOLDER.get, COLUMNS):
        exact = field not in ("truth", "gps")  # quaternions and degrees are converted on the way
        if field == "gps":
            assert_same(dataclasses.replace(flight.gps, noise_std_m=back.gps.noise_std_m), back.gps)
            np.testing.assert_allclose(back.gps.noise_std_m, flight.gps.noise_std_m, rtol=1e-12)
        else:
            assert_same(getattr(flight, field), getattr(back, field), 0.0 if exact else 1e-14)
    assert_same(flight.camera, back.camera)
    for name in ("name", "epoch_ns", "landmark_pairs", "gaps", "all_keyframes", "notes"):
        assert getattr(back, name) == getattr(flight, name), name
    assert list(back.landmarks) == list(flight.landmarks)
    assert all((back.landmarks[k] == p).all() for k, p in flight.landmarks.items())
    assert back.warnings == ()


@pytest.mark.parametrize("mount_std_rad", [None, 0.0, 0.02])
def test_uncertainties_of_a_camera_are_read_back(tmp_path, mount_std_rad):
    flight = made_flight()
    unsure = dataclasses.replace(
        flight.camera,
        focal_std_ratio=0.03,
        aspect_std_ratio=0.002,
        center_std_px=9.0,
        radial_std=0.1,
        tangential_std=0.002,
        mount_std_rad=mount_std_rad,
        readout_s=0.03,
    )
    write_flight(dataclasses.replace(flight, camera=unsure), tmp_path / "f")
    assert_same(unsure, read_flight(tmp_path / "f").camera)


def test_a_fisheye_is_read_back(tmp_path):
    flight = made_flight()
    fisheye = dataclasses.replace(flight.camera, lens="equidistant", distortion=(0.02, -0.003, 0.001, 0.0))
    write_flight(dataclasses.replace(flight, camera=fisheye), tmp_path / "f")
    assert_same(fisheye, read_flight(tmp_path / "f").camera)


def test_a_fisheye_whose_polynomial_folds_back_is_refused(tmp_path):
    flight = made_flight()
    folded = dataclasses.replace(flight.camera, lens="equidistant", distortion=(-4.0, 0.0, 0.0, 0.0))
    write_flight(dataclasses.replace(flight, camera=folded), tmp_path / "f")
    with pytest.raises(InputError, match="folds back"):
        read_flight(tmp_path / "f")


def test_pictures_are_read_back_and_stay_on_disk(tmp_path):
    flight = made_flight()
    write_flight(flight, tmp_path / "f")
    back = read_flight(tmp_path / "f")
    assert back.frames.names == flight.frames.names
    np.testing.assert_array_equal(back.frames.stamps_s, flight.frames.stamps_s)
    for there, here in zip(flight.frames, pickle.loads(pickle.dumps(back.frames)), strict=True):
        np.testing.assert_array_equal(here.read(), there.read())
    (tmp_path / "f/mav0/cam0/data/002.png").unlink()
    assert back.frames[2].read() is None
    assert back.frames.load.failures == {2: "missing"}


def test_copies_pictures_that_are_files_byte_for_byte(tmp_path):
    write_flight(made_flight(), tmp_path / "a")
    write_flight(read_flight(tmp_path / "a"), tmp_path / "b", image_format="jpg")
    for one in (tmp_path / "a/mav0/cam0/data").iterdir():
        assert (tmp_path / "b/mav0/cam0/data" / one.name).read_bytes() == one.read_bytes()


def test_writing_twice_gives_the_same_bytes(tmp_path):
    write_flight(made_flight(), tmp_path / "a")
    write_flight(read_flight(tmp_path / "a"), tmp_path / "b")
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert files == sorted(p.relative_to(tmp_path / "b") for p in (tmp_path / "b").rglob("*") if p.is_file())
    rounded = {Path("mav0/state_groundtruth_estimate0/data.csv"), Path("mav0/gps0/sensor.yaml")}
    for file in set(files) - rounded:
        assert (tmp_path / "a" / file).read_text("latin1") == (tmp_path / "b" / file).read_text("latin1"), (
            file
        )


@pytest.mark.parametrize("image_format", ["png", "jpg"])
def test_invalid_file_names_are_replaced(tmp_path, image_format):
    names = (
        "../up.png",
        "/abs.png",
        "a\nb.png",
        "same.png",
        "same.png",
        ' c,"d".PNG',
        "sub/e.png",
        "x" * 300,
        "",
    )
    frames = Frames(ns(np.arange(len(names)) * 0.1), names, lambda k: picture(k, colour=bool(k % 2)))
    flight = Flight("n", camera=made_flight().camera, frames=frames)
    write_flight(flight, tmp_path / "f", image_format=image_format)
    assert [p.name for p in tmp_path.iterdir()] == ["f"]
    back = read_flight(tmp_path / "f")
    assert len(set(back.frames.names)) == len(names)
    for k, frame in enumerate(back.frames):
        image = frame.read()
        assert image.shape == picture(k, colour=bool(k % 2)).shape
        if image_format == "png":
            np.testing.assert_array_equal(image, picture(k, colour=bool(k % 2)))
    suffix = ".png" if image_format == "png" else ".png.jpg"
    assert back.frames.names[6] == f"sub/e{suffix}"


def test_non_empty_target_is_refused(tmp_path):
    (tmp_path / "f").mkdir()
    (tmp_path / "f/mine.txt").write_text("keep")
    with pytest.raises(InputError, match="not empty"):
        write_flight(made_flight(), tmp_path / "f")
    assert [p.name for p in tmp_path.iterdir()] == ["f"]
    assert (tmp_path / "f/mine.txt").read_text() == "keep"


def test_failing_loader_leaves_no_output(tmp_path):
    def load(k):
        if k == 3:
            raise RuntimeError("camera on fire")
        return picture(k)

    flight = made_flight()
    flight = dataclasses.replace(flight, frames=dataclasses.replace(flight.frames, load=load))
    with pytest.raises(RuntimeError):
        write_flight(flight, tmp_path / "f")
    assert list(tmp_path.iterdir()) == []


def test_the_table_of_streams_is_that_of_the_format_and_of_a_flight():
    assert set(FIELD_BY_FOLDER) == {"cam0", *COLUMNS}
    flight = made_flight()
    stamped = {f.name for f in dataclasses.fields(flight) if hasattr(getattr(flight, f.name), "stamps_s")}
    assert set(STREAMS) == stamped


def test_absent_streams_are_read_back_as_absent(tmp_path):
    only = made_flight().command
    write_flight(Flight("c", command=only), tmp_path / "f")
    back = read_flight(tmp_path / "f")
    start = only.stamps_s[0]
    assert back.epoch_ns == round(start * 1e9)
    assert_same(dataclasses.replace(only, stamps_s=ns(only.stamps_s - start)), back.command)
    assert [f for f in [*STREAMS, "camera"] if getattr(back, f) is not None] == ["command"]
    assert back.geo_origin() is None


def test_photos_keep_their_pauses(tmp_path):
    stamps = ns([0.0, 2, 4, 7200, 7202, 7204, 90000])
    names = tuple(f"{k}.jpg" for k in range(7))
    frames = Frames(stamps, names, lambda k: picture(k))
    flight = Flight("p", camera=made_flight().camera, frames=frames, all_keyframes=True)
    write_flight(flight, tmp_path / "f", image_format="jpg")
    back = read_flight(tmp_path / "f")
    assert back.all_keyframes
    assert back.warnings == ()
    assert back.frames.names == names
    np.testing.assert_array_equal(back.frames.stamps_s, stamps)


# A missing value is NaN; all else in the range of the stream is to come back to the last bit.
def values(width, limit, count=st.integers(1, 12)):
    number = st.floats(-limit, limit, width=64) | st.just(float("nan"))
    return count.flatmap(lambda n: arrays(np.float64, (n, width), elements=number))


def stamps(n, seed):
    # Less than the 5 s over which gravity checks a gyro: these readings are no flight.
    return ns(np.cumsum(np.random.default_rng(seed).uniform(0.001, 0.4, n)))


SERIES = {
    "attitude": lambda v, t: AttitudeSeries(t, v[:, :3] % 3.0),
    "velocity": lambda v, t: Velocity(t, v[:, :2]),
    "command": lambda v, t: Command(t, v[:, :4] / 200),
    "battery": lambda v, t: Scalar(t, v[:, 0], 0.1),
    "motor": lambda v, t: Motor(t, v[:, :4]),
    "sonar": lambda v, t: Sonar(t, np.abs(v[:, 0]) / 100 + 1e-9),
    "imu": lambda v, t: Imu(t, np.nan_to_num(v[:, :3]) / 10, np.nan_to_num(v[:, 3:6]) / 50 + 5),
    "gps": lambda v, t: Gps(t, np.nan_to_num(v[:, 0]) * 0.44 + 1e-9, np.nan_to_num(v[:, 1]) * 0.9, v[:, 2]),
}


@pytest.mark.slow
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values(6, 200.0), st.sampled_from(sorted(SERIES)), st.integers(0, 2**32), st.integers(1, 2 * 10**18))
def test_numbers_are_read_back_to_the_last_bit(tmp_path_factory, made, field, seed, epoch_ns):
    t = stamps(len(made), seed)
    t -= t[0]
    t = ns(t)
    with np.errstate(invalid="ignore"):
        series = SERIES[field](made, t)
    path = tmp_path_factory.mktemp("p") / "f"
    write_flight(Flight("h", epoch_ns=epoch_ns, **{field: series}), path)
    back = read_flight(path)
    assert back.epoch_ns == epoch_ns
    if field == "gps":
        back = dataclasses.replace(back, gps=dataclasses.replace(back.gps, noise_std_m=series.noise_std_m))
    assert_same(series, getattr(back, field))


@given(arrays(np.float64, (7,), elements=st.floats(-50, 50)))
@settings(max_examples=15, deadline=None)
def test_truth_is_read_back(tmp_path_factory, made):
    from scipy.spatial.transform import Rotation

    w_T_b = np.eye(4)[None].repeat(2, 0)
    w_T_b[0, :3, :3] = Rotation.from_rotvec(made[:3]).as_matrix()
    w_T_b[:, :3, 3] = made[3:6]
    path = tmp_path_factory.mktemp("t") / "f"
    truth = Truth(np.array([0.0, 1.0]), w_T_b, None)
    write_flight(Flight("t", truth=truth), path)
    back = read_flight(path).truth
    assert back.w_v_m_s is None
    np.testing.assert_array_equal(back.w_T_b[:, :3, 3], w_T_b[:, :3, 3])
    np.testing.assert_allclose(back.w_T_b, w_T_b, atol=4e-16 * 50)


@settings(max_examples=20, deadline=None)
@given(
    st.dictionaries(
        st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), min_size=1, max_size=9).filter(
            lambda k: k not in ("name", "gaps", "landmark_pairs", "all_keyframes", "assumed")
        ),
        st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cn", "Co"]), min_size=1),
    ),
)
def test_any_notes_are_read_back(tmp_path_factory, notes):
    path = tmp_path_factory.mktemp("n") / "f"
    write_flight(Flight("n", battery=made_flight().battery, notes=notes), path)
    assert read_flight(path).notes == notes


def test_warnings_are_read_back_and_kept(tmp_path):
    expected = (
        "5 of 80 photographs left out: blurred (a.jpg)",
        "accuracy of the GPS: assumed",
        "# \u2028 'x': [y",
    )
    write_flight(made_flight().with_warning(*map(parsed, expected)), tmp_path / "a")
    once = read_flight(tmp_path / "a")
    assert once.warnings == (*expected[:2], "# \N{REPLACEMENT CHARACTER} 'x': [y"), (
        "hostile text stays one line"
    )
    write_flight(once, tmp_path / "b")
    assert read_flight(tmp_path / "b").warnings == once.warnings
    about = tmp_path / "b" / "flight.yaml"
    for wrong in ("assumed: all is well\n", "assumed: [[a]]\n"):
        about.write_text(wrong)
        with pytest.raises(InputError, match="line 1: assumed is not a list"):
            read_flight(tmp_path / "b")
