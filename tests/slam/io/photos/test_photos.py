"""Folders of photographs as flights: what is read, and folders that are refused."""

import io
import os
import pickle
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import ExifTags, Image

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.geodesy import enu_from_geodetic
from slam.io.photos.import_photos import import_photos
from tests.fuzz.photographs import photograph
from tests.slam.io.photos.photo_files import NADIR, SIZE, fill, jpeg, strip, warned

Base, GPS = ExifTags.Base, ExifTags.GPS


def refused(folder):
    with pytest.raises(InputError) as caught:
        import_photos(folder)
    line = str(caught.value)
    assert "\n" not in line
    assert str(folder) in line
    return line


@pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA names no folder of measured data")
def test_caliterra():
    flight = import_photos(Path(os.environ["SLAM_DATA"]) / "photos" / "caliterra")
    assert flight.camera.focal_px == pytest.approx((1452, 1452), abs=2)
    assert (len(flight.frames), flight.frames.names[0]) == (75, "IMG_9354.jpg")
    assert np.all(np.diff(flight.frames.stamps_s) > 0)
    assert flight.frames.stamps_s[-1] == pytest.approx(160, abs=2)
    assert flight.gps.altitude_m.min() == pytest.approx(317.3)
    assert flight.gps.altitude_m.max() == pytest.approx(431.4)
    assert_allclose(
        [flight.gps.latitude_deg.min(), flight.gps.latitude_deg.max()], [30.17058, 30.17185], atol=1e-5
    )
    assert_allclose(
        [flight.gps.longitude_deg.min(), flight.gps.longitude_deg.max()], [-98.09026, -98.08919], atol=1e-5
    )
    w_p = enu_from_geodetic(
        flight.gps.latitude_deg, flight.gps.longitude_deg, flight.gps.altitude_m, flight.geo_origin()
    )
    assert_allclose(np.ptp(w_p, axis=0), [103, 141, 114.1], atol=2)
    assert flight.attitude is None
    assert warned(flight, "straight down assumed")
    assert flight.notes == {"vehicle": "Canon PowerShot SX260 HS", "date": "2014-10-19"}
    assert flight.frames.load(0).shape == (1500, 2000, 3)


def test_a_strip_of_photographs(tmp_path):
    calls = []
    flight = import_photos(fill(tmp_path, strip(3)), lambda *call: calls.append(call))
    assert flight.all_keyframes
    assert flight.frames.names == ("P0.jpg", "P1.jpg", "P2.jpg")
    assert flight.frames.stamps_s.tolist() == [0, 2, 4]
    assert flight.epoch_ns == 1714979280 * 10**9  # 2024-05-06 07:08 as UTC
    assert_allclose(flight.gps.latitude_deg, [30, 30.0001, 30.0002], atol=1e-9)
    assert_allclose(flight.gps.longitude_deg, -98, atol=1e-9)
    assert_allclose(flight.gps.altitude_m, 320.5)
    assert flight.camera.size_px == SIZE
    assert calls[-1] == ("tags", 3, 3)
    assert np.array_equal(flight.frames.load(1), cv2.imread(str(tmp_path / "P1.jpg"), cv2.IMREAD_COLOR))
    assert pickle.loads(pickle.dumps(flight.frames)).load(1).shape == (48, 64, 3)


def test_southern_and_western_places_and_heights_below_the_sea(tmp_path):
    files = {
        "a.jpg": jpeg(place=(-33.86, 151.21), altitude=-27.5),
        "b.jpg": jpeg(place=(51.5, -0.12), time=None),
    }
    gps = import_photos(fill(tmp_path, files)).gps
    assert_allclose(gps.latitude_deg, [-33.86, 51.5], atol=1e-9)
    assert_allclose(gps.longitude_deg, [151.21, -0.12], atol=1e-9)
    assert_allclose(gps.altitude_m, [-27.5, 320.5])


@pytest.mark.parametrize("suffix", ["JPG", "jpeg", "png", "tif", "TIFF"])
def test_other_containers(tmp_path, suffix):
    container = {"png": "PNG", "tif": "TIFF"}.get(suffix.lower().replace("tiff", "tif"), "JPEG")
    flight = import_photos(fill(tmp_path, {f"a.{suffix}": jpeg(container=container), "notes.txt": b"x"}))
    assert flight.frames.names == (f"a.{suffix}",)
    assert flight.gps.latitude_deg[0] == pytest.approx(30.1705, abs=1e-8)
    assert flight.frames.load(0).shape == (48, 64, 3)


def test_orientation_does_not_turn_the_pixels(tmp_path):
    plain, turned = jpeg(), jpeg(tags={})
    image = ExifTags.Base.Orientation
    flight = import_photos(fill(tmp_path, {"a.jpg": turned, "b.jpg": _with_orientation(plain, image)}))
    assert flight.camera.size_px == SIZE
    assert flight.frames.load(0).shape == flight.frames.load(1).shape == (48, 64, 3)
    (line,) = warned(flight, "Exif orientation")
    assert line.startswith("1 photograph has an Exif orientation")


def _with_orientation(data, tag):
    with Image.open(io.BytesIO(data)) as image:
        exif = image.getexif()
        exif[tag] = 6
        out = io.BytesIO()
        image.save(out, "JPEG", exif=exif)
    return out.getvalue()


