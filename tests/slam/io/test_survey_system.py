"""Coordinate systems of control points: names, heights and the accuracy of datums."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rasterio.crs import CRS

from slam.core.geodesy import ECCENTRICITY_2
from slam.core.messages import Kind
from slam.core.streams import Gps
from tests.slam.io.made_gcp_list import ROWS, UTM, flight, read

OSGB_BY_ESRI = (
    'PROJCS["British_National_Grid",GEOGCS["GCS_OSGB_1936",DATUM["D_OSGB_1936",'
    'SPHEROID["Airy_1830",6377563.396,299.3249646]],PRIMEM["Greenwich",0],UNIT["Degree",0.0174532925199433]],'
    'PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",49],PARAMETER["central_meridian",-2],'
    'PARAMETER["scale_factor",0.9996012717],PARAMETER["false_easting",400000],'
    'PARAMETER["false_northing",-100000],UNIT["metre",1]]'
)
"""EPSG:27700 as a .prj file has it, without codes."""


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
        assert [("heights are taken in metres" in str(note)) for note in notes] == [True] * said
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
        ("EPSG:3460", "1973541.4 3867186.7 10", -18.2, 178.5, 2.0),
        (OSGB_BY_ESRI, "530000 180000 50", 51.5, -0.13, 2.0),
        ("+proj=utm +zone=32 +datum=WGS84", "465005.0 5249995.0 402.5", 47.4028, 8.5362, 0.0),
        ("+proj=utm +zone=32 +ellps=GRS80", "465005.0 5249995.0 402.5", 47.4028, 8.5362, 0.0),
        ("+proj=utm +zone=32 +ellps=GRS80 +towgs84=0,0,0", "465005 5249995 402", 47.4028, 8.5362, 0.0),
    ],
)
def test_the_accuracy_of_the_transformation_of_a_datum(
    tmp_path, header, row, latitude_deg, longitude_deg, std_m
):
    """Accuracies by EPSG's database: OSGB36 to WGS 84 (6), DHDN to WGS 84 (2), and Fiji 1986 to WGS 84
    (1), whose area crosses the meridian of 180 degrees."""
    gps = Gps(np.arange(3.0), np.full(3, latitude_deg), np.full(3, longitude_deg), np.full(3, 450.0))
    (point,), notes = read(tmp_path, [header, f"{row} 10 20 DJI_0010.JPG north"], replace(flight(), gps=gps))
    assert point.datum_std_m == std_m
    assert [f"good to {std_m:g} m" in str(note) for note in notes] == [True] * (std_m > 0)


@pytest.mark.parametrize(
    "datum",
    [
        "+ellps=GRS80 +towgs84=10,20,30",
        "+ellps=bessel",
        "+ellps=bessel +towgs84=598.1,73.7,418.2,0.2,0.045,-2.455,6.7",
    ],
)
def test_a_transformation_of_unknown_accuracy_is_told(tmp_path, datum):
    """An ellipsoid without a datum, and parameters that the list itself states."""
    gps = Gps(np.arange(3.0), np.full(3, 47.4), np.full(3, 8.54), np.full(3, 450.0))
    header = f"+proj=tmerc +lon_0=9 +x_0=3500000 {datum}"
    row = "3465000 5250000 400 10 20 DJI_0010.JPG north"
    _, (note,) = read(tmp_path, [header, row], replace(flight(), gps=gps))
    assert "of unknown accuracy" in str(note)
    assert note.kind is Kind.WARNING


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
