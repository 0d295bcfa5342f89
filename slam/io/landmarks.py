"""Reading of ``landmarks.csv`` (surveyed points of the floor) and of the pairs of them in ``flight.yaml``."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.io.files import brief, read_text, refusal
from slam.io.landmark_views import has_views, image_column
from slam.io.sensor_yaml import YamlFile

Array = NDArray[np.float64]

HEADER = ("name", "x [m]", "y [m]", "z [m]")
MAX_BYTES = 1 << 24


def read_landmarks(root: Path) -> tuple[dict[str, Array], list[str]]:
    """Return a map of names to (3,) metres in the world. Raises ``InputError`` with the faulty line.

    Points with a picture are control points, and those of a table with a coordinate system are not in the
    world: they are left out (`slam.io.landmark_views`).
    """
    path = root / "landmarks.csv"
    header = ",".join(HEADER)
    text, notes = read_text(path, root, MAX_BYTES)
    pictures = image_column(text)
    if pictures is None and has_views(text):
        return {}, notes
    rows = csv.reader(io.StringIO(text.replace("\r\n", "\n").replace("\r", "\n")))
    landmarks: dict[str, Array] = {}
    try:
        titles = [t.strip().lstrip("#").strip() for t in next(rows, [])]
        indices = [_column_index(titles, title) for title in HEADER]
        if None in indices:
            raise refusal(path, f"has the header {','.join(titles)[:80]!r}", f"write {header}", 1)
        for fields in rows:
            if any(f.strip() for f in fields) and not _shows(fields, pictures):
                name, point = _landmark(
                    path, rows.line_num, fields, [p for p in indices if p is not None], len(titles)
                )
                if name in landmarks:
                    raise refusal(path, f"names {name[:40]!r} twice", "keep one of them", rows.line_num)
                landmarks[name] = point
    except csv.Error as error:
        raise refusal(path, f"is not a csv file ({error})", f"write {header}", rows.line_num) from None
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


def _shows(fields: list[str], pictures: int | None) -> bool:
    """Return whether a row has a picture in its column ``pictures``; None for a table without."""
    return pictures is not None and len(fields) > pictures and bool(fields[pictures].strip())


def _column_index(titles: list[str], title: str) -> int | None:
    """Return the index of a column, without a unit or with the correct one."""
    for k, found in enumerate(titles):
        if found == title or found == title.split(" ")[0]:
            return k
    return None


def _landmark(path: Path, line: int, fields: list[str], indices: list[int], width: int) -> tuple[str, Array]:
    if len(fields) != width:
        raise refusal(path, f"has {len(fields)} fields instead of {width}", "repair the line", line)
    name = fields[indices[0]].strip()
    if not name:
        raise refusal(path, "has no name", "name the landmark", line)
    try:
        point = [float(fields[p]) for p in indices[1:]]
    except ValueError:
        point = [math.nan]
    if not all(map(math.isfinite, point)):
        raise refusal(path, f"has no finite x, y, z for {name[:40]!r}", "write three numbers", line)
    return name, np.array(point)
