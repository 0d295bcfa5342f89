"""Tracks on Earth: GeoJSON, GPX and KML, against coordinates worked out by hand.

On the equator at the prime meridian, east is the y and north the z of Earth-centred axes. So 100 m to the
east are atan(100 / 6378137) = 0.00089831528 degrees of longitude. For 100 m to the north, the radius of
curvature of the meridian, a (1 - e^2) = 6335439.327 m, plus 30 m of height gives 0.00090436519 degrees.
The tangent plane lies 100^2 / (2 a) = 0.8 mm above the ellipsoid there.
"""

from __future__ import annotations

import json
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from slam.core.geodesy import GeoOrigin
from slam.io.exports.formats import export_map
from tests.slam.io.exports.made_map import exported, made_map, pose

EAST_DEG, NORTH_DEG = 0.00089831528, 0.00090436519
POSES = (pose((0.0, 0.0, 0.0)), pose((100.0, 0.0, 0.0)), pose((0.0, 100.0, 30.0)))
PLACES = [(0, 0, 0), (EAST_DEG, 0, 0.0008), (0, NORTH_DEG, 30.0008)]
"""Longitude, latitude and altitude."""
TIMES = [f"2024-05-06T07:08:{second}.250000Z" for second in ("09", "10", "11")]
GPX = "{http://www.topografix.com/GPX/1/1}"
KML = "{http://www.opengis.net/kml/2.2}"
GX = "{http://www.google.com/kml/ext/2.2}"


def close(found) -> bool:
    found = np.array(found, dtype=float)
    assert found.shape == (3, 3)
    return np.allclose(found[:, :2], np.array(PLACES)[:, :2], atol=2e-10, rtol=0) and np.allclose(
        found[:, 2], np.array(PLACES)[:, 2], atol=1e-4, rtol=0
    )


def written(kind, tmp_path, **changes):
    target = tmp_path / "track"
    notes = export_map(exported(made_map(*POSES, **changes)), kind, target)
    return target, notes


def test_geojson(tmp_path):
    target, notes = written("geojson", tmp_path)
    collection = json.loads(target.read_text())
    line, *points = collection["features"]
    assert (collection["type"], line["type"], line["geometry"]["type"]) == (
        "FeatureCollection",
        "Feature",
        "LineString",
    )
    assert close(line["geometry"]["coordinates"])
    assert close([point["geometry"]["coordinates"] for point in points])
    # The nose points to the north: 1 m forward is north, 2 m left is west.
    assert points[1]["properties"] == {
        "name": "P1.jpg",
        "stamp_ns": 1_714_979_290_250_000_000,
        "time": TIMES[1],
        "std_east_m": 2.0,
        "std_north_m": 1.0,
        "std_up_m": 3.0,
        "part": 0,
    }
    assert notes == ()


def test_gpx(tmp_path):
    target, _ = written("gpx", tmp_path)
    root = ET.parse(target).getroot()
    assert root.tag == f"{GPX}gpx"
    assert root.get("version") == "1.1"
    assert root.get("creator").startswith("slam ")
    points = root.findall(f"{GPX}trk/{GPX}trkseg/{GPX}trkpt")
    assert close([(p.get("lon"), p.get("lat"), p.findtext(f"{GPX}ele")) for p in points])
    assert [p.findtext(f"{GPX}time") for p in points] == TIMES
    # The schema prescribes the order.
    assert [child.tag for child in points[0]] == [f"{GPX}ele", f"{GPX}time", f"{GPX}name"]


def test_kml(tmp_path):
    target, _ = written("kml", tmp_path)
    root = ET.parse(target).getroot()
    assert root.tag == f"{KML}kml"
    track = root.find(f".//{GX}Track")
    assert close([coord.text.split(" ") for coord in track.findall(f"{GX}coord")])
    assert [when.text for when in track.findall(f"{KML}when")] == TIMES
    assert track.findtext(f"{KML}altitudeMode") == "absolute"
    points = root.findall(f".//{KML}Folder/{KML}Placemark")
    assert close([p.findtext(f"{KML}Point/{KML}coordinates").split(",") for p in points])
    data = {d.get("name"): float(d.findtext(f"{KML}value")) for d in points[1].iter(f"{KML}Data")}
    assert data == {"std_east_m": 2.0, "std_north_m": 1.0, "std_up_m": 3.0}


@pytest.mark.parametrize("kind", ["gpx", "kml", "geojson"])
def test_stamps_from_the_start_of_a_recorder_are_no_times(kind, tmp_path):
    target, notes = written(kind, tmp_path, epoch_ns=5_000_000_000)
    text = target.read_text()
    assert "1970" not in text
    assert "<when>" not in text
    assert "<time>" not in text
    if kind == "kml":
        line = ET.fromstring(text).find(f".//{KML}LineString/{KML}coordinates")
        assert close([place.split(",") for place in line.text.split(" ")])
    assert kind == "geojson" or ["no times" in note for note in notes] == [True]


