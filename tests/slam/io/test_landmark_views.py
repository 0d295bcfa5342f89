"""``landmarks.csv``, with pixels of its points and without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rasterio.warp import transform

from slam.core.control_points import PictureView
from slam.core.errors import InputError
from slam.io.flight_folder import read_flight, write_flight
from slam.io.gcp_list import read_gcp_list
from tests.slam.io.made_flight import made_flight
from tests.slam.io.made_gcp_list import flight, read


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


VIEW = "p,1.0,2.0,3.0,DJI_0010.JPG,1,2"


def test_heights_over_an_origin_without_an_altitude_are_none(tmp_path):
    of = replace(flight(), gps=replace(flight().gps, altitude_m=np.full(3, np.nan)))
    path = table(tmp_path / "landmarks.csv", ["name,x,y,z,image,px,py", VIEW])
    (point,), _ = read_gcp_list(path, of)
    assert np.isnan(point.altitude_m)


def test_titles_may_stand_in_quotes(tmp_path):
    titles = '"name","x [m]","y","z","image","px","py"'
    (point,), _ = read_gcp_list(table(tmp_path / "landmarks.csv", [titles, VIEW]), flight())
    assert point.views == (PictureView("DJI_0010.JPG", 1.0, 2.0),)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (["name,x [ft],y [ft],z [ft],image,px,py", VIEW], "line 1: has the header 'name,x [ft],y [ft],"),
        (["name,x,y,z,image,px,py", VIEW, '"' + "p" * 200_000], "is not a csv file"),
        (["name,x,y,z,image,px,py", VIEW.replace("p", '"p\nq"', 1), "p,1,2,3"], "line 4: has 4 fields"),
        (["# EPSG:32632", "name,x,y,z,image,px,py", "p,a,b,c,DJI_0010.JPG,d,e", VIEW], "line 3: holds 'a'"),
        (["# EPSG:32632", "name,x,y,z,image,px,py", "p,1,2,,DJI_0010.JPG,3,4"], "line 3: holds ''"),
    ],
)  # fmt: skip
def test_rows_with_pixels_are_read_by_the_rules_of_rows_without(tmp_path, lines, words):
    """Feet counted as metres, and a damaged row ended the program or shifted the columns."""
    with pytest.raises(InputError) as refusal:
        read_gcp_list(table(tmp_path / "landmarks.csv", lines), flight())
    assert words in str(refusal.value)
