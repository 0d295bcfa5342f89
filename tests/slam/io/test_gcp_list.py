"""The list of control points: what is read, and what is refused or named."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rasterio.crs import CRS
from rasterio.warp import transform

from frontend.camera import Camera
from slam.cli.optimize import _joined
from slam.core.control_points import PictureView
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.geodesy import ECCENTRICITY_2
from slam.core.join_flights import join_flights
from slam.core.messages import Kind, as_message
from slam.core.streams import Frames, Gps
from slam.core.surveyed_flight import with_surveyed
from slam.io.flight_folder import read_flight, write_flight
from slam.io.gcp_list import read_gcp_list, with_own_points, without_own_points
from slam.io.photos.import_photos import import_photos
from tests.slam.io.made_flight import made_flight
from tests.slam.io.photos.photo_files import fill, jpeg

NAMES = ("DJI_0010.JPG", "sub/DJI_0020.JPG", "DJI_0030.JPG")
UTM = ["WGS84 UTM 32N"]
ROWS = [
    "465005.0 5249995.0 402.5 100.5 200 DJI_0010.JPG north",
    "465005.0 5249995.0 402.5 300 210 dji_0020 north",
    "465025.0 5250010.0 401 10 20 DJI_0010.JPG south check",
]
FAULT = "465026.0 5250010.0 401 11 20 DJI_0020.JPG south"

OSGB_BY_ESRI = (
    'PROJCS["British_National_Grid",GEOGCS["GCS_OSGB_1936",DATUM["D_OSGB_1936",'
    'SPHEROID["Airy_1830",6377563.396,299.3249646]],PRIMEM["Greenwich",0],UNIT["Degree",0.0174532925199433]],'
    'PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",49],PARAMETER["central_meridian",-2],'
    'PARAMETER["scale_factor",0.9996012717],PARAMETER["false_easting",400000],'
    'PARAMETER["false_northing",-100000],UNIT["metre",1]]'
)
"""EPSG:27700 as a .prj file has it, without codes."""


def flight() -> Flight:
    camera = Camera((1000.0, 1000.0), (799.5, 649.5), (1600, 1300))
    gps = Gps(np.arange(3.0), np.full(3, 47.4028), np.full(3, 8.5362), np.full(3, 450.0))
    return Flight(
        "photos",
        camera=camera,
        frames=Frames(np.arange(3.0), NAMES, lambda _: None),
        gps=gps,
        all_keyframes=True,
    )


def read(tmp_path, lines, of=None):
    path = tmp_path / "gcp_list.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return read_gcp_list(path, flight() if of is None else of)


def refused(tmp_path, lines, of=None) -> str:
    with pytest.raises(InputError) as error:
        read(tmp_path, lines, of)
    message = str(error.value)
    assert "\n" not in message
    assert "gcp_list.txt" in message
    return message


def test_points_and_their_views_are_read(tmp_path):
    (north, south), notes = read(tmp_path, ["# survey", *UTM, "", *ROWS])
    assert not notes
    assert (north.name, north.role, south.name, south.role) == ("north", "control", "south", "check")
    assert north.views == (
        PictureView("DJI_0010.JPG", 100.5, 200.0), PictureView("sub/DJI_0020.JPG", 300.0, 210.0),
    )  # fmt: skip
    assert north.altitude_m == 402.5


def test_the_middle_of_a_zone_is_where_its_meridian_lies(tmp_path):
    """Northing is the length of the meridian from the equator, times 0.9996 (Snyder 1987, section 8)."""
    row = "500000 5249995.0 402.5 100.5 200 DJI_0010.JPG"
    ((point,), _) = read(tmp_path, [*UTM, row], replace(flight(), gps=None))
    lat = np.radians(np.linspace(0.0, point.latitude_deg, 20001))
    radius_m = 6378137.0 * (1 - ECCENTRICITY_2) / (1 - ECCENTRICITY_2 * np.sin(lat) ** 2) ** 1.5
    assert 0.9996 * np.trapezoid(radius_m, lat) == pytest.approx(5249995.0, abs=1e-2)
    assert point.longitude_deg == pytest.approx(9.0, abs=1e-9)


@pytest.mark.parametrize(
    "header",
    [
        "EPSG:32632", "epsg:32632", "EPSG: 32632", "EPSG 32632", "32632", "EPSG:32632+5773", "WGS84 UTM 32n",
        "UTM 32N", "WGS 84 / UTM zone 32N", "+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs",
        CRS.from_epsg(32632).to_wkt(),
    ],
)  # fmt: skip
def test_one_system_has_several_names(tmp_path, header):
    (first, _), _ = read(tmp_path, [*UTM, *ROWS])
    (same, _), _ = read(tmp_path, [header, *ROWS])
    assert same.latitude_deg == pytest.approx(first.latitude_deg, abs=1e-9)
    assert same.longitude_deg == pytest.approx(first.longitude_deg, abs=1e-9)


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


def test_a_picture_may_have_blanks_in_its_name(tmp_path):
    names = ("my flight/north side 1.jpg", "b.jpg")
    of = replace(flight(), frames=Frames(np.arange(2.0), names, lambda _: None))
    rows = [f"465005.0 5249995.0 402.5 100 200 {name} gate check" for name in ("North side 1.jpg", "b.jpg")]
    ((point,), notes) = read(tmp_path, [*UTM, *rows], of)
    assert ([view.picture for view in point.views], point.name, point.role) == (list(names), "gate", "check")
    assert not notes


def test_heights_in_feet_are_read_where_the_system_has_them(tmp_path):
    (north, _), _ = read(tmp_path, ["EPSG:32632+6360", *ROWS])
    assert north.altitude_m == pytest.approx(402.5 * 1200 / 3937)


def test_heights_beside_feet_are_taken_in_metres_and_that_is_said(tmp_path):
    """EPSG:2232 is Colorado Central in US survey feet."""
    gps = Gps(np.arange(3.0), np.full(3, 39.74), np.full(3, -104.99), np.full(3, 1650.0))
    row = "3143493.31 1694931.25 {} 100.5 200 DJI_0010.JPG north"
    for header, height, said in (
        ("EPSG:2232", "5249.4", True),
        ("EPSG:2232", "NaN", False),
        ("EPSG:2232+6360", "5249.4", False),
    ):
        (point,), notes = read(tmp_path, [header, row.format(height)], replace(flight(), gps=gps))
        assert [("heights are taken in metres" in note) for note in notes] == [True] * said
        if said:
            assert point.altitude_m == 5249.4


@pytest.mark.parametrize(
    ("header", "row", "latitude_deg", "longitude_deg", "std_m"),
    [
        ("EPSG:27700", "530000 180000 50", 51.5, -0.13, 2.0),
        ("EPSG:31467", "3465000 5250000 400", 47.4, 8.54, 3.0),
        ("EPSG:25832", "465005.0 5249995.0 402.5", 47.4028, 8.5362, 0.0),
        ("EPSG:32632", "465005.0 5249995.0 402.5", 47.4028, 8.5362, 0.0),
        ("EPSG:2232+6360", "3143493.31 1694931.25 5249", 39.74, -104.99, 0.0),
        ("+proj=tmerc +lon_0=9 +x_0=3500000 +datum=potsdam", "3465000 5250000 400", 47.4, 8.54, 3.0),
        (OSGB_BY_ESRI, "530000 180000 50", 51.5, -0.13, 2.0),
        ("+proj=utm +zone=32 +datum=WGS84", "465005.0 5249995.0 402.5", 47.4028, 8.5362, 0.0),
        ("+proj=utm +zone=32 +ellps=GRS80", "465005.0 5249995.0 402.5", 47.4028, 8.5362, 0.0),
        ("+proj=utm +zone=32 +ellps=GRS80 +towgs84=0,0,0", "465005 5249995 402", 47.4028, 8.5362, 0.0),
    ],
)
def test_the_accuracy_of_the_transformation_of_a_datum(
    tmp_path, header, row, latitude_deg, longitude_deg, std_m
):
    """Accuracies by EPSG's database: OSGB36 to WGS 84 (6), DHDN to WGS 84 (2)."""
    gps = Gps(np.arange(3.0), np.full(3, latitude_deg), np.full(3, longitude_deg), np.full(3, 450.0))
    (point,), notes = read(tmp_path, [header, f"{row} 10 20 DJI_0010.JPG north"], replace(flight(), gps=gps))
    assert point.datum_std_m == std_m
    assert [f"good to {std_m:g} m" in str(note) for note in notes] == [True] * (std_m > 0)


