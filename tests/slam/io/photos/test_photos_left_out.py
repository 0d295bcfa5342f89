"""Photographs that lack tags, look elsewhere, are of another camera or damaged."""

import os
import re

import numpy as np
import pytest
from PIL import ExifTags
from PIL.TiffImagePlugin import IFDRational

from slam.io.photos.import_photos import import_photos
from tests.slam.io.photos.photo_files import NADIR, SIZE, fill, jpeg, strip, warned, with_xmp

Base, GPS = ExifTags.Base, ExifTags.GPS


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
    assert warned(flight, "1 of 2 GPS positions has no altitude")


@pytest.mark.parametrize("place", [None, (30.0, -98.0)])
def test_each_line_says_what_follows_or_what_to_do(place, tmp_path):
    other = {"wide.jpg": jpeg(size=(80, 48), place=None, time="2024:05:06 07:09:02")}
    lines = import_photos(fill(tmp_path, strip(3, place=place) | other)).warnings
    assert len(lines) == 5
    told = re.compile(r"[;:] (copy|if it is better|map them|the map|use|give)\b")
    assert [line for line in lines if not told.search(line)] == []


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


@pytest.mark.parametrize("film_mm", [24, 150])
def test_photographs_are_left_out_that_show_little_useful_ground(tmp_path, film_mm):
    """Oblique ones stay. At 70 degrees, where ground is five times as coarse, half is useful."""
    pitches = (-90, -60, -45, -30, -24, -18, 0, 10)
    files = {
        f"{10 - pitch}.jpg": jpeg(
            drone=NADIR | {"GimbalPitchDegree": str(pitch)},
            tags={Base.FocalLengthIn35mmFilm: film_mm},
            seed=k,
        )
        for k, pitch in enumerate(pitches)
    }
    flight = import_photos(fill(tmp_path, files))
    assert set(flight.frames.names) == {f"{10 - pitch}.jpg" for pitch in pitches if pitch < -20}
    assert warned(flight, "3 of 8 photographs left out: less than half", "0.jpg, 10.jpg, 28.jpg")


def test_the_noise_of_angles_grows_with_the_tilt(tmp_path):
    """At 60 degrees a turn of 2 degrees about the optical axis is a roll of 2 tan 60 and a heading of 4."""
    drone = NADIR | {"GimbalPitchDegree": "-30"}
    flight = import_photos(fill(tmp_path, strip(3, drone=drone)))
    assert np.degrees(flight.attitude.noise_std_rad) == pytest.approx((2 * np.sqrt(3), 2, 5))
    assert warned(flight, "assumed to be good to 3.5 degrees and the heading to 5")
    assert np.degrees(flight.attitude.roll_pitch_yaw_rad) == pytest.approx(np.array([[0, -60, 90]] * 3))


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


@pytest.mark.parametrize(
    ("tags", "drone"),
    [
        ({Base.FocalLengthIn35mmFilm: 36}, {}),
        ({Base.DigitalZoomRatio: IFDRational(15, 10)}, {}),
        ({Base.FocalLengthIn35mmFilm: 24}, {"CalibratedFocalLength": "90"}),
    ],
)
def test_photographs_of_another_zoom_are_left_out(tmp_path, tags, drone):
    own = {Base.FocalLength: IFDRational(88, 10), Base.FocalLengthIn35mmFilm: 24}
    files = strip(3, tags=own, drone={"CalibratedFocalLength": "60"}) | {
        "bare.jpg": jpeg(tags=own | {Base.DigitalZoomRatio: IFDRational(0)}),
        "z.jpg": jpeg(tags=own | tags, drone=drone),
    }
    flight = import_photos(fill(tmp_path, files))
    assert set(flight.frames.names) == {"P0.jpg", "P1.jpg", "P2.jpg", "bare.jpg"}
    assert warned(flight, "1 of 5 photographs", "another zoom, 1.5 times the focal length", "map them alone")


def test_rounded_focal_lengths_are_one_zoom(tmp_path):
    files = strip(2, tags={Base.FocalLengthIn35mmFilm: 50}) | {
        "a.jpg": jpeg(tags={Base.FocalLengthIn35mmFilm: 51})
    }
    assert len(import_photos(fill(tmp_path, files)).frames.names) == 3


@pytest.mark.parametrize("films_mm", [(48, 24), (24, 48)])
def test_of_two_lenses_with_equally_many_photographs_the_wide_one_is_used(tmp_path, films_mm):
    sizes = {24: (64, 48), 48: (80, 60)}  # those with more pixels, but less overlap, are the narrow ones
    files = {
        f"{'ab'[i]}{k}.jpg": jpeg(
            size=sizes[film],
            tags={Base.FocalLengthIn35mmFilm: film},
            time=f"2024:05:06 07:08:{2 * k + i:02d}",
        )
        for i, film in enumerate(films_mm)
        for k in range(3)
    }
    flight = import_photos(fill(tmp_path, files))
    assert flight.camera.size_px == sizes[24]
    assert warned(flight, "3 of 6 photographs left out", "another size than the 64 x 48 px of the ones")


def test_of_equal_lenses_the_larger_pictures_are_used(tmp_path):
    files = {
        f"{name}{k}.jpg": jpeg(size=size) for name, size in (("a", (32, 24)), ("b", SIZE)) for k in range(2)
    }
    assert import_photos(fill(tmp_path, files)).camera.size_px == SIZE


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
        assert warned(flight, "1 photograph has XMP tags that cannot be read")


def test_copies_under_other_names_are_left_out(tmp_path):
    files = strip(3)
    files |= {"P1 (1).jpg": files["P1.jpg"], "e1.jpg": b"", "e2.jpg": b""}
    flight = import_photos(fill(tmp_path, files))
    assert flight.frames.names == ("P0.jpg", "P1.jpg", "P2.jpg")
    assert warned(flight, "1 of 6 photographs left out: the same file as another photograph (P1 (1).jpg)")
    assert warned(flight, "2 of 6 photographs left out: empty file")


@pytest.mark.parametrize(
    ("changed", "is_copy"),
    [
        ({}, True),
        ({"time": "2024:05:06 07:08:03"}, False),
        ({"place": (30.000101, -98.0)}, False),
        ({"drone": NADIR | {"GimbalYawDegree": "+1.00"}}, False),
        ({"drone": None}, False),
        ({"tags": {Base.FocalLength: IFDRational(9)}}, False),
    ],
)
def test_a_photograph_that_was_saved_again_is_a_copy_by_time_place_and_angles(tmp_path, changed, is_copy):
    """Without angles, a receiver that repeats its place makes two photographs of one second look the same."""
    files = strip(3, drone=NADIR)
    same = {"time": "2024:05:06 07:08:02", "place": (30.0001, -98.0), "drone": NADIR, "seed": 9}
    plain = np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)  # a smaller file than that of noise
    files["web.jpg"] = jpeg(**(same | {"pixels": plain} | changed))
    flight = import_photos(fill(tmp_path, files))
    assert bool(warned(flight, "1 of 4 photographs left out: time, place and angles", "(web.jpg)")) == is_copy
    assert len(flight.frames) == 3 + (not is_copy and not changed.get("tags"))
