"""The files beside a report, with what each is for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_FILES = (
    (
        "map.html",
        "interactive map for a browser: move, compare before and after, measure distances and areas",
    ),
    ("mosaic.png", "the map as a picture"),
    ("mosaic.tif", "the map for GIS programs such as QGIS: a GeoTIFF that knows its place and scale"),
    ("mosaic_chain.png", "the map before: each picture placed by the one before it"),
    ("elevation.png", "height of the ground, as a picture"),
    ("elevation.tif", "height of the ground for GIS programs"),
    ("mosaic_quality.png", "how reliable each piece of the map is, as a picture"),
    ("mosaic_quality.tif", "the same for GIS programs: pictures, uncertainty and agreement of each piece"),
    ("evaluation_trajectory.png", "the paths beside the true one"),
    ("evaluation_error.png", "errors against the truth over time"),
    ("map.mcap", "the map for Foxglove and Rerun"),
    ("trajectory.tum", "where each keyframe was taken, as text"),
    ("loops.csv", "each link between two visits, kept or rejected, with the reason"),
    ("graph.g2o", "the pose graph for other programs"),
    ("summary.json", "all figures for programs"),
    ("evaluation.json", "the errors against the truth for programs"),
)


@dataclass(frozen=True)
class OutputFile:
    """A file in the folder of the report."""

    name: str
    what: str


def output_files(folder: Path | None) -> tuple[OutputFile, ...]:
    """Return the files that exist, those for a person first; none without a folder."""
    if folder is None:
        return ()
    return tuple(OutputFile(name, what) for name, what in _FILES if (folder / name).is_file())
