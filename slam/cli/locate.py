"""``slam locate``: find where further pictures were taken in an existing map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam.cli.options import JSON, OUT, PICTURE_RATE, QUIET, TOPICS, request_of

if TYPE_CHECKING:
    from slam.core.figure_table import FigureTable
    from slam.core.streams import Image
    from slam.mapping.relocation import Location, Relocalizer

_PICTURES = typer.Argument(metavar="PICTURE", help="Pictures of the map's camera.", show_default=False)
_MAP = typer.Option("--map", metavar="DIR", help="The folder that slam optimize wrote.")
_FLIGHT = typer.Option(
    "--flight", metavar="FLIGHT", help="The flight that the map was made from; repeated for each flight."
)
_HEADER = "picture,reason,tx,ty,tz,qx,qy,qz,qw,std_x,std_y,std_z,points,keyframe"


def locate(
    pictures: Annotated[list[Path], _PICTURES],
    map_folder: Annotated[Path, _MAP],
    flights: Annotated[list[Path], _FLIGHT],
    out: Annotated[Path, OUT],
    topic: Annotated[list[str] | None, TOPICS] = None,
    picture_rate: Annotated[float | None, PICTURE_RATE] = None,
    quiet: Annotated[bool, QUIET] = False,
    as_json: Annotated[bool, JSON] = False,
) -> None:
    """Find where pictures were taken in a map, with the uncertainty of each."""
    from slam.cli.console import Screen
    from slam.cli.mapped import mapped_flight
    from slam.cli.output_folder import output_folder
    from slam.core.summary import json_text
    from slam.io.estimate import read_estimate
    from slam.mapping.relocation import Relocalizer

    screen, request = Screen(quiet, as_json), request_of(topic, picture_rate)
    decoded = _first_readable(pictures)
    estimate = read_estimate(map_folder)
    flight = mapped_flight(map_folder, flights, request)
    with output_folder(out, [map_folder, *pictures]) as folder, screen.progress() as progress:
        relocalizer = Relocalizer(estimate, flight, progress=progress)
        found = []
        for done, path in enumerate(pictures, 1):
            found.append((path, _located(relocalizer, path, decoded.pop(path, None))))
            progress("locate", done, len(pictures))
        (folder / "locations.csv").write_text(locations_csv(found), encoding="utf-8")
        reasons = [location.reason for _, location in found if not location.found]
        record = {
            "status": "ok"
            if not reasons
            else f"{len(reasons)} of {len(found)} pictures not found; locations.csv says why",
            "pictures": len(found),
            "found": len(found) - len(reasons),
            "rejected": {reason: reasons.count(reason) for reason in dict.fromkeys(reasons)},
        }
        (folder / "summary.json").write_text(json_text(record), encoding="utf-8")
    screen.json_file(out / "summary.json")
    screen.table(_table(found, estimate.metric))
    screen.files([out / "locations.csv"])


def _first_readable(pictures: Sequence[Path]) -> dict[Path, Image]:
    """Return the first picture that can be read. Raises ``InputError`` with the reasons if none can."""
    from backend.wording import either
    from slam.core.errors import InputError
    from slam.core.names import listed
    from slam.io.files import shown
    from slam.io.images import read_image
    from slam.io.picture_headers import UnreadableImageError

    reasons = []
    for path in pictures:
        try:
            return {path: read_image(path)}
        except UnreadableImageError as reason:
            reasons.append(f"{shown(str(path))} ({reason})")
    which = either(len(reasons), "the picture cannot", "none of the pictures can")
    raise InputError(f"{which} be read: {listed(reasons)}; give complete PNG, JPEG or TIFF files")


def locations_csv(found: Sequence[tuple[Path, Location]]) -> str:
    """Return the content of locations.csv: one row for each picture."""
    from slam.io.files import shown

    rows = [",".join([_quoted(shown(str(path))), *_row(location)]) for path, location in found]
    return "\n".join([_HEADER, *rows, ""])


def _located(relocalizer: Relocalizer, path: Path, decoded: Image | None) -> Location:
    from slam.io.images import read_image
    from slam.io.picture_headers import UnreadableImageError
    from slam.mapping.relocation import nowhere

    try:
        return relocalizer.locate(read_image(path) if decoded is None else decoded)
    except UnreadableImageError as reason:
        return nowhere(f"unreadable: {reason}")


def _row(location: Location) -> list[str]:
    import numpy as np
    from scipy.spatial.transform import Rotation

    if not location.found:
        return [_quoted(location.reason), *[""] * 12]
    R, p = location.w_T_b[:3, :3], location.w_T_b[:3, 3]
    std = np.sqrt(np.diag(R @ location.covariance[3:, 3:] @ R.T))
    figures = [*p, *Rotation.from_matrix(R).as_quat(), *std]
    return ["", *(f"{x:.9g}" for x in figures), str(location.points), str(location.keyframes[0])]


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'


def _table(found: list[tuple[Path, Location]], metric: bool) -> FigureTable:
    from slam.core.figure_table import FigureTable
    from slam.core.units import length, unit
    from slam.io.files import shown
    from slam.report.facts import position_sigma_m

    def row(path: Path, location: Location) -> tuple[str, ...]:
        if not location.found:
            return shown(path.name), location.reason, "", ""
        place = ", ".join(f"{x:.3f}" for x in location.w_T_b[:3, 3])
        sigma_m = float(position_sigma_m(location.covariance[None])[0])
        return shown(path.name), place, f"± {length(sigma_m, metric)}", str(location.points)

    columns = ("picture", f"x, y, z [{unit(metric)}]", "1σ", "points")
    return FigureTable("Where the pictures were taken", columns, tuple(row(*pair) for pair in found))
