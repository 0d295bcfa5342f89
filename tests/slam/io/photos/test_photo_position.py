"""Position tags that cannot be used as they are: the remarks about them, and what is used instead."""

import numpy as np
import pytest
from PIL.ExifTags import GPS
from PIL.TiffImagePlugin import IFDRational

from slam.io.photos.import_photos import import_photos
from tests.slam.io.photos.photo_files import fill, jpeg, strip, warned


def remark(flight, *parts):
    """The one warning that has all parts."""
    (line,) = warned(flight, *parts)
    return line


@pytest.mark.parametrize(
    ("gps", "reason"),
    [
        ({GPS.GPSStatus: "V"}, "GPSStatus is V"),
        ({GPS.GPSLatitudeRef: ""}, "GPSLatitudeRef (N or S) is missing"),
        ({GPS.GPSLongitudeRef: "?"}, "GPSLongitudeRef (E or W) is missing"),
        ({GPS.GPSLatitude: (IFDRational(95), IFDRational(0), IFDRational(0))}, "latitude 95 degrees"),
        ({GPS.GPSLongitude: (IFDRational(181), IFDRational(0), IFDRational(0))}, "longitude 181 degrees"),
        ({GPS.GPSLatitude: (IFDRational(30), IFDRational(7), IFDRational(0, 0))}, "no valid seconds"),
        ({GPS.GPSLatitude: (IFDRational(30), IFDRational(75), IFDRational(0))}, "GPSLatitude is not in"),
        ({GPS.GPSLongitude: (IFDRational(1), IFDRational(0))}, "GPSLongitude is not in degrees"),
    ],
)
def test_a_position_that_is_not_used_is_reported_with_its_reason_and_photographs(tmp_path, gps, reason):
    flight = import_photos(fill(tmp_path, {"a.jpg": jpeg(gps=gps), "b.jpg": jpeg(gps=gps, time=None)}))
    assert flight.gps is None
    assert "not used in 2 photographs" in remark(flight, reason, "(a.jpg, b.jpg)")
    assert remark(flight, "no GPS position of any photograph can be used")


def test_photographs_without_position_tags_are_not_reported_as_faulty(tmp_path):
    flight = import_photos(fill(tmp_path, strip(2, place=None)))
    assert remark(flight, "no GPS position of any photograph is recorded")
    assert not any("not used" in line for line in flight.warnings)


def test_missing_letters_are_taken_from_the_other_photographs(tmp_path):
    files = strip(4, gps=None) | {"P2.jpg": strip(4, gps={GPS.GPSLongitudeRef: ""})["P2.jpg"]}
    flight = import_photos(fill(tmp_path, files))
    assert flight.gps.longitude_deg.tolist() == [-98.0] * 4
    assert flight.gps.latitude_deg[2] == pytest.approx(30.0002)
    assert "N and W, assumed (P2.jpg)" in remark(flight, "1 photograph without the letters")


def test_a_letter_that_contradicts_the_others_is_not_replaced(tmp_path):
    files = strip(3) | {
        "P1.jpg": jpeg(gps={GPS.GPSLatitudeRef: "S", GPS.GPSLongitudeRef: ""}, time="2024:05:06 07:08:02")
    }
    flight = import_photos(fill(tmp_path, files))
    assert len(flight.gps.stamps_s) == 2
    assert remark(flight, "GPSLongitudeRef (E or W) is missing", "(P1.jpg)")


def test_minutes_with_decimals_need_no_seconds(tmp_path):
    minutes = (IFDRational(30), IFDRational(10_2300, 10_000), IFDRational(0, 0))
    gps = import_photos(fill(tmp_path, {"a.jpg": jpeg(gps={GPS.GPSLatitude: minutes})})).gps
    assert gps.latitude_deg[0] == pytest.approx(30 + 10.23 / 60)


@pytest.mark.parametrize(
    ("tags", "left"),
    [
        ({"drone": {"AbsoluteAltitude": "1e308"}}, 320.5),
        ({"drone": {"RelativeAltitude": "-1e300"}}, 320.5),
        ({"gps": {GPS.GPSAltitude: IFDRational(4_000_000_000, 1)}}, np.nan),
    ],
)
def test_absurd_altitudes_are_refused_by_name(tmp_path, tags, left):
    flight = import_photos(fill(tmp_path, {"a.jpg": jpeg(**tags), "b.jpg": jpeg(time="2024:05:06 07:08:10")}))
    np.testing.assert_array_equal(flight.gps.altitude_m, [left, 320.5])
    assert remark(flight, "is beyond 50 km", "(a.jpg)")
    assert flight.barometer is None


