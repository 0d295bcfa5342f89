"""Positions of photographs in a table beside them, and other texts there."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.messages import Kind
from slam.io.photos.import_photos import import_photos
from tests.slam.io.photos.photo_files import fill, jpeg, strip, warned


def test_positions_of_a_table_are_preferred_to_those_of_the_tags(tmp_path):
    rows = b"filename,latitude,longitude,altitude\nP0.JPG,31.5,-98.5,100\np2.jpg,31.6,-98.6,102\n"
    rows += b"other.jpg,1,2,3\n"
    flight = import_photos(fill(tmp_path, strip(3) | {"geotags.csv": rows}))
    assert flight.gps.latitude_deg == pytest.approx([31.5, 30.0001, 31.6])
    assert flight.gps.altitude_m == pytest.approx([100, 320.5, 102])
    assert warned(flight, "positions of 2 of 3 photographs are those of geotags.csv")
    assert warned(flight, "geotags.csv has positions of 1 file that are none of them (other.jpg)")
    assert not warned(flight, "not read")


def test_positions_by_folder_where_names_are_the_same(tmp_path):
    files = {f"{k}/a.jpg": data for k, data in enumerate(strip(2, place=None).values())}
    rows = b"image;lat;lon;alt [ft]\n0/a.jpg;31.5;-98.5;1000\n1\\a.jpg;31.6;-98.6;1001\n"
    flight = import_photos(fill(tmp_path, files | {"places.txt": rows}))
    assert flight.gps.latitude_deg == pytest.approx([31.5, 31.6])
    assert flight.gps.altitude_m == pytest.approx(np.array([1000, 1001]) * 0.3048)


def test_names_are_found_as_those_of_control_points_are(tmp_path):
    """Paths of another machine lead to the photograph by its name; those of another flight do not."""
    folder = tmp_path / "yard"
    rows = b"filename,latitude,longitude,altitude\nD:\\photos\\yard\\P0.JPG,31.5,-98.5,100\n"
    rows += b"D:\\photos\\roof\\P0.JPG,1,2,3\n"
    flight = import_photos(fill(folder, strip(2) | {"geotags.csv": rows}))
    assert flight.gps.latitude_deg == pytest.approx([31.5, 30.0001])
    assert warned(flight, "positions of 1 of 2 photographs are those of geotags.csv")
    assert warned(flight, "1 file that are none of them", "roof")


def test_a_name_of_several_photographs_is_told_and_not_used(tmp_path):
    files = {f"{k}/a.jpg": data for k, data in enumerate(strip(2).values())}
    rows = b"filename,latitude,longitude,altitude\na.jpg,31.5,-98.5,100\n0/a.jpg,31.6,-98.5,100\n"
    flight = import_photos(fill(tmp_path, files | {"geotags.csv": rows}))
    assert flight.gps.latitude_deg == pytest.approx([31.6, 30.0001])
    assert warned(flight, "1 name that may be of several photographs", "(a.jpg); write the folders too")


def test_a_table_with_an_unknown_unit_is_told_and_not_used(tmp_path):
    rows = b"filename,latitude,longitude,altitude [furlong]\nP0.jpg,31.5,-98.5,100\n"
    flight = import_photos(fill(tmp_path, strip(2) | {"geotags.csv": rows}))
    assert flight.gps.latitude_deg[0] == 30
    assert warned(flight, "has the unit 'furlong'", "its positions are not used")


def test_texts_that_are_not_read_are_named(tmp_path):
    others = {"track.gpx": b"<gpx></gpx>", "notes.txt": b"windy", "gcp_list.txt": b"", "times.csv": b""}
    others |= {"frames.csv": b"time [s],filename,range [m]\n0,P0.jpg,1\n"}
    flight = import_photos(fill(tmp_path, strip(2) | others))
    (line,) = warned(flight, "3 files beside the photographs are not read (notes.txt, times.csv, track.gpx)")
    assert next(m for m in flight.messages if m.text == line).kind is Kind.NOTE
    assert warned(flight, "frames.csv tells times of pictures", f"give it itself, {tmp_path}/frames.csv")


def test_faults_of_cells_are_told(tmp_path):
    rows = b"filename,latitude,longitude,altitude\nP0.jpg,31.5,-98.5,100 m\np1.jpg,31.6,-98.6,102 m\n"
    flight = import_photos(fill(tmp_path, strip(2) | {"geotags.csv": rows}))
    assert warned(flight, "geotags.csv: column 'altitude': 2 of 2 cells are no numbers, first '100 m'")
    assert flight.gps.latitude_deg == pytest.approx([31.5, 31.6])


def test_a_text_with_a_long_line_is_not_read(tmp_path):
    flight = import_photos(fill(tmp_path, strip(2) | {"notes.txt": b"x" * 140_000 + b",1"}))
    assert warned(flight, "1 file beside the photographs is not read (notes.txt)")


def test_accuracies_of_a_table_count_and_photographs_without_a_row_have_none_of_them(tmp_path):
    rows = b"label,lon,lat,alt,Horizontal accuracy (m),Vertical accuracy (m)\n"
    rows += b"P0,-98,30,100,0.02,0.03\nP1,-98,30.0001,102,0.02,\n"
    flight = import_photos(fill(tmp_path, strip(3) | {"ppk.csv": rows}))
    assert warned(flight, "positions of 2 of 3 photographs are those of ppk.csv")
    np.testing.assert_allclose(flight.gps.stds_m, [(0.02, 0.02, 0.03), (0.02, 0.02, 0.04), (5, 5, 10)])


def test_what_a_table_holds_beside_is_named(tmp_path):
    rows = b"filename,latitude,longitude,ellipsoidal height\nP0.jpg,30,-98,100\nP1.jpg,-98,30,100\n"
    flight = import_photos(fill(tmp_path, strip(2) | {"geotags.csv": rows}))
    assert warned(flight, "geotags.csv: columns that are not read: ellipsoidal height")
    assert warned(flight, "geotags.csv: 1 position not used (P1.jpg: latitude -98 degrees is beyond 90)")


def test_places_of_a_table_far_from_those_of_the_tags_are_told(tmp_path):
    """Longitudes without their sign lie on the other side of the Earth; those of PPK lie near."""
    rows = b"filename,latitude,longitude,altitude\nP0.jpg,30.00001,-98,100\nP1.jpg,30,98,100\n"
    flight = import_photos(fill(tmp_path, strip(2) | {"geotags.csv": rows}))
    assert warned(flight, "geotags.csv puts 1 photograph up to", "km from the places in their tags (P1.jpg)")


RTK = {"AltitudeType": "RtkAlt", "AbsoluteAltitude": "+320.5", "GpsLatitude": "30.5", "GpsLongitude": "-98.5"}
"""A maker's tags: an altitude over the ellipsoid, and a place 55 km from that of Exif."""


