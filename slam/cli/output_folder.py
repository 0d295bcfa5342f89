"""The content of output folders, and the check whether a new run may replace one.

``slam.io.atomic`` makes a folder appear in one step, and lets only one run at a time write it.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from slam.cli.supervisor import LESS_MEMORY
from slam.core.errors import InputError, explain, one_line
from slam.core.version import VERSION
from slam.experiments.registry import NAMES as EXPERIMENTS
from slam.io.atomic import atomic_folder, checkpoint_path, is_working_folder, was_killed
from slam.io.files import OUTPUT_MARKER, read_bytes

MARKER_NAME = OUTPUT_MARKER
"""Hidden file of every output: the version of slam, and the names of the files that it wrote."""

OPTIMIZE_NAMES = (
    MARKER_NAME,
    "trajectory.tum",
    "graph.g2o",
    "estimate.npz",
    "loops.csv",
    "mosaic.tif",
    "mosaic.png",
    "mosaic.pgw",
    "mosaic_chain.png",
    "mosaic_quality.tif",
    "mosaic_quality.png",
    "elevation.tif",
    "elevation.png",
    "report.html",
    "summary.json",
    "mosaic_chain.pgw",
    "map.html",
)
"""Files that ``slam optimize`` writes; a new one is added at the end."""

MODEL_NAME = "model.toml"
"""Model of the instruments from ``--model``; the commands that read the map need it too."""

RASTERS_IN_SYSTEM = {
    "mosaic.tif": "mosaic_crs.tif",
    "mosaic_quality.tif": "mosaic_quality_crs.tif",
    "elevation.tif": "elevation_crs.tif",
    "altitude.tif": "altitude_crs.tif",
}
"""Raster of a map on Earth -> its copy in UTM, or in the system that ``slam optimize --crs`` names."""

MAP_MCAP = "map.mcap"
"""The map for Foxglove and Rerun, from ``slam optimize --mcap``."""

ESTIMATE_NAMES = (MARKER_NAME, "trajectory.tum", "estimate.npz", "estimate.png", "summary.json")
"""Files that ``slam estimate`` writes."""

EVALUATE_NAMES = ("evaluation.json", "evaluation_trajectory.png", "evaluation_error.png")
"""Files that ``slam evaluate`` adds."""

LOCATE_NAMES = (MARKER_NAME, "locations.csv", "summary.json")
"""Files that ``slam locate`` writes."""

LOOPS_NAMES = (MARKER_NAME, "loops.json", "loops.png", "summary.json")
"""Files that ``slam loops`` writes."""

REPLAY_NAMES = (MARKER_NAME, "replay.png", "summary.json")
"""Files that ``slam replay`` writes."""

REPRODUCE_NAMES = (
    MARKER_NAME,
    "reproduce.html",
    "summary.json",
    *(f"{name}{suffix}" for name in EXPERIMENTS for suffix in (".json", ".png")),
)
"""Files that ``slam reproduce`` writes."""

CRITICISE_NAMES = (MARKER_NAME, "verdict.json", "extended.toml", "report.html", "summary.json")
"""Files that ``slam criticise`` writes."""

_SIGNS = {
    "optimize": "graph.g2o",
    "estimate": "estimate.png",
    "locate": "locations.csv",
    "loops": "loops.json",
    "replay": "replay.png",
    "reproduce": "reproduce.html",
    "criticise": "verdict.json",
}
"""Command -> a file that no other command writes."""

_VIEWER_FILES = (
    ".DS_Store",
    "Thumbs.db",
    "desktop.ini",
    *(
        f"{name}{ending}"
        for name in (*OPTIMIZE_NAMES, *RASTERS_IN_SYSTEM.values())
        if name.endswith((".tif", ".png"))
        for ending in (".aux.xml", ".ovr")
    ),
)
"""Files that viewers create, such as statistics and overviews of rasters; they may be deleted with the
output."""

_MAP_KEYS = ("status", "frames", "keyframes", "edges", "timing_s", "peak_rss_mb", "warnings")
_FIRST_MAP_NAMES = OPTIMIZE_NAMES[: OPTIMIZE_NAMES.index("summary.json") + 1]
"""Files that ``slam optimize`` wrote in version 0.1.0; a name that was added later stands behind them."""
_FIRST_VERSION = (
    (
        ("graph.g2o", "trajectory.tum", "estimate.npz", "loops.csv", "report.html"),
        (*_MAP_KEYS, "landmarks"),
        (*_FIRST_MAP_NAMES, MODEL_NAME),
    ),
    (("estimate.png", "trajectory.tum", "estimate.npz"), (*_MAP_KEYS, "channels"), ESTIMATE_NAMES),
    (("locations.csv",), ("status", "pictures", "found", "rejected"), LOCATE_NAMES),
    (("loops.json", "loops.png"), ("status", "name", "reference", "frames", "keyframes"), LOOPS_NAMES),
    (("replay.png",), ("flight", "model", "begin_s", "end_s", "started_from", "rollouts"), REPLAY_NAMES),
    (("reproduce.html",), ("seeds", "elapsed_s", "experiments"), REPRODUCE_NAMES),
    (
        ("verdict.json", "report.html"),
        ("status", "sentence", "flights", "dropped", "causes"),
        CRITICISE_NAMES,
    ),
)
"""Outputs of version 0.1.0, which wrote no marker: files that each has, keys of its summary.json, and all
names that it may have."""

_WAS_KILLED = (
    "the last run into this folder was killed before its end (exit code 137 and the kernel's log show why); "
    f"if memory ran out: {LESS_MEMORY}"
)
"""A control group with memory.oom.group kills all its processes: the run then cannot say it itself."""

_IS_KEPT = "what was computed is kept; the same command goes on with it, or run it with --no-resume"

_MARK = "summary.json"
"""File of every finished output."""

_MAX_JSON_BYTES = 16 << 20


@contextmanager
def output_folder(target: str | Path, inputs: Sequence[Path] = ()) -> Iterator[Path]:
    """Provide an empty folder; it becomes ``target`` when the block ends without an error.

    An earlier output in ``target`` stays until the new one is complete. Raises ``InputError`` where
    ``target`` is a file, holds something that slam did not write or one of the ``inputs`` of the run, is
    being written by another run, or cannot be written. A line on standard error reports that the last run
    into ``target`` was killed.
    """
    target = _checked(Path(target))
    for path in inputs:
        if target in (real := Path(os.path.realpath(path)), *real.parents):
            raise InputError(
                f"{target}: --out would replace {str(path)!r}, which the command reads; choose another --out"
            )
    _refuse_foreign(target, target)
    killed = was_killed(target)  # or it still runs, and is refused below
    built: Path | None = None
    try:
        with atomic_folder(target, may_replace=lambda folder: _refuse_foreign(folder, target)) as built:
            if killed:
                print(f"slam: {one_line(str(target))}: {_WAS_KILLED}", file=sys.stderr)
            yield built
            _write_marker(built)
    except BaseException:
        if built is not None and checkpoint_path(built).exists():
            print(f"slam: {one_line(str(target))}: {_IS_KEPT}", file=sys.stderr)
        raise


def is_output(folder: Path) -> bool:
    """Return whether a folder is a finished output of a command."""
    return (folder / _MARK).is_file()


def writer_of(folder: Path) -> str:
    """Return the command that wrote a finished output folder; empty for another folder."""
    if not is_output(folder):
        return ""
    return next((command for command, sign in _SIGNS.items() if (folder / sign).is_file()), "")


def _checked(target: Path) -> Path:
    try:
        here = Path.cwd()
    except FileNotFoundError:
        raise InputError(f"{target}: the folder that you are in was removed; change to another") from None
    target = Path(os.path.realpath(target))
    if target == here or target in here.parents:
        raise InputError(f"{target}: --out is the folder you are in or holds it; name a folder of its own")
    if target.exists() and not target.is_dir():
        raise InputError(f"{target}: --out is a file; name a folder")
    return target


def _refuse_foreign(folder: Path, target: Path) -> None:
    """Raise ``InputError`` about ``target`` where ``folder`` holds anything that slam did not write."""
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"{target}: {explain(error)}") from None
    ours = _marked_names(folder)
    if ours is None:
        ours = _names_of_first_version(folder)
    ours |= {*EVALUATE_NAMES, *_VIEWER_FILES} if ours else set()
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            written = bool(ours) and is_working_folder(Path(entry.path))  # a killed `slam evaluate`
        else:
            written = entry.name in ours and not entry.is_symlink()
        if not written:
            raise InputError(
                f"{target}: holds {entry.name!r}, which slam did not write, or not surely; "
                "choose another --out, or move it away or delete it yourself"
            )


def _write_marker(folder: Path) -> None:
    names = sorted({MARKER_NAME, *os.listdir(folder)})
    content = {"written_by": "slam", "version": VERSION, "files": names}
    (folder / MARKER_NAME).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _marked_names(folder: Path) -> set[str] | None:
    """Return the names of the files that slam wrote into the folder; None where it holds no marker."""
    content = _json_object(folder / MARKER_NAME)
    names = content.get("files")
    if content.get("written_by") != "slam" or not isinstance(names, list):
        return None
    return {name for name in names if isinstance(name, str)}


def _names_of_first_version(folder: Path) -> set[str]:
    """Return the names that version 0.1.0 may have written, if the folder is surely its output."""
    summary = _json_object(folder / _MARK)
    for files, keys, names in _FIRST_VERSION:
        if {*keys} <= summary.keys() and all((folder / name).is_file() for name in files):
            return {*names}
    return set()


def _json_object(path: Path) -> dict[str, Any]:
    """Return a small JSON object from a file; empty where the file is missing or holds something else."""
    try:
        content = json.loads(read_bytes(path, path.parent, _MAX_JSON_BYTES))
    except (InputError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
