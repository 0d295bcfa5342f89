"""The known formats of exports. Each is one module with ``write``, and one row of ``FORMATS``.

A module writes a map to a path that does not exist yet: ``write(exported, target)`` returns one line for
everything that the format cannot hold. The path is a working copy, which is moved into place afterwards.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from slam.core.errors import InputError
from slam.io.atomic import atomic_file, atomic_folder
from slam.io.files import refusal

if TYPE_CHECKING:
    from slam.io.exports.exported_map import ExportedMap


ExportKind = Literal[
    "geo", "geojson", "gpx", "kml", "colmap", "euroc", "tum", "mcap", "ros2", "exif", "geotiff"
]
"""Names of the formats, as the command line lists them."""


@dataclass(frozen=True)
class Need:
    """Something that a map must have for a format."""

    is_met: Callable[[ExportedMap], bool]
    lack: str
    """The missing thing, as the end of "the map ..."."""
    advice: str


PLACE = Need(
    lambda exported: exported.estimate.origin is not None,
    "has no place on Earth",
    "make it from a flight with gps0, or from photographs with positions; tum, euroc and mcap need no place",
)
CAMERA = Need(
    lambda exported: exported.estimate.camera is not None,
    "was made without pictures",
    "give the output of slam optimize of a flight with pictures",
)
PHOTOGRAPHS = Need(
    lambda exported: exported.photos is not None,
    "does not hold the photographs",
    "name their folder with --photos",
)


@dataclass(frozen=True)
class ExportFormat:
    """A format, and what it needs."""

    name: ExportKind
    description: str
    """For the help: what it is, or who reads it."""
    module: str
    """Module in this package whose ``write(exported, target)`` writes it."""
    ending: str
    """End of the default name, after the name of the output folder."""
    needs: tuple[Need, ...] = ()
    is_folder: bool = False
    shows_pictures: bool = False
    """Whether it holds the pictures of a flight that is given."""


FORMATS: tuple[ExportFormat, ...] = (
    ExportFormat(
        "geo", "positions and angles of the pictures for OpenDroneMap", "geo", "_geo.txt", (PLACE, CAMERA)
    ),
    ExportFormat("geojson", "track and keyframes for GIS", "geojson", ".geojson", (PLACE,)),
    ExportFormat("gpx", "track for GPS programs", "gpx", ".gpx", (PLACE,)),
    ExportFormat("kml", "track and keyframes for Google Earth", "kml", ".kml", (PLACE,)),
    ExportFormat(
        "colmap", "cameras as a text model of COLMAP", "colmap", "_colmap", (CAMERA,), is_folder=True
    ),
    ExportFormat("euroc", "truth of the EuRoC data set", "euroc", "_euroc.csv"),
    ExportFormat("tum", "poses of the TUM RGB-D benchmark", "tum", ".tum"),
    ExportFormat("mcap", "map for Foxglove and Rerun", "mcap", ".mcap", shows_pictures=True),
    ExportFormat("ros2", "ROS 2 bag", "ros2", "_ros2", is_folder=True),
    ExportFormat(
        "exif",
        "copies of the photographs with positions",
        "exif",
        "_photos",
        (PLACE, CAMERA, PHOTOGRAPHS),
        is_folder=True,
    ),
    ExportFormat(
        "geotiff",
        "mosaic and elevation in UTM or EPSG:n",
        "geotiff",
        "_geotiff",
        (PLACE, CAMERA),
        is_folder=True,
    ),
)


def default_target(folder: Path, name: ExportKind) -> Path:
    """Return the path beside an output folder that is written without ``--out``."""
    folder = Path(os.path.realpath(folder))
    return folder.with_name(folder.name + _format(name).ending)


def shows_pictures(name: ExportKind) -> bool:
    """Return whether a format holds the pictures of a flight that is given."""
    return _format(name).shows_pictures


def export_map(exported: ExportedMap, name: ExportKind, target: Path) -> tuple[str, ...]:
    """Write a map in the format ``name``, and return one line for everything that the format cannot hold.

    Raises ``InputError`` where the map lacks what the format needs, no keyframe is placed, or ``target``
    exists or cannot be written.
    """
    known = _format(name)
    for need in known.needs:
        if not need.is_met(exported):
            raise InputError(f"--to {name}: the map {need.lack}; {need.advice}")
    has_photos = exported.photos is not None or exported.flight is not None
    if has_photos and PHOTOGRAPHS not in known.needs and not known.shows_pictures:
        raise InputError(f"--photos: --to {name} writes no photographs; leave --photos out")
    if not len(exported.keyframes):
        raise InputError(f"--to {name}: no keyframe of the map is placed; summary.json has the reasons")
    if target.exists() or target.is_symlink():
        raise refusal(target, "exists already", "name another place with --out, or remove it")
    write: Callable[[ExportedMap, Path], tuple[str, ...]]
    write = import_module(f"slam.io.exports.{known.module}").write
    with atomic_folder(target) if known.is_folder else atomic_file(target) as working:
        notes = write(exported, working)
    return (*exported.notes(), *notes)


def _format(name: ExportKind) -> ExportFormat:
    return next(known for known in FORMATS if known.name == name)
