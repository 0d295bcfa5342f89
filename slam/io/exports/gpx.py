"""The track as GPX 1.1. Source: Topografix, "GPX 1.1 Schema Documentation"."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from slam.core.version import VERSION
from slam.io.exports.exported_map import ExportedMap
from slam.io.exports.xml_text import NO_TIME, child, write_xml


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write one segment for each part of the track, with one point for each keyframe."""
    frames = exported.keyframes
    latitude, longitude, altitude = exported.geodetic(frames)
    has_time = frames.has_calendar_time
    root = ET.Element(
        "gpx", version="1.1", creator=f"slam {VERSION}", xmlns="http://www.topografix.com/GPX/1/1"
    )
    metadata = child(root, "metadata")
    child(metadata, "name", exported.name)
    child(metadata, "desc", exported.description)
    track = child(root, "trk")
    child(track, "name", exported.name)
    for part in frames.parts():
        segment = child(track, "trkseg")
        for k in part.tolist():
            point = ET.SubElement(segment, "trkpt", lat=f"{latitude[k]:.10f}", lon=f"{longitude[k]:.10f}")
            if np.isfinite(altitude[k]):
                child(point, "ele", f"{altitude[k]:.4f}")
            if has_time:
                child(point, "time", frames.utc(k))
            child(point, "name", frames.names[k])
    write_xml(root, target)
    return () if has_time else (NO_TIME,)