@pytest.mark.parametrize(
    "datum", ["+ellps=bessel", "+ellps=bessel +towgs84=598.1,73.7,418.2,0.2,0.045,-2.455,6.7"]
)
def test_a_transformation_of_unknown_accuracy_is_told(tmp_path, datum):
    """An ellipsoid without a datum, and parameters that the list itself states."""
    gps = Gps(np.arange(3.0), np.full(3, 47.4), np.full(3, 8.54), np.full(3, 450.0))
    header = f"+proj=tmerc +lon_0=9 +x_0=3500000 {datum}"
    row = "3465000 5250000 400 10 20 DJI_0010.JPG north"
    _, (note,) = read(tmp_path, [header, row], replace(flight(), gps=gps))
    assert "of unknown accuracy" in str(note)
    assert as_message(note).kind is Kind.WARNING


@pytest.mark.parametrize(
    ("header", "system"),
    [
        ("EPSG:32632", ""),
        ("WGS84 UTM 32N", ""),
        ("EPSG:25832+5783", "EPSG:5783"),
        ("EPSG:32632+6360", "EPSG:6360"),
    ],
)
def test_heights_have_the_system_that_is_named(tmp_path, header, system):
    points, _ = read(tmp_path, [header, *ROWS])
    assert {point.height_system for point in points} == {system}
    assert points[0].origin.height_system == system


