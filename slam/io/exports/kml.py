"""The track and the keyframes as KML 2.2, with times by Google's extension ``gx:Track``.

Heights are altitudes, or those above the ground if no altitude is known. Source: OGC 07-147r2, "KML" (2008);
Google, "KML Reference".
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from slam.io.exports.exported_map import ExportedMap
from slam.io.exports.xml_text import NO_TIME, child, write_xml

_NAMESPACES = {"xmlns": "http://www.opengis.net/kml/2.2", "xmlns:gx": "http://www.google.com/kml/ext/2.2"}
_AXES = ("east", "north", "up")


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write one track for each part of the map, and one point with its uncertainty for each keyframe."""
    frames = exported.keyframes
    latitude, longitude, altitude = exported.geodetic(frames)
    height = altitude if exported.estimate.altitude_known else exported.heights_above_floor_m
    places = [
        (f"{lon:.10f}", f"{lat:.10f}", f"{up:.4f}")
        for lon, lat, up in zip(longitude, latitude, height, strict=True)
    ]
    root = ET.Element("kml", _NAMESPACES)
    document = child(root, "Document")
    child(document, "name", exported.name)
    child(document, "description", exported.description)
    for part in frames.parts():
        _track(document, exported, part.tolist(), places)
    folder = child(document, "Folder")
    child(folder, "name", "keyframes")
    for k, place in enumerate(places):
        _point(folder, exported, k, place)
    write_xml(root, target)
    return () if frames.has_calendar_time else (NO_TIME,)


def _track(
    parent: ET.Element, exported: ExportedMap, part: list[int], places: list[tuple[str, str, str]]
) -> None:
    placemark = child(parent, "Placemark")
    child(placemark, "name", exported.name)
    if not exported.keyframes.has_calendar_time:
        line = child(placemark, "LineString")
        child(line, "altitudeMode", _mode(exported))
        child(line, "coordinates", " ".join(",".join(places[k]) for k in part))
        return
    track = child(placemark, "gx:Track")
    child(track, "altitudeMode", _mode(exported))
    for k in part:
        child(track, "when", exported.keyframes.utc(k))
    for k in part:
        child(track, "gx:coord", " ".join(places[k]))


def _mode(exported: ExportedMap) -> str:
    return "absolute" if exported.estimate.altitude_known else "relativeToGround"


def _point(parent: ET.Element, exported: ExportedMap, k: int, place: tuple[str, str, str]) -> None:
    frames = exported.keyframes
    stds_m = frames.position_stds_m[k]
    placemark = child(parent, "Placemark")
    child(placemark, "name", frames.names[k])
    if frames.has_calendar_time:
        child(child(placemark, "TimeStamp"), "when", frames.utc(k))
    extended = child(placemark, "ExtendedData")
    for axis, std_m in zip(_AXES, stds_m.tolist(), strict=True):
        if np.isfinite(std_m):
            child(ET.SubElement(extended, "Data", name=f"std_{axis}_m"), "value", f"{std_m:.4f}")
    point = child(placemark, "Point")
    child(point, "altitudeMode", _mode(exported))
    child(point, "coordinates", ",".join(place))
