"""DJI's marks of exposures beside photographs."""

from __future__ import annotations

import numpy as np
import pytest
from rasterio.warp import transform

from slam.io.photos.import_photos import import_photos
from tests.slam.io.photos.photo_files import fill, jpeg

PLACES = ((44.42824637, 1.26196331), (44.42834637, 1.26196331), (44.42844637, 1.26206331))
NAMES = ("DJI_20250101120000_0001_V.JPG", "DJI_20250101120002_0002_V.JPG", "DJI_20250101120004_0003_V.JPG")
STDS = ((0.028, 0.031, 0.055), (0.018, 0.016, 0.035), (1.5, 1.6, 3.5))
TIMES = ("2025:01:01 12:00:00", "2025:01:01 12:00:02", "2025:01:01 12:00:04")


def mark(number, place, std, quality=50, height=359.494, offset=(-40, 0, 86)):
    """A line as DJI writes it."""
    north, east, down = offset
    return (
        f"{number}\t{400373.488877 + 2 * number:.6f}\t[2264]\t{north:6d},N\t{east:6d},E\t{down:6d},V\t"
        f"{place[0]:.8f},Lat\t{place[1]:.8f},Lon\t"
        f"{height:.3f},Ellh\t{std[0]:.6f}, {std[1]:.6f}, {std[2]:.6f}\t"
        f"{quality},Q\n"
    )


def photos(names=NAMES, at=PLACES):
    return {n: jpeg(place=p, altitude=310.0, time=t) for n, p, t in zip(names, at, TIMES, strict=True)}


def imported(tmp_path, lines, files=None, name="DJI_202501011159_001_Timestamp.MRK"):
    return import_photos(fill(tmp_path, {**(files or photos()), name: "".join(lines).encode()}))


def all_marks(**of):
    return [mark(k + 1, place, std, **of) for k, (place, std) in enumerate(zip(PLACES, STDS, strict=True))]


