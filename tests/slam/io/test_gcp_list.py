"""The list of control points: what is read, and what is refused or named."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.control_points import PictureView
from slam.core.surveyed_flight import with_surveyed
from tests.slam.io.made_gcp_list import ROWS, UTM, flight, read, refused


def test_points_and_their_views_are_read(tmp_path):
    (north, south), notes = read(tmp_path, ["# survey", *UTM, "", *ROWS])
    assert not notes
    assert (north.name, north.role, south.name, south.role) == ("north", "control", "south", "check")
    assert north.views == (
        PictureView("DJI_0010.JPG", 100.5, 200.0), PictureView("sub/DJI_0020.JPG", 300.0, 210.0),
    )  # fmt: skip
    assert north.altitude_m == 402.5


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (", ", "."), (";", "."), ("; ", ","), ("\t", "."), ("\t", ",")]
)
def test_fields_are_divided_as_tables_are(tmp_path, separator, decimal):
    told = [row.rsplit(" check", 1)[0].split() for row in ROWS]
    rows = [separator.join([*(x.replace(".", decimal) for x in of[:5]), *of[5:]]) for of in told]
    titles = separator.join(("geo_x", "geo_y", "geo_z", "im_x", "im_y", "image_name", "gcp_name"))
    points, notes = read(tmp_path, [*UTM, titles, *rows])
    expected, _ = read(tmp_path, [*UTM, *(" ".join(of) for of in told)])
    assert points == expected
    assert not notes


def test_degrees_are_longitude_first_and_points_without_a_name_have_numbers(tmp_path):
    rows = [f"8.536 47.403 NaN {u} 20 DJI_00{u}.JPG" for u in (10, 30)]
    ((point,), _) = read(tmp_path, ["EPSG:4326", *rows, "8.537 47.403 3 1 1 DJI_0010.JPG"][:3])
    assert (point.name, point.latitude_deg, point.longitude_deg) == ("GCP 1", 47.403, 8.536)
    assert np.isnan(point.altitude_m)
    assert len(point.views) == 2


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([], ["is empty"]),
        (["EPSG:32632"], ["line 1", "no point"]),
        (["EPSG:999999", *ROWS], ["line 1", "'EPSG:999999'", "EPSG:32632"]),
        (["Gauss-Krueger", *ROWS], ["line 1", "no coordinate system that is known"]),
        (["WGS84 UTM 61N", *ROWS], ["line 1", "no coordinate system that is known"]),
        (ROWS, ["line 1", "a point in its first line", "EPSG:32632"]),
        ([ROWS[0].replace(" ", ",")], ["line 1", "a point in its first line"]),
        ([*UTM, ROWS[0], "465005.0 5249995.0 402.5 100"], ["line 3", "4 fields", "x y z u v picture"]),
        ([*UTM, ROWS[0].replace("100.5", "left")], ["line 2", "'left' where a number is needed"]),
        ([*UTM, ROWS[0].replace("100.5", "nan")], ["line 2", "'nan' where a number is needed"]),
        ([*UTM, ROWS[0].replace("100.5", "1700")], ["line 2", "1700 200", "1600 x 1300 px", "DJI_0010.JPG"]),
        ([*UTM, ROWS[0].replace(" 200 ", " -1 ")], ["line 2", "100.5 -1", "1600 x 1300 px"]),
        ([*UTM, ROWS[0].replace("DJI_0010", "IMG_1")], ["line 2", "'IMG_1.JPG'", "no picture of the flight"]),
        (["EPSG:4326", "47.403 8.536 400 1 1 DJI_0010.JPG"], ["swapped", "longitude before the latitude"]),
        ([*UTM, "5249995.0 465005.0 402.5 1 1 DJI_0010.JPG"], ["swapped", "easting before the northing"]),
        (["EPSG:32633", *ROWS], ["km or more from the pictures", "coordinate system"]),
        (["EPSG:5806", *ROWS], ["line 1", "EPSG:5806"]),
        (["EPSG:5800", *ROWS], ["line 1", "EPSG:5800", "of one site"]),
        (["EPSG:5703", *ROWS], ["line 1", "EPSG:5703", "a system of heights"]),
        (["EPSG:32632+5715", *ROWS], ["line 1", "EPSG:32632+5715", "depths, positive downwards"]),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(tmp_path, lines, words):
    message = refused(tmp_path, lines)
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("more", "name", "fault"),
    [
        (
            "465005.0 5249996.0 402.5 9 9 DJI_0030.JPG north",
            "north",
            "lines 2 and 5 give it different coordinates",
        ),
        ("465005.0 5249995.0 402.5 9 9 DJI_0030.JPG pole", "pole", "one place has 2 names (north, pole)"),
        (
            "465005.0 5249995.0 402.5 9 9 DJI_0010.JPG north",
            "north",
            "one picture shows it at two places (DJI_0010.JPG)",
        ),
        ("475005.0 5249995.0 402.5 9 9 DJI_0030.JPG far", "far", "it lies 10 km from the pictures"),
    ],
)
def test_points_that_contradict_themselves_are_named_and_left_out(tmp_path, more, name, fault):
    points, _ = read(tmp_path, [*UTM, *ROWS, more])
    assert {p.name: p.fault for p in points if p.name == name} == {name: fault}
    assert not next(p for p in points if p.name == "south").fault
    told = with_surveyed(flight(), points)
    assert f"control point {name}: {fault}" in told.warnings
