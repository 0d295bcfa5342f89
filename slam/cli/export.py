"""``slam export``: write a map in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slam.cli.options import QUIET
from slam.io.exports.formats import FORMATS, ExportKind

_FOLDER = typer.Argument(metavar="DIR", help="The folder that slam optimize or estimate wrote.")
_TO = typer.Option(
    "--to",
    metavar="KIND",
    help="; ".join(f"{known.name}: {known.description}" for known in FORMATS) + ".",
    show_default=False,
)
_OUT = typer.Option(
    "--out",
    metavar="PATH",
    help="The file or folder to write; must not exist yet. Default: beside DIR, with its name.",
    show_default=False,
)
_PHOTOS = typer.Option(
    "--photos",
    metavar="FLIGHT",
    help="The photographs or the flight that the map was made of: exif needs them, and mcap shows its "
    "pictures; they are not changed.",
    show_default=False,
)
_CRS = typer.Option(
    "--crs",
    metavar="SYSTEM",
    help="Coordinate system of geotiff: utm (the zone of the map's origin), or EPSG: and a number.",
)


def export(
    folder: Annotated[Path, _FOLDER],
    to: Annotated[ExportKind, _TO],
    out: Annotated[Path | None, _OUT] = None,
    photos: Annotated[Path | None, _PHOTOS] = None,
    crs: Annotated[str, _CRS] = "utm",
    quiet: Annotated[bool, QUIET] = False,
) -> None:
    """Write a map for another program: GIS, Google Earth, OpenDroneMap, COLMAP, Foxglove, ROS and others."""
    from slam.cli.console import Screen
    from slam.cli.source import open_flight
    from slam.io.estimate import read_estimate
    from slam.io.exports.exported_map import ExportedMap
    from slam.io.exports.formats import default_target, export_map, shows_pictures

    screen = Screen(quiet)
    target = default_target(folder, to) if out is None else out
    with screen.progress() as progress:
        flight = None
        if photos is not None and shows_pictures(to):
            flight, photos = open_flight(photos, progress)[0], None
        exported = ExportedMap(read_estimate(folder), photos, progress, folder, crs, flight)
        notes = export_map(exported, to, target)
    for note in notes:
        screen.line(note)
    screen.files([target])