@pytest.mark.parametrize("kind", ["gpx", "kml", "geojson"])
def test_names_with_the_signs_of_markup_and_unknown_covariances(kind, tmp_path):
    names = ('a<b>&"c".jpg', "line\nbreak\x01.jpg", "ü.jpg")
    unknown = np.full((3, 6, 6), np.nan)
    target, _ = written(kind, tmp_path, frame_names=names, covariances=unknown)
    text = target.read_text(encoding="utf-8")
    assert "NaN" not in text
    assert "nan" not in text.lower().replace("name", "")
    if kind == "geojson":
        points = json.loads(text)["features"][1:]
        found = [point["properties"]["name"] for point in points]
        assert points[0]["properties"]["std_up_m"] is None
    else:
        root = ET.fromstring(text)
        tag = f"{GPX}trkpt/{GPX}name" if kind == "gpx" else f"{KML}Folder/{KML}Placemark/{KML}name"
        found = [element.text for element in root.findall(f".//{tag}")]
    assert found == ['a<b>&"c".jpg', "line�break�.jpg", "ü.jpg"]


@pytest.mark.parametrize(("kind", "tag"), [("gpx", f"{GPX}trkseg"), ("kml", f"{GX}Track")])
def test_parts_of_the_map_are_not_joined_by_a_line(kind, tag, tmp_path):
    target, _ = written(kind, tmp_path, component=np.array([0, 0, 1]))
    assert len(list(ET.parse(target).getroot().iter(tag))) == 2


@pytest.mark.parametrize("first_deg", [179.9999, -179.9999])
def test_geojson_cuts_a_line_at_the_meridian_of_180_degrees(first_deg, tmp_path):
    """Source: RFC 7946, section 3.1.9. Uncut it would go around the Earth."""
    side = 20.0 if first_deg > 0 else -20.0
    poses = [pose((x, y, 10.0)) for x, y in ((0.0, 0.0), (side, 2.0), (2 * side, 4.0))]
    estimate = made_map(*poses, origin=GeoOrigin(0.0, first_deg, 0.0))
    export_map(exported(estimate), "geojson", tmp_path / "map")
    line = json.loads((tmp_path / "map").read_text())["features"][0]["geometry"]
    assert line["type"] == "MultiLineString"
    assert [len(piece) for piece in line["coordinates"]] == [2, 3]
    here, there = line["coordinates"][0][-1], line["coordinates"][1][0]
    assert here[0] == -there[0] == np.copysign(180.0, first_deg)
    assert here[1:] == there[1:]
    cross_m = (180 - abs(first_deg)) / 360 * 2 * np.pi * 6378137.0
    assert here[1] == pytest.approx(cross_m / 20 * 2 / 110574.0, rel=1e-3)


def test_no_height_above_the_floor_is_told_as_an_altitude(tmp_path):
    """Without any altitude, only KML has a word for heights above the ground: 28 and 58 m over this floor."""
    unknown = {"origin": GeoOrigin(0.0, 0.0, 0.0, altitude_known=False), "floor_z_m": -28.0}
    target, notes = written("geojson", tmp_path, **unknown)
    line, *points = (
        feature["geometry"]["coordinates"] for feature in json.loads(target.read_text())["features"]
    )
    assert [len(place) for place in (*line, *points)] == [2] * 6
    assert "no altitude is recorded" in notes[0]
    target.unlink()
    root = ET.parse(written("gpx", tmp_path, **unknown)[0]).getroot()
    assert list(root.iter(f"{GPX}trkpt"))
    assert not list(root.iter(f"{GPX}ele"))
    target.unlink()
    root = ET.parse(written("kml", tmp_path, **unknown)[0]).getroot()
    assert {mode.text for mode in root.iter(f"{KML}altitudeMode")} == {"relativeToGround"}
    heights = [float(coord.text.split()[2]) for coord in root.iter(f"{GX}coord")]
    assert heights == pytest.approx([28, 28, 58])


def test_a_line_without_altitudes_is_cut_at_180_degrees_too(tmp_path):
    origin = GeoOrigin(0.0, 179.9999, 0.0, altitude_known=False)
    target, _ = written("geojson", tmp_path, origin=origin)
    geometry = json.loads(target.read_text())["features"][0]["geometry"]
    assert geometry["type"] == "MultiLineString"
    assert {len(place) for piece in geometry["coordinates"] for place in piece} == {2}
