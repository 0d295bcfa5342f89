"""Attitude of photographs from the tags of gimbal, camera and airframe."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import ExifTags
from scipy.spatial.transform import Rotation

from slam.io.gimbal import body_from_gimbal
from slam.io.photos.import_photos import import_photos
from slam.io.photos.photo_set import AttitudeSource
from tests.slam.io.photos.photo_files import NADIR, fill, jpeg, strip, warned, with_xmp

Base, GPS = ExifTags.Base, ExifTags.GPS


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


@pytest.mark.parametrize("yaw", ["nan", "45,0", "45 deg", "400"])
def test_an_attitude_that_cannot_be_read_is_told_by_name(tmp_path, yaw):
    files = {f"{k}.jpg": jpeg(drone=NADIR | {"GimbalYawDegree": yaw}, seed=k) for k in range(2)}
    flight = import_photos(fill(tmp_path, files))
    assert flight.attitude is None
    fault = f"GimbalYawDegree is {yaw}, no angle in degrees"
    assert f"attitude tags not used in 2 photographs: {fault} (0.jpg, 1.jpg)" in flight.warnings
    assert warned(flight, "no attitude can be used: straight down assumed")


def test_an_attitude_of_another_source_is_used_in_place_of_one_that_cannot_be_read(tmp_path):
    airframe = {"FlightYawDegree": "30", "FlightPitchDegree": "0", "FlightRollDegree": "0"}
    files = {"a.jpg": jpeg(drone=NADIR | airframe | {"GimbalYawDegree": "nan"})}
    flight = import_photos(fill(tmp_path, files))
    assert_allclose(np.degrees(flight.attitude.roll_pitch_yaw_rad), [[0, 0, 60]], atol=1e-6)
    assert not warned(flight, "attitude tags not used")


@pytest.mark.parametrize("tilt_deg", [0.0, 60.0])
def test_a_turn_about_the_axis_of_a_picture_that_leans_is_a_roll_and_a_heading(tilt_deg):
    """By angles of many attitudes that are turned about their optical axis."""
    leaning = Rotation.from_euler("ZYX", [30, tilt_deg, 0], degrees=True)
    turns = Rotation.from_euler("Z", np.random.default_rng(0).normal(0, 0.1, (20_000, 1)), degrees=True)
    yaw, _, roll = np.std((leaning * turns).as_euler("ZYX", degrees=True), axis=0)
    source = AttitudeSource("gimbal", lambda tags: None, body_from_gimbal, (0.1, 0.1, 0.1))
    std_deg = source.at_tilts([leaning.as_matrix()]).std_deg
    assert std_deg == pytest.approx((max(roll, 0.1), 0.1, yaw), rel=0.03)
