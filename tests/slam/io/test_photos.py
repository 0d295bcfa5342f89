"""Folders of photographs as flights: measured ones, made ones and damaged ones."""

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
from PIL.TiffImagePlugin import IFDRational

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.geodesy import enu_from_geodetic
from slam.io.photos import import_photos
from tests.slam.io.photo_files import NADIR, SIZE, fill, jpeg, strip, with_xmp

Base, GPS = ExifTags.Base, ExifTags.GPS


def warned(flight, *words):
    """The warnings that hold all of the words."""
    return [line for line in flight.warnings if all(word in line for word in words)]


def refused(folder):
    with pytest.raises(InputError) as caught:
        import_photos(folder)
    line = str(caught.value)
    assert "\n" not in line
    assert str(folder) in line
    return line


# --- measured -------------------------------------------------------------------------------------------


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


# --- what is read ---------------------------------------------------------------------------------------


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


def test_the_gimbal_s_angles_under_pix4d_s_names(tmp_path):
    """Autel stores pitch -90 for straight down. The convention is that of the set, not of one photograph."""
    pitches = ("-90", "-88", "0", "-90")
    files = {
        f"P{k}.jpg": jpeg(camera={"Yaw": "90", "Pitch": pitch, "Roll": "0"}, time=f"2024:05:06 07:08:0{k}")
        for k, pitch in enumerate(pitches)
    }
    flight = import_photos(fill(tmp_path, files))
    assert flight.frames.names == ("P0.jpg", "P1.jpg", "P3.jpg")  # the third looks at the horizon
    assert_allclose(np.degrees(flight.attitude.roll_pitch_yaw_rad[0]), [0, 0, 0], atol=1e-9)


@pytest.mark.parametrize("as_attributes", [False, True])
def test_skydio_s_nested_angles(tmp_path, as_attributes):
    """The camera's and the vehicle's structures have members of the same names."""
    values = {
        "CameraOrientationNED": (-90, 30),
        "CameraOrientationFLU": (7, 8),
        "VehicleOrientationNED": (2, 70),
    }
    inside = ""
    for name, (pitch, yaw) in values.items():
        members = {"Roll": 0, "Pitch": pitch, "Yaw": yaw}
        if as_attributes:
            inside += f"<d:{name} " + " ".join(f'd:{k}="{v}"' for k, v in members.items()) + "/>"
        else:
            content = "".join(f"<d:{k}>{v}</d:{k}>" for k, v in members.items())
            inside += f'<d:{name} rdf:parseType="Resource">{content}</d:{name}>'
    packet = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        '<rdf:Description xmlns:d="https://www.skydio.com/drone-skydio/1.0/" d:Latitude="30.5"'
        f' d:Longitude="-98.25" d:AbsoluteAltitude="412.5">{inside}</rdf:Description></rdf:RDF></x:xmpmeta>'
    ).encode()
    flight = import_photos(fill(tmp_path, {"a.jpg": with_xmp(jpeg(), packet)}))
    assert_allclose(np.degrees(flight.attitude.roll_pitch_yaw_rad), [[0, 0, 60]], atol=1e-9)
    assert (flight.gps.latitude_deg[0], flight.gps.altitude_m[0]) == (30.5, 412.5)


def test_angles_that_are_zero_throughout_were_not_recorded(tmp_path):
    files = strip(2, camera={"Yaw": "0/100", "Pitch": "0/100", "Roll": "0/100", "GPSXYAccuracy": "0"})
    flight = import_photos(fill(tmp_path, files))
    assert flight.attitude is None
    assert warned(flight, "straight down assumed")
    assert flight.gps.noise_std_m == (5, 5, 10)


def test_airframe_angles_are_used_without_a_gimbal(tmp_path):
    drone = {"FlightYawDegree": "90", "FlightPitchDegree": "3", "FlightRollDegree": "-2"}
    flight = import_photos(fill(tmp_path, {"a.jpg": jpeg(drone=drone)}))
    assert_allclose(np.degrees(flight.attitude.roll_pitch_yaw_rad), [[-2, -3, 0]], atol=1e-9)
    assert_allclose(np.degrees(flight.attitude.noise_std_rad), [5, 5, 10])


def test_attitude_of_some_photographs_only(tmp_path):
    files = strip(3) | {"P1.jpg": jpeg(drone=NADIR, time="2024:05:06 07:08:02")}
    flight = import_photos(fill(tmp_path, files))
    assert flight.attitude.stamps_s.tolist() == [2]
    assert warned(flight, "2 photographs without it")


# --- time -----------------------------------------------------------------------------------------------


def test_fractions_and_zone_of_the_time(tmp_path):
    tags = {Base.SubsecTimeOriginal: "25", Base.OffsetTimeOriginal: "+02:00"}
    files = {"a.jpg": jpeg(tags=tags), "b.jpg": jpeg(tags=tags | {Base.SubsecTimeOriginal: "750"})}
    flight = import_photos(fill(tmp_path, files))
    assert flight.epoch_ns == (1714979289 - 7200) * 10**9 + 250_000_000
    assert flight.frames.stamps_s.tolist() == [0, 0.5]
    assert not warned(flight, "time zone")