def test_degrees_with_heights_are_over_the_ellipsoid(tmp_path):
    (point,), _ = read(tmp_path, ["EPSG:4979", "8.5362 47.4028 402.5 10 20 DJI_0010.JPG north"])
    assert point.height_system == "EPSG:4979"


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
        ([*UTM, ROWS[0].replace("DJI_0010", "IMG_1")], ["line 2", "'IMG_1.JPG'", "no picture of the flight"]),
        (["EPSG:4326", "47.403 8.536 400 1 1 DJI_0010.JPG"], ["swapped", "longitude before the latitude"]),
        ([*UTM, "5249995.0 465005.0 402.5 1 1 DJI_0010.JPG"], ["swapped", "easting before the northing"]),
        (["EPSG:32633", *ROWS], ["km or more from the pictures", "coordinate system"]),
        (["EPSG:5806", *ROWS], ["line 1", "EPSG:5806"]),
        (["EPSG:5800", *ROWS], ["line 1", "EPSG:5800", "of one site"]),
        (["EPSG:5703", *ROWS], ["line 1", "EPSG:5703", "a system of heights"]),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(tmp_path, lines, words):
    message = refused(tmp_path, lines)
    for word in words:
        assert word in message


def test_a_name_of_two_pictures_is_refused(tmp_path):
    two = replace(flight(), frames=Frames(np.arange(2.0), ("a/X.JPG", "b/X.JPG"), lambda _: None))
    assert "several; write its folder too" in refused(tmp_path, [*UTM, "1 2 3 4 5 X.JPG"], two)


@pytest.mark.parametrize("names", [("a/X.JPG", "b/X.JPG"), ("a_X.JPG", "b_X.JPG")])
def test_pictures_of_a_folder_that_is_not_mapped_are_left_out(tmp_path, names):
    """The list may be that of all folders, of which some are mapped."""
    two = replace(flight(), frames=Frames(np.arange(2.0), names, lambda _: None))
    rows = [f"465005.0 5249995.0 402.5 4 5 {folder}/X.JPG here" for folder in "abc"]
    ((point,), (note,)) = read(tmp_path, [*UTM, *rows], two)
    assert [view.picture for view in point.views] == list(names)
    assert "line 4: no picture of the flight has this name" in note
    assert "c/X.JPG" in note


@pytest.mark.parametrize("name", ["X.JPG", "a/X.JPG", "a_X.JPG"])
def test_pictures_of_one_name_in_other_folders_are_not_those_of_the_flight(tmp_path, name):
    of = replace(flight(), name="a", frames=Frames(np.arange(1.0), (name,), lambda _: None))
    rows = [f"465005.0 5249995.0 402.5 {k} 5 {each} here" for k, each in enumerate(("b/X.JPG", "a/X.JPG"))]
    ((point,), (note,)) = read(tmp_path, [*UTM, *rows], of)
    assert [view[1:] for view in point.views] == [(1.0, 5.0)]
    assert "b/X.JPG" in note