@pytest.mark.parametrize(
    ("altitude", "std_m", "system"), [("100", (0.02, 0.02, 0.04), ""), ("", (0.02, 0.02, 10), "EPSG:4979")]
)
def test_level_and_accuracy_of_an_altitude_are_those_of_its_source(tmp_path, altitude, std_m, system):
    rows = "filename,latitude,longitude,altitude,horizontal accuracy\n"
    rows += "".join(f"P{k}.jpg,30.5,-98.5,{altitude},0.02\n" for k in range(2))
    flight = import_photos(fill(tmp_path, strip(2, drone=RTK) | {"ppk.csv": rows.encode()}))
    assert flight.gps.height_system == system
    assert flight.gps.noise_std_m == pytest.approx(std_m)
    assert not warned(flight, "from the maker's tags; Exif's differ")


def test_positions_of_a_table_are_not_those_of_the_receiver_s_rtk_solution(tmp_path):
    """They may be corrected after the flight, and have no accuracy of any tags."""
    std = {f"RtkStd{axis}": "0.02" for axis in ("Lon", "Lat", "Hgt")}
    files = strip(2, drone={"RtkFlag": "16"}) | {"R.jpg": jpeg(drone=std | {"RtkFlag": "50"})}
    rows = b"filename,latitude,longitude,altitude\nP0.jpg,30,-98,320\nP1.jpg,30.0001,-98,320\n"
    flight = import_photos(fill(tmp_path, files | {"geotags.csv": rows}))
    assert not warned(flight, "single")
    assert not warned(flight, "no fixed RTK solution")
    np.testing.assert_equal(flight.gps.stds_m[:, 0], [5, 5, 0.02])


def test_a_row_of_another_folder_is_not_that_of_a_photograph_with_its_own(tmp_path):
    files = {f"a/P{k}.jpg": data for k, data in enumerate(strip(2).values())}
    rows = b"filename,latitude,longitude,altitude\na/P0.jpg,31.5,-98.5,100\nb/P0.jpg,31.7,-98.5,100\n"
    rows += b"b/P1.jpg,31.6,-98.5,100\n"
    flight = import_photos(fill(tmp_path, files | {"geotags.csv": rows}))
    assert flight.gps.latitude_deg == pytest.approx([31.5, 30.0001])
    assert warned(flight, "2 files that are none of them", "b/P0.jpg", "b/P1.jpg")