def test_one_zone_missing_puts_all_on_the_camera_clock(tmp_path):
    files = strip(2) | {"P0.jpg": jpeg(time="2024:05:06 07:08:00", tags={Base.OffsetTimeOriginal: "+02:00"})}
    flight = import_photos(fill(tmp_path, files))
    assert flight.frames.stamps_s.tolist() == [0, 2]
    assert warned(flight, "time zone unknown")


def test_time_orders_the_photographs_not_their_names(tmp_path):
    files = {"a.jpg": jpeg(time="2024:05:06 07:08:09"), "b.jpg": jpeg(time="2024:05:06 07:08:01")}
    assert import_photos(fill(tmp_path, files)).frames.names == ("b.jpg", "a.jpg")


def test_equal_stamps_are_spread_in_order_of_the_names(tmp_path):
    seconds = {"P9": 0, "P10": 0, "P11": 0, "P12": 1, "P13": 5, "P14": 5}
    files = {f"{n}.jpg": jpeg(time=f"2024:05:06 07:08:0{s}") for n, s in seconds.items()}
    flight = import_photos(fill(tmp_path, files))
    assert [name.removesuffix(".jpg") for name in flight.frames.names] == list(seconds)
    assert_allclose(flight.frames.stamps_s, [0, 1 / 3, 2 / 3, 1, 5, 5.5], atol=1e-8)
    assert warned(flight, "3 equal time stamps")


def test_satellite_time_where_the_camera_has_none(tmp_path):
    def when(s):
        return {GPS.GPSDateStamp: "2024:05:06", GPS.GPSTimeStamp: tuple(IFDRational(v) for v in (7, 8, s))}

    files = {"a.jpg": jpeg(time=None, gps=when(4)), "b.jpg": jpeg(time=None, gps=when(1))}
    flight = import_photos(fill(tmp_path, files))
    assert flight.frames.names == ("b.jpg", "a.jpg")
    assert flight.epoch_ns == 1714979281 * 10**9
    assert warned(flight, "satellites")


@pytest.mark.parametrize(
    "time",
    [
        None,
        "0000:00:00 00:00:00",
        "2024:05:06 07:08:09",
        "yesterday",
        "9024:05:06 07:08:09",
        "2024:13:40 99:00:00",
    ],
)
def test_without_times_the_names_give_the_order(tmp_path, time):
    files = {f"DJI_{k}.jpg": jpeg(time=time) for k in (9, 10, 100, 1)}
    flight = import_photos(fill(tmp_path, files))
    assert flight.frames.names == ("DJI_1.jpg", "DJI_9.jpg", "DJI_10.jpg", "DJI_100.jpg")
    assert flight.frames.stamps_s.tolist() == [0, 1, 2, 3]
    assert warned(flight, "order of the names, 1 s apart")
    assert "date" not in flight.notes


# --- what is missing or left out ------------------------------------------------------------------------


def test_flight_without_gps_is_valid(tmp_path):
    flight = import_photos(fill(tmp_path, strip(2, place=None)))
    assert flight.gps is None
    assert len(flight.frames) == 2
    assert warned(flight, "no metric scale")


def test_gps_of_some_photographs_only(tmp_path):
    files = strip(4) | {
        "P1.jpg": jpeg(place=None, time="2024:05:06 07:08:02"),
        "P2.jpg": jpeg(place=(0.0, 0.0), time="2024:05:06 07:08:04"),
        "P3.jpg": jpeg(altitude=None, time="2024:05:06 07:08:06"),
    }
    flight = import_photos(fill(tmp_path, files))
    assert flight.gps.stamps_s.tolist() == [0, 6]
    assert np.isnan(flight.gps.altitude_m).tolist() == [False, True]
    assert warned(flight, "2 of 4 photographs have no GPS position")
    assert warned(flight, "1 of 2 GPS positions have no altitude")


@pytest.mark.parametrize(
    "gps",
    [
        {GPS.GPSStatus: "V"},
        {GPS.GPSLatitudeRef: ""},
        {GPS.GPSLatitude: (IFDRational(91), IFDRational(0), IFDRational(0))},
        {GPS.GPSLatitude: (IFDRational(0, 0), IFDRational(0), IFDRational(0))},
        {GPS.GPSLongitude: (IFDRational(1), IFDRational(0))},
    ],
)
def test_invalid_positions_are_ignored(tmp_path, gps):
    assert import_photos(fill(tmp_path, {"a.jpg": jpeg(gps=gps)})).gps is None


def test_photographs_that_do_not_look_down_are_left_out(tmp_path):
    files = {
        f"{-p}.jpg": jpeg(drone=NADIR | {"GimbalPitchDegree": str(p)}) for p in (-90, -75, -61, -59, -45, 0)
    }
    flight = import_photos(fill(tmp_path, files))
    assert set(flight.frames.names) == {"90.jpg", "75.jpg", "61.jpg"}
    assert warned(flight, "3 of 6 photographs left out", "straight down", "0.jpg, 45.jpg, 59.jpg")


