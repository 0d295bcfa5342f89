"""The track and the keyframes as GeoJSON.

Coordinates are longitude, latitude, and altitude if one is known. A line across the meridian of 180 degrees
is cut there. Source: RFC 7946 (2016), sections 3.1, 3.1.9 and 4.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from slam.io.exports.exported_map import ExportedMap

_METRE_DIGITS = 4
_DIGITS = (10, 10, _METRE_DIGITS)
"""Decimals of longitude, latitude and altitude: a tenth of a millimetre or less."""


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write one line for each part of the track, and one point for each keyframe."""
    frames = exported.keyframes
    latitude, longitude, altitude = exported.geodetic(frames)
    coordinates = [
        [round(value, digits) for value, digits in zip(place, _DIGITS, strict=True) if np.isfinite(value)]
        for place in np.column_stack([longitude, latitude, altitude]).tolist()
    ]
    features = [
        _feature(*_line([coordinates[k] for k in part]), {"name": exported.name})
        for part in frames.parts()
        if len(part) > 1
    ]
    features += [_feature("Point", coordinates[k], _properties(exported, k)) for k in range(len(frames))]
    collection = {"type": "FeatureCollection", "description": exported.description, "features": features}
    target.write_text(json.dumps(collection, allow_nan=False, indent=1) + "\n", encoding="utf-8")
    return ()


def _line(coordinates: list[list[float]]) -> tuple[str, Any]:
    """Return the kind and the coordinates of a line, cut where it crosses the meridian of 180 degrees."""
    pieces = [coordinates[:1]]
    for here, there in pairwise(coordinates):
        if abs(there[0] - here[0]) > 180:
            side = 180.0 if here[0] > 0 else -180.0
            share = (side - here[0]) / (there[0] + 2 * side - here[0])
            others = [
                round(a + share * (b - a), digits)
                for a, b, digits in zip(here[1:], there[1:], _DIGITS[1:], strict=False)
            ]
            pieces[-1].append([side, *others])
            pieces.append([[-side, *others]])
        pieces[-1].append(there)
    return ("LineString", pieces[0]) if len(pieces) == 1 else ("MultiLineString", pieces)


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _properties(exported: ExportedMap, k: int) -> dict[str, Any]:
    frames = exported.keyframes
    stds_m = zip(("std_east_m", "std_north_m", "std_up_m"), frames.position_stds_m[k].tolist(), strict=True)
    return {
        "name": frames.names[k],
        "stamp_ns": int(frames.stamps_ns[k]),
        **({"time": frames.utc(k)} if frames.has_calendar_time else {}),
        **{name: round(std, _METRE_DIGITS) if np.isfinite(std) else None for name, std in stds_m},
        "part": int(frames.component[k]),
    }
