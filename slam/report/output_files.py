"""The files beside a report, with what each is for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class OutputFile:
    """A file in the folder of the report."""

    name: str
    what: str


_FILES = (
    OutputFile(
        "map.html",
        "interactive map for a browser: move, compare before and after, measure distances and areas",
    ),
    OutputFile("mosaic.png", "the map as a picture"),
    OutputFile(
        "mosaic.tif",
        "the map for GIS programs such as QGIS: a GeoTIFF, on Earth with GPS or surveyed points",
    ),
    OutputFile("mosaic_chain.png", "the map before: each picture placed by the one before it"),
    OutputFile(
        "elevation.png",
        "heights over the floor, as far as they were measured, as a picture",
    ),
    OutputFile("elevation.tif", "the same heights for GIS programs"),
    OutputFile("mosaic_quality.png", "how reliable each piece of the map is, as a picture"),
    OutputFile("mosaic_quality.tif", "the same for GIS programs: pictures, uncertainty, agreement"),
    OutputFile("evaluation_trajectory.png", "the paths beside the true one"),
    OutputFile("evaluation_error.png", "errors against the truth over time"),
    OutputFile("mosaic_crs.tif", "the map in UTM, or in the coordinate system of --crs"),
    OutputFile("elevation_crs.tif", "the heights in UTM, or in the coordinate system of --crs"),
    OutputFile("altitude_crs.tif", "altitudes of the ground, in UTM or that system and their height system"),
    OutputFile("mosaic_quality_crs.tif", "how reliable the map is, in UTM, or in the system of --crs"),
    OutputFile("map.mcap", "the map for Foxglove and Rerun"),
    OutputFile("trajectory.tum", "where each keyframe was taken, as text"),
    OutputFile("loops.csv", "each link between two visits, kept or rejected, with the reason"),
    OutputFile("graph.g2o", "the pose graph for other programs"),
    OutputFile("summary.json", "all figures for programs"),
    OutputFile("evaluation.json", "the errors against the truth for programs"),
)


def output_files(folder: Path | None) -> tuple[OutputFile, ...]:
    """Return the files that exist, those for a person first; none without a folder."""
    if folder is None:
        return ()
    return tuple(file for file in _FILES if (folder / file.name).is_file())