def test_photographs_of_another_camera_are_left_out_by_name(tmp_path):
    files = strip(3) | {
        "x.jpg": jpeg(model="Phone"),
        "y.jpg": jpeg(size=(48, 64)),
        "z.jpg": jpeg(tags={Base.FocalLength: IFDRational(9)}),
    }
    flight = import_photos(fill(tmp_path, files))
    assert flight.frames.names == ("P0.jpg", "P1.jpg", "P2.jpg")
    assert warned(flight, "another camera than the Mapper 1", "x.jpg")
    assert warned(flight, "another size than the 64 x 48", "y.jpg")
    assert warned(flight, "another focal length", "z.jpg")


def test_damaged_files_are_counted_and_named(tmp_path):
    whole = jpeg()
    files = strip(2) | {
        "cut.jpg": whole[: len(whole) // 2],
        "zeroed.jpg": whole[: len(whole) // 2] + bytes(len(whole) // 2),
        "empty.jpg": b"",
        "text.jpg": b"not a picture",
        "cut.png": jpeg(container="PNG")[:3000],
        "cut.tif": jpeg(container="TIFF")[:-3000],
    }
    fill(tmp_path, files)
    os.mkfifo(tmp_path / "pipe.jpg")
    (tmp_path / "line\nbreak.jpg").write_bytes(whole)
    (tmp_path / "dangling.jpg").symlink_to("nowhere.jpg")
    flight = import_photos(tmp_path)
    assert flight.frames.names == ("P0.jpg", "P1.jpg")
    assert warned(flight, "empty file", "empty.jpg")
    lost = " ".join(warned(flight, "left out"))
    assert all(name in lost for name in [*(set(files) - {"P0.jpg", "P1.jpg"}), "pipe.jpg", "dangling.jpg"])
    assert not any("\n" in line for line in flight.warnings)


def test_names_in_a_long_list_are_counted(tmp_path):
    flight = import_photos(fill(tmp_path, strip(1) | {f"e{k}.jpg": b"" for k in range(9)}))
    assert warned(
        flight, "9 of 10 photographs left out: empty file (e0.jpg, e1.jpg, e2.jpg, e3.jpg, e4.jpg and 4 more)"
    )


def test_damaged_xmp_is_noted(tmp_path):
    bomb = b'<!DOCTYPE a [<!ENTITY b "c"><!ENTITY d "&b;&b;">]><a>&d;</a>'
    for packet in (b"<x:xmpmeta><broken", bomb):
        flight = import_photos(fill(tmp_path, {"a.jpg": with_xmp(jpeg(), packet)}))
        assert warned(flight, "1 photographs have XMP tags that cannot be read")


# --- refused --------------------------------------------------------------------------------------------


def test_refusals(tmp_path):
    assert "no such folder" in refused(tmp_path / "nowhere")
    assert "no photographs" in refused(fill(tmp_path / "none", {"readme.txt": b""}))
    assert "no photographs" in refused(fill(tmp_path / "empty", {}))
    fill(tmp_path, {"photos.zip": b"PK"})
    assert "unpack" in refused(tmp_path / "photos.zip")
    assert "empty file (a.jpg)" in refused(fill(tmp_path / "bad", {"a.jpg": b""}))
    oblique = strip(2, drone=NADIR | {"GimbalPitchDegree": "-10"})
    assert "straight down" in refused(fill(tmp_path / "oblique", oblique))


@pytest.mark.parametrize("seed", range(4))
def test_mutated_photographs_give_a_flight_or_a_refusal(tmp_path, seed):
    """Flipped bytes and cuts, most of them among the tags, 50 for each seed."""
    rng = np.random.default_rng(seed)
    drone = NADIR | {
        "AbsoluteAltitude": "+10",
        "DewarpData": "2020-01-01;60,60,0,0,0,0,0,0,0",
        "RelativeAltitude": "+1",
    }
    tags = {
        Base.SubsecTimeOriginal: "12",
        Base.OffsetTimeOriginal: "+01:00",
        Base.FocalLength: IFDRational(9, 2),
        Base.FocalPlaneXResolution: IFDRational(10**6, 61),
        Base.FocalPlaneResolutionUnit: 2,
        Base.FocalLengthIn35mmFilm: 25,
        Base.ExifImageWidth: 64,
        Base.ExifImageHeight: 48,
    }
    original = jpeg(drone=drone, tags=tags, gps={GPS.GPSDateStamp: "2024:05:06"}, container="JPEG")
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
                warnings.simplefilter("ignore")  # Pillow tells of the damaged tags once more
                picture = flight.frames.load(0)
            assert picture is None or picture.shape[:2] == flight.camera.size_px[::-1]
            outcomes["flight"] += 1
    assert min(outcomes.values()) > 0