def test_a_picture_in_two_folders_that_may_both_be_the_flights_is_refused(tmp_path):
    of = replace(flight(), frames=Frames(np.arange(1.0), ("X.JPG",), lambda _: None))
    rows = [f"465005.0 5249995.0 402.5 4 5 {each}/X.JPG here" for each in "bc"]
    assert "in several folders, of which the flight has one" in refused(tmp_path, [*UTM, *rows], of)
    same = ["images/X.JPG", "/home/me/images/X.JPG", "X.JPG"]
    rows = [f"465005.0 5249995.0 402.5 4 5 {each} {k}" for k, each in enumerate(same)]
    points, notes = read(tmp_path, [*UTM, *rows], of)
    assert len(points) == 3
    assert not notes


def test_photographs_of_one_name_are_told_apart_by_their_folder(tmp_path):
    """The names are those that a folder of photographs gives them."""
    files = {f"{folder}/P{k}.jpg": jpeg(seed=k) for k, folder in enumerate("ab")}
    files |= {f"{folder}/Q.jpg": jpeg(seed=9 + k, place=(30.17, -98.09)) for k, folder in enumerate("ab")}
    folder = fill(tmp_path / "photos", files)
    of = import_photos(folder)
    rows = ["-98.09 30.17 300 3 4 a/Q.jpg here", f"-98.09 30.17 300 5 6 {folder}\\b\\Q.JPG here"]
    ((point,), notes) = read(tmp_path, ["EPSG:4326", *rows], of)
    assert [view.picture for view in point.views] == ["a_Q.jpg", "b_Q.jpg"]
    assert not notes
    assert "several; write its folder too" in refused(tmp_path, ["EPSG:4326", "-98 30 3 4 5 Q.jpg"], of)


def test_rows_of_other_pictures_are_named_and_left_out(tmp_path):
    (north, _), (note,) = read(tmp_path, [*UTM, *ROWS, ROWS[0].replace("0010", "9999")])
    assert len(north.views) == 2
    assert "line 5: no picture of the flight has this name" in note
    assert "DJI_9999.JPG" in note


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