@pytest.mark.parametrize(
    ("altitude", "words"),
    [(0, "altitude 0 wherever one is written, which is none"), (None, "no GPS position has an altitude")],
)
def test_a_set_without_any_altitude_says_that_its_heights_count_from_the_floor(tmp_path, altitude, words):
    times = ("2024:05:06 07:08:01", "2024:05:06 07:08:02")
    files = {f"{k}.jpg": jpeg(altitude=altitude, time=time) for k, time in enumerate(times)}
    flight = import_photos(fill(tmp_path, files))
    assert np.isnan(flight.gps.altitude_m).all()
    assert "heights count from the floor" in remark(flight, words)
    assert not flight.geo_origin().altitude_known


@pytest.mark.parametrize(
    ("first", "second", "system"),
    [
        ({"drone": {"AltitudeType": "RtkAlt", "AbsoluteAltitude": "+321.5"}},) * 2 + ("EPSG:4979",),
        ({"drone": {"AltitudeType": "GpsFusionAlti", "AbsoluteAltitude": "+321.5"}},) * 2 + ("",),
        ({"gps": {GPS.GPSAltitudeRef: b"\x02"}},) * 2 + ("EPSG:5773",),
        ({"drone": {"AltitudeType": "RtkAlt", "AbsoluteAltitude": "+321.5"}}, {}, ""),
        (
            {"drone": {"AltitudeType": "RtkAlt", "AbsoluteAltitude": "+321.5"}},
            {"gps": {GPS.GPSAltitudeRef: b"\x02"}},
            "",
        ),
        ({}, {}, ""),
    ],
)
def test_altitudes_have_the_level_that_all_tags_tell(tmp_path, first, second, system):
    files = {"a.jpg": jpeg(**first), "b.jpg": jpeg(**second, time="2024:05:06 07:08:10")}
    flight = import_photos(fill(tmp_path, files))
    assert flight.gps.height_system == system
    assert flight.geo_origin().height_system == system


def test_zeros_beside_missing_altitudes_are_none_either(tmp_path):
    times = [f"2026:01:01 10:00:0{k}" for k in range(3)]
    files = {f"{k}.jpg": jpeg(altitude=each, time=times[k]) for k, each in enumerate((0, None, 0))}
    assert np.isnan(import_photos(fill(tmp_path, files)).gps.altitude_m).all()


def test_one_photograph_may_be_at_altitude_zero(tmp_path):
    gps = {GPS.GPSAltitude: IFDRational(0, 1)}
    flight = import_photos(
        fill(tmp_path, {"a.jpg": jpeg(gps=gps), "b.jpg": jpeg(time="2024:05:06 07:08:10")})
    )
    np.testing.assert_array_equal(flight.gps.altitude_m, [0, 320.5])
    assert flight.geo_origin().altitude_known


def test_an_absurd_xmp_latitude_gives_way_to_exif(tmp_path):
    drone = {"GpsLatitude": "95.0", "GpsLongitude": "-98.0"}
    flight = import_photos(fill(tmp_path, {"a.jpg": jpeg(drone=drone)}))
    assert flight.gps.latitude_deg[0] == pytest.approx(30.1705)
    assert remark(flight, "XMP: latitude 95 degrees is beyond 90", "(a.jpg)")


@pytest.mark.parametrize(("east_deg", "told"), [(0.001, True), (0.000002, False)])
def test_places_of_exif_that_differ_from_those_of_the_maker_are_told(tmp_path, east_deg, told):
    drone = {"GpsLatitude": "30.1705", "GpsLongitude": f"{-98.0902 + east_deg:.7f}"}
    flight = import_photos(fill(tmp_path, {"a.jpg": jpeg(drone=drone)}))
    assert flight.gps.longitude_deg[0] == pytest.approx(-98.0902 + east_deg)
    assert any("Exif's differ by up to 96.2 m" in line for line in flight.warnings) == told