@pytest.mark.parametrize("elements", [False, True])
def test_dji_tags_are_preferred_to_exif(tmp_path, elements):
    drone = NADIR | {
        "GpsLatitude": "+30.500000001",
        "GpsLongtitude": "-98.25",
        "AbsoluteAltitude": "+412.34",
        "RelativeAltitude": "+62.50",
        "GimbalYawDegree": "+30.0",
        "RtkStdLon": "0.011",
        "RtkStdLat": "0.012",
        "RtkStdHgt": "0.025",
        "CalibratedFocalLength": "60.0",
    }
    flight = import_photos(fill(tmp_path, {"a.jpg": jpeg(drone=drone, elements=elements)}))
    assert flight.gps.latitude_deg[0] == 30.500000001
    assert flight.gps.longitude_deg[0] == -98.25
    assert flight.gps.altitude_m[0] == 412.34
    assert flight.gps.noise_std_m == pytest.approx((0.011, 0.012, 0.025))
    assert flight.barometer.value.tolist() == [62.5]
    assert flight.camera.focal_px == (60, 60)
    assert_allclose(np.degrees(flight.attitude.roll_pitch_yaw_rad), [[0, 0, 60]], atol=1e-9)
    assert_allclose(np.degrees(flight.attitude.noise_std_rad), [2, 2, 5])
    assert warned(flight, "Exif's differs by up to 92 m")


def test_pix4d_tags(tmp_path):
    camera = {"Yaw": "-90", "Pitch": "500/100", "Roll": "0", "GPSXYAccuracy": "1.5", "GPSZAccuracy": "2.5"}
    flight = import_photos(fill(tmp_path, {"a.jpg": jpeg(camera=camera)}))
    assert_allclose(np.degrees(flight.attitude.roll_pitch_yaw_rad), [[0, -5, 180]], atol=1e-9)
    assert flight.gps.noise_std_m == pytest.approx((1.5, 1.5, 2.5))


def test_refusals(tmp_path):
    assert "no such folder" in refused(tmp_path / "nowhere")
    assert "no photographs" in refused(fill(tmp_path / "none", {"readme.txt": b""}))
    assert "no photographs" in refused(fill(tmp_path / "empty", {}))
    fill(tmp_path, {"photos.zip": b"PK"})
    assert "unpack" in refused(tmp_path / "photos.zip")
    assert "empty file (a.jpg)" in refused(fill(tmp_path / "bad", {"a.jpg": b""}))
    oblique = strip(2, drone=NADIR | {"GimbalPitchDegree": "-5"})
    assert "up to the horizon, is too coarse" in refused(fill(tmp_path / "oblique", oblique))


@pytest.mark.parametrize("seed", range(4))
def test_mutated_photographs_give_a_flight_or_a_refusal(tmp_path, seed):
    """Flipped bytes and cuts, most of them among the tags, 50 for each seed."""
    rng = np.random.default_rng(seed)
    original = photograph("JPEG")
    head = original.index(b"\xff\xdb")  # the tables follow the tags
    outcomes = {"flight": 0, "refused": 0}
    path = tmp_path / "a.jpg"
    for _ in range(50):
        data = bytearray(original)
        for at in rng.integers(2, head if rng.random() < 0.8 else len(data), rng.integers(1, 8)):
            data[at] = rng.integers(256)
        path.write_bytes(data[: rng.integers(len(data))] if rng.random() < 0.15 else data)
        try:
            flight = import_photos(tmp_path)
        except InputError:
            outcomes["refused"] += 1
        else:
            assert isinstance(flight, Flight)
            assert np.all(np.isfinite(flight.camera.matrix))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # Pillow warns of the damaged tags again
                picture = flight.frames.load(0)
            assert picture is None or picture.shape[:2] == flight.camera.size_px[::-1]
            outcomes["flight"] += 1
    assert min(outcomes.values()) > 0


def test_control_points_in_the_folder_are_read(tmp_path):
    photos = fill(tmp_path / "set", strip())
    flight = import_photos(photos)
    lat, lon = flight.gps.latitude_deg[0], flight.gps.longitude_deg[0]
    rows = [f"{lon} {lat} 400.0 {10 + k} 20 {name} gate" for k, name in enumerate(flight.frames.names)]
    (photos / "gcp_list.txt").write_text("\n".join(["EPSG:4326", *rows, f"{lon} {lat} 1 1 1 no.jpg x"]))
    again = import_photos(photos)
    (point,) = again.surveyed
    assert (point.name, len(point.views)) == ("gate", len(rows))
    assert warned(again, "gcp_list.txt, line 5", "no.jpg")
    assert flight.surveyed == ()


@pytest.mark.parametrize("of_exif", [False, True])
def test_two_cameras_of_one_model_are_told_by_their_serial_numbers(tmp_path, of_exif):
    numbers = ["1ZN", "1ZN", "2AB"]
    tag = ExifTags.Base.BodySerialNumber
    files = {
        f"P{k}.jpg": jpeg(tags={tag: number}, seed=k)
        if of_exif
        else jpeg(drone={"DroneSerialNumber": number}, seed=k)
        for k, number in enumerate(numbers)
    }
    assert warned(
        import_photos(fill(tmp_path / "both", files)), "2 cameras of one model", "2 of 1ZN, 1 of 2AB"
    )
    del files["P2.jpg"]
    assert not warned(import_photos(fill(tmp_path / "one", files)), "cameras of one model")