def test_points_that_are_held_out_must_exist(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    held = with_surveyed(flight(), points, ["north"])
    assert [p.role for p in held.surveyed] == ["check", "check"]
    with pytest.raises(InputError, match=r"--check west: no control point of that name; the points are nor"):
        with_surveyed(flight(), points, ["west"])


def test_a_standard_deviation_counts_for_all_points_and_is_refused_without_any(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    both = with_surveyed(with_surveyed(flight(), points[:1]), points[1:], std_m=0.1)
    assert [p.std_m for p in both.surveyed] == [0.1, 0.1]
    with pytest.raises(InputError, match=r"--gcp-std: there are no control points; give --gcp FILE"):
        with_surveyed(flight(), (), std_m=0.1)


def test_the_origin_is_a_point_where_there_is_no_gps(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    origin = with_surveyed(replace(flight(), gps=None), points).geo_origin()
    assert (origin.latitude_deg, origin.altitude_m) == (points[0].latitude_deg, 402.5)
    flat = [replace(points[0], altitude_m=np.nan), points[1]]
    origin = with_surveyed(replace(flight(), gps=None), flat).geo_origin()
    assert (origin.latitude_deg, origin.altitude_m) == (points[1].latitude_deg, 401.0)
    origin = with_surveyed(replace(flight(), gps=None), flat[:1]).geo_origin()
    assert (origin.latitude_deg, origin.altitude_m) == (points[0].latitude_deg, 0.0)


def test_joined_flights_keep_their_points(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    one = with_surveyed(flight(), points)
    later = one.gps.latitude_deg + 1e-6
    other = replace(one, name="other", gps=replace(one.gps, latitude_deg=later))
    joined = join_flights([one, other])
    assert [p.name for p in joined.surveyed] == ["north", "south"]
    assert {v.picture for v in joined.surveyed[0].views} <= set(joined.frames.names)
    assert len(joined.surveyed[0].views) == 4


def test_a_point_with_two_altitudes_in_joined_flights_is_left_out(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    one = with_surveyed(flight(), points)
    higher = tuple(replace(p, altitude_m=p.altitude_m + 10 * (p.name == "north")) for p in points)
    gps = replace(one.gps, latitude_deg=one.gps.latitude_deg + 1e-6)
    joined = join_flights([one, replace(one, name="other", gps=gps, surveyed=higher)])
    assert [p.fault for p in joined.surveyed] == ["flights give it different coordinates", ""]


def test_a_list_replaces_points_of_a_flight_whose_receiver_had_no_fix(tmp_path):
    points, _ = read(tmp_path, [*UTM, *ROWS])
    nowhere = np.full(3, np.nan)
    blind = replace(flight(), gps=Gps(np.arange(3.0), nowhere, nowhere, nowhere), surveyed=points)
    again, _ = read(tmp_path, [*UTM, *ROWS], blind)
    assert again == points


def test_a_flight_folder_s_own_list_is_read_with_it(tmp_path):
    written = made_flight()
    write_flight(written, tmp_path / "f")
    origin, name = written.geo_origin(), read_flight(tmp_path / "f").frames.names[0]
    place = f"{origin.longitude_deg} {origin.latitude_deg} 12.5"
    listed = f"EPSG:4326\n{place} 20 10 {name} north\n{place} 20 10 gone.png north\n"
    (tmp_path / "f" / "gcp_list.txt").write_text(listed)
    back = read_flight(tmp_path / "f")
    (point,) = back.surveyed
    assert (point.name, point.altitude_m, point.views) == ("north", 12.5, (PictureView(name, 20.0, 10.0),))
    assert any("gcp_list.txt, line 3: no picture of the flight has this name" in w for w in back.warnings)
    (tmp_path / "f" / "gcp_list.txt").write_text("EPSG:4326\n1 2 3\n")
    back = read_flight(tmp_path / "f")
    assert back.surveyed == ()
    fault = "gcp_list.txt, line 2: has 3 fields, fewer than 6"
    assert any(w.startswith(fault) and w.endswith("; no control point is used") for w in back.warnings)


def test_a_list_beside_a_recording_without_pictures_is_noted(tmp_path):
    write_flight(replace(made_flight(), frames=None), tmp_path / "f")
    (tmp_path / "f" / "gcp_list.txt").write_text("\n".join([*UTM, *ROWS]))
    assert "gcp_list.txt is not used: the flight has no pictures" in read_flight(tmp_path / "f").warnings


def test_without_its_own_list_a_flight_is_as_before(tmp_path):
    (tmp_path / "gcp_list.txt").write_text("\n".join([*UTM, *ROWS, "1 1 1 1 1 gone.jpg", FAULT]))
    told = with_own_points(flight(), tmp_path)
    assert [p.name for p in told.surveyed] == ["north", "south"]
    assert any("control point south" in line for line in told.warnings)
    plain = without_own_points(told)
    assert (plain.surveyed, plain.warnings) == ((), ())


def test_a_list_on_the_command_line_replaces_those_of_the_flights(tmp_path):
    """Points of the folder's list with other names stayed."""
    (tmp_path / "gcp_list.txt").write_text("\n".join([*UTM, *ROWS]))
    given = tmp_path / "given.txt"
    given.write_text("\n".join([*UTM, ROWS[0].replace("north", "mast")]))
    own = with_own_points(flight(), tmp_path)
    options = SimpleNamespace(gcp=given, check=(), gcp_std_m=None)
    assert [p.name for p in _joined([own], options).surveyed] == ["mast"]


def test_points_without_names_of_two_flights_are_two_points(tmp_path):
    first, _ = read(tmp_path, [*UTM, ROWS[0].removesuffix(" north")])
    second, _ = read(tmp_path, [*UTM, "465025.0 5250010.0 401 10 20 DJI_0010.JPG", ROWS[0][:-6]])
    assert [p.name for p in (*first, *second)] == ["GCP 1", "GCP 1", "GCP 2"]
    one = with_surveyed(flight(), first)
    gps = replace(one.gps, latitude_deg=one.gps.latitude_deg + 1e-6)
    joined = join_flights([one, replace(one, name="other", gps=gps, surveyed=second)])
    found = [(p.name, len(p.views), p.fault) for p in joined.surveyed]
    assert found == [("photos/GCP 1", 2, ""), ("other/GCP 1", 1, "")]


def table(path, lines):
    path.write_text("\n".join(lines) + "\n")
    return path


def test_landmarks_with_pixels_are_the_same_points(tmp_path):
    """The columns in another order, with units, and a check point."""
    listed, _ = read(
        tmp_path,
        ["EPSG:32632", "465005.0 5249995.0 402.5 100.5 200 DJI_0010.JPG north",
         "465005.0 5249995.0 402.5 10 20 DJI_0020.JPG north",
         "465080.0 5250020.0 NaN 5 6 DJI_0020.JPG gate check"],
    )  # fmt: skip
    path = table(
        tmp_path / "landmarks.csv",
        ["# EPSG:32632", "image,px,py,name,x [m],y [m],z [m],check",
         "DJI_0010.JPG,100.5,200,north,465005.0,5249995.0,402.5,", "",
         "DJI_0020.JPG,10,20,north,465005.0,5249995.0,402.5,no",
         "DJI_0020.JPG,5,6,gate,465080.0,5250020.0,NaN,yes"],
    )  # fmt: skip
    points, notes = read_gcp_list(path, flight())
    assert notes == []
    assert repr(points) == repr(listed)
    assert [point.role for point in points] == ["control", "check"]


def test_landmarks_with_pixels_may_be_in_the_axes_of_the_world(tmp_path):
    """By PROJ's topocentric conversion, in which the origin is the first fix."""
    of = replace(flight(), gps=replace(flight().gps, height_system="EPSG:4979"))
    origin = of.geo_origin()
    path = table(
        tmp_path / "landmarks.csv", ["name,x,y,z,image,px,py", "p,120.0,-80.0,-25.0,DJI_0010.JPG,1,2"]
    )
    (point,), _ = read_gcp_list(path, of)
    here = [point.longitude_deg], [point.latitude_deg], [point.altitude_m]
    there = [origin.longitude_deg], [origin.latitude_deg], [origin.altitude_m]
    a, b = (np.ravel(transform("EPSG:4979", "EPSG:4978", *each)) for each in (here, there))
    lat, lon = np.radians([origin.latitude_deg, origin.longitude_deg])
    east = np.array([-np.sin(lon), np.cos(lon), 0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    w_p = np.array([east, np.cross(up, east), up]) @ (a - b)
    np.testing.assert_allclose(w_p, [120.0, -80.0, -25.0], atol=1e-3)
    assert point.height_system == "EPSG:4979"


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (["name,x,y,z,image,px,py", "p,1,2,3,DJI_0010.JPG,1"], "line 2: has 6 fields instead of 7"),
        (["name,x,y,z,image,px,py", "p,1,two,3,DJI_0010.JPG,1,2"], "line 2: has no number for x, y or z"),
        (["# EPSG:32632", "name,x,y,z,image,px,py", "p,1,2,3,DJI_0010.JPG,one,2"], "line 3: holds 'one'"),
        (["# EPSG:1", "name,x,y,z,image,px,py", "p,1,2,3,DJI_0010.JPG,1,2"], "line 1: names 'EPSG:1'"),
    ],
)
def test_landmarks_with_pixels_that_cannot_be_read_are_refused_with_their_line(tmp_path, lines, words):
    with pytest.raises(InputError) as refusal:
        read_gcp_list(table(tmp_path / "landmarks.csv", lines), flight())
    assert words in str(refusal.value)


def test_a_folder_s_landmarks_with_pixels_are_followed_and_the_others_compared(tmp_path):
    write_flight(replace(made_flight(), landmark_pairs=(), gaps=()), tmp_path / "f")
    picture = made_flight().frames.names[0]
    lines = ["name,x,y,z,image,px,py", f"north,1.0,2.0,-3.0,{picture},3,4", "A,0.5,0.25,-1.0,,,"]
    table(tmp_path / "f" / "landmarks.csv", lines)
    back = read_flight(tmp_path / "f")
    assert [point.name for point in back.surveyed] == ["north"]
    assert list(back.landmarks) == ["A"]