def test_places_of_exif_may_be_rounded_to_seconds(tmp_path):
    whole = {GPS.GPSLatitude: (IFDRational(30, 1), IFDRational(10, 1), IFDRational(13, 1))}
    drone = {"GpsLatitude": "30.1705", "GpsLongitude": "-98.0902"}
    flight = import_photos(fill(tmp_path, {"a.jpg": jpeg(drone=drone, gps=whole)}))
    assert not any("Exif's differ" in line for line in flight.warnings), "0.8 seconds are 25 m"


def test_the_horizontal_error_of_exif_is_read(tmp_path):
    error = {GPS.GPSHPositioningError: IFDRational(3, 2)}
    flight = import_photos(fill(tmp_path, {"a.jpg": jpeg(gps=error)}))
    east, north, up = flight.gps.noise_std_m
    assert np.hypot(east, north) == pytest.approx(1.5)
    assert up == pytest.approx(2 * east)
    assert not any("accuracy of the GPS assumed" in line for line in flight.warnings)


def test_the_stated_accuracy_of_a_set_is_its_median_and_gaps_are_reported(tmp_path):
    """One photograph of five without RTK, and one that states nothing, change nothing."""
    std = {f"RtkStd{axis}": "0.01" for axis in ("Lon", "Lat", "Hgt")}
    files = {
        f"{k}.jpg": jpeg(time=f"2024:05:06 07:08:0{k}", drone=drone)
        for k, drone in enumerate([std, std, {name: "5.0" for name in std}, std, None])
    }
    flight = import_photos(fill(tmp_path, files))
    assert flight.gps.noise_std_m == (0.01, 0.01, 0.01)
    assert remark(flight, "1 of 5 GPS positions state no accuracy")


def test_fixes_of_different_accuracy_count_with_their_own(tmp_path):
    """A float solution with its accuracy, and a lost one that states none, beside three fixed ones."""
    names = [f"RtkStd{axis}" for axis in ("Lon", "Lat", "Hgt")]
    fixed = {name: "0.01" for name in names} | {"RtkFlag": "50"}
    drones = [fixed, fixed, {name: "0.5" for name in names} | {"RtkFlag": "34"}, fixed, {"RtkFlag": "16"}]
    files = {f"{k}.jpg": jpeg(time=f"2024:05:06 07:08:0{k}", drone=d) for k, d in enumerate(drones)}
    flight = import_photos(fill(tmp_path, files))
    assert flight.gps.noise_std_m == (0.01, 0.01, 0.01)
    np.testing.assert_equal(flight.gps.stds_m[:, 0], [0.01, 0.01, 0.5, 0.01, 5.0])
    np.testing.assert_equal(flight.gps.stds_m[4], [5, 5, 10])
    assert remark(
        flight, "1 of 5 GPS positions state no accuracy and have no fixed RTK solution", "5, 5, 10 m"
    )
    assert remark(flight, "RTK solutions of 5 GPS positions: 3 fixed, 1 float, 1 single")


def test_fixes_of_nearly_one_accuracy_have_the_median(tmp_path):
    drones = [{f"RtkStd{axis}": std for axis in ("Lon", "Lat", "Hgt")} for std in ("0.011", "0.012", "0.014")]
    files = {f"{k}.jpg": jpeg(drone=d | {"RtkFlag": "50"}) for k, d in enumerate(drones)}
    flight = import_photos(fill(tmp_path, files))
    assert flight.gps.stds_m is None
    assert flight.gps.noise_std_m == (0.012, 0.012, 0.012)
    assert not warned(flight, "RTK solutions")


@pytest.mark.parametrize(
    ("datum", "is_told"),
    [
        ("TOKYO", True),
        ("OSGB 36", True),
        ("WGS-84", False),
        ("WGS 84", False),
        ("ETRS89", False),
        ("", False),
    ],
)
def test_positions_in_an_older_datum_are_named(tmp_path, datum, is_told):
    flight = import_photos(fill(tmp_path, strip(2, gps={GPS.GPSMapDatum: datum})))
    assert bool(warned(flight, "GPSMapDatum of 2 photographs is", datum)) == is_told


def test_the_datum_of_exif_is_not_that_of_the_maker_s_position(tmp_path):
    place = {"GpsLatitude": "30.0", "GpsLongitude": "-98.0"}
    flight = import_photos(fill(tmp_path, strip(2, gps={GPS.GPSMapDatum: "TOKYO"}, drone=place)))
    assert not warned(flight, "GPSMapDatum")