def test_places_accuracies_and_level_are_those_of_the_camera(tmp_path):
    flight = imported(tmp_path, all_marks())
    gps = flight.gps
    np.testing.assert_allclose(
        np.column_stack([gps.latitude_deg, gps.longitude_deg]), PLACES, rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(gps.altitude_m, 359.494)
    # The file has north before east.
    np.testing.assert_allclose(gps.each_std_m, [(e, n, u) for n, e, u in STDS])
    assert gps.height_system == "EPSG:4979"
    assert not gps.antenna_assumed
    np.testing.assert_array_equal(gps.b_T_s, np.eye(4))
    (line,) = (line for line in flight.warnings if "Timestamp.MRK" in line)
    assert "places of 3 of 3 photographs" in line
    assert "0.095 m from the antenna on average; those in the tags differ" in line, (
        "the length of 40 mm and 86 mm"
    )


def test_names_of_the_phantom_have_the_number_too(tmp_path):
    names = ("100_0001_0001.JPG", "100_0001_0002.JPG", "100_0001_0003.JPG")
    flight = imported(tmp_path, all_marks(), photos(names), "100_0001_Timestamp.MRK")
    np.testing.assert_allclose(flight.gps.altitude_m, 359.494)


def test_the_difference_from_the_tags_is_told(tmp_path):
    """Tags that have the antenna's place: 0.3 m north of the camera's, by PROJ."""
    x, y = transform("EPSG:4326", "EPSG:32631", [p[1] for p in PLACES], [p[0] for p in PLACES])
    lon, lat = transform("EPSG:32631", "EPSG:4326", x, [each + 0.3 for each in y])
    flight = imported(tmp_path, all_marks(), photos(at=tuple(zip(lat, lon, strict=True))))
    assert any("those in the tags differ by up to 0.3 m" in line for line in flight.warnings)
    np.testing.assert_allclose(flight.gps.latitude_deg, [p[0] for p in PLACES], rtol=0, atol=1e-12)


def test_marks_of_another_flight_are_not_used(tmp_path):
    elsewhere = [
        mark(k + 1, (p[0] + 0.001, p[1]), std) for k, (p, std) in enumerate(zip(PLACES, STDS, strict=True))
    ]
    flight = imported(tmp_path, elsewhere)
    assert any("lie elsewhere than the places in their tags" in line for line in flight.warnings)
    np.testing.assert_allclose(flight.gps.altitude_m, 310.0)
    assert flight.gps.antenna_assumed
    assert flight.gps.height_system == ""


def test_a_set_that_marks_cover_in_part_keeps_its_assumptions(tmp_path):
    flight = imported(tmp_path, [*all_marks()[:2], mark(3, PLACES[2], STDS[2], quality=0), "3\tgarbage\n"])
    assert any("2 lines cannot be read" in line for line in flight.warnings)
    np.testing.assert_allclose(flight.gps.altitude_m, [359.494, 359.494, 310.0])
    assert flight.gps.antenna_assumed
    assert flight.gps.height_system == ""


def flown_twice(names, at):
    """Photographs of two flights in one folder, each of which is numbered from 1."""
    times = ("2025:01:01 12:00:00", "2025:01:01 12:00:02", "2025:01:01 13:00:00", "2025:01:01 13:00:02")
    return {n: jpeg(place=p, altitude=310.0, time=t) for n, p, t in zip(names, at, times, strict=True)}


PHANTOM = ("100_0001_0001.JPG", "100_0001_0002.JPG", "100_0002_0001.JPG", "100_0002_0002.JPG")
MAVIC = tuple(f"DJI_2025010112{k}000_000{1 + k % 2}_V.JPG" for k in range(4))


@pytest.mark.parametrize("apart_deg", [0.001, 0.0])
@pytest.mark.parametrize(
    ("names", "marks"),
    [
        (PHANTOM, ("100_0001_Timestamp.MRK", "100_0002_Timestamp.MRK")),
        (MAVIC, ("DJI_202501011159_001_Timestamp.MRK", "DJI_202501011259_002_Timestamp.MRK")),
    ],
)
def test_two_flights_in_one_folder_have_their_own_marks(tmp_path, names, marks, apart_deg):
    """Names tell the flights, or else the places do; of the same places again, nothing tells them."""
    second = [(latitude + apart_deg, longitude) for latitude, longitude in PLACES[:2]]
    texts = [
        "".join(mark(k + 1, place, STDS[k], height=height) for k, place in enumerate(at))
        for at, height in ((PLACES[:2], 350.0), (second, 360.0))
    ]
    files = flown_twice(names, (*PLACES[:2], *second))
    files |= {name: text.encode() for name, text in zip(marks, texts, strict=True)}
    flight = import_photos(fill(tmp_path, files))
    is_told = apart_deg > 0 or names is PHANTOM
    expected = [350.0, 350.0, 360.0, 360.0] if is_told else [310.0] * 4
    np.testing.assert_allclose(flight.gps.altitude_m, expected)
    doubts = [line for line in flight.warnings if "may be of" in line or "lie elsewhere" in line]
    assert len(doubts) == (0 if is_told else 1)


@pytest.mark.parametrize("text", ["", "nothing\n"])
def test_a_file_without_marks_is_told(tmp_path, text):
    flight = imported(tmp_path, [text])
    assert any("Timestamp.MRK" in line and "not used" in line for line in flight.warnings)


def test_a_table_comes_before_the_marks(tmp_path):
    rows = ["filename,latitude,longitude,altitude"]
    rows += [f"{n},{p[0]},{p[1]},333.0" for n, p in zip(NAMES, PLACES, strict=True)]
    flight = imported(tmp_path, all_marks(), {**photos(), "geotags.csv": "\n".join(rows).encode()})
    np.testing.assert_allclose(flight.gps.altitude_m, 333.0)
    assert flight.gps.antenna_assumed, "a table does not tell whose places it has"
    assert flight.gps.height_system == ""
