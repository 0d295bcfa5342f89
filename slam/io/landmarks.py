"""Reading of ``landmarks.csv`` (surveyed points of the floor) and of the pairs of them in ``flight.yaml``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.core.messages import Message
from slam.io.files import brief, read_text, refusal
from slam.io.landmark_table import LandmarkTable
from slam.io.sensor_yaml import YamlFile

Array = NDArray[np.float64]

MAX_BYTES = 1 << 24


def read_landmarks(root: Path) -> tuple[dict[str, Array], list[Message]]:
    """Return a map of names to (3,) metres in the world. Raises ``InputError`` with the faulty line.

    Points with a picture are control points, and those of a table with a coordinate system are not in the
    world: they are left out (`slam.io.landmark_views`).
    """
    path = root / "landmarks.csv"
    text, notes = read_text(path, root, MAX_BYTES)
    table = LandmarkTable.of(path, text)
    if table.has_views and not table.is_in_world:
        return {}, notes
    table.check_metres()
    landmarks: dict[str, Array] = {}
    for line, fields in table.rows():
        if table.shows(fields):
            continue
        cells = table.cells(line, fields)
        name = table.name(line, cells)
        point = _point(path, line, cells)
        if name in landmarks:
            raise refusal(path, f"names {name[:40]!r} twice", "keep one of them", line)
        landmarks[name] = point
    return landmarks, notes


def check_pairs(metadata: YamlFile, key: str, landmarks: dict[str, Array]) -> tuple[tuple[str, str], ...]:
    """Return the pairs of landmark names from ``flight.yaml``. Raises ``InputError`` for an unknown name."""
    value = metadata.fields.get(key, [])
    if value == "":
        return ()
    do = "write [[A, B], ...] with names of landmarks.csv"
    if not isinstance(value, list):
        raise metadata.refuse(key, "is not a list of pairs", do)
    pairs = []
    for pair in value:
        if not (isinstance(pair, list) and len(pair) == 2 and all(isinstance(p, str) for p in pair)):
            raise metadata.refuse(key, f"holds {brief(pair, 40)!r}", do)
        first, second = str(pair[0]), str(pair[1])
        for name in (first, second):
            if name not in landmarks:
                raise metadata.refuse(key, f"names {brief(name, 40)!r}, which is not in landmarks.csv", do)
        pairs.append((first, second))
    return tuple(pairs)


def _point(path: Path, line: int, cells: Mapping[str, str]) -> Array:
    try:
        point = [float(cells[axis]) for axis in "xyz"]
    except ValueError:
        point = [math.nan]
    if not all(map(math.isfinite, point)):
        what = f"has no finite x, y, z for {cells['name'][:40]!r}"
        raise refusal(path, what, "write three numbers", line)
    return np.array(point)
