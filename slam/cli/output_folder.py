"""The content of output folders, and the check whether a new run may replace one.

``slam.io.atomic`` makes a folder appear in one step, and lets only one run at a time write it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slam.core.errors import InputError, explain
from slam.experiments.registry import NAMES as EXPERIMENTS
from slam.io.atomic import atomic_folder, partial_path

OPTIMIZE_NAMES = (
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
)
"""Files that ``slam optimize`` writes."""

MODEL_NAME = "model.toml"
"""Model of the instruments from ``--model``; the commands that read the map need it too."""

ESTIMATE_NAMES = ("trajectory.tum", "estimate.npz", "estimate.png", "summary.json")
"""Files that ``slam estimate`` writes."""

EVALUATE_NAMES = ("evaluation.json", "evaluation_trajectory.png", "evaluation_error.png")
"""Files that ``slam evaluate`` adds."""

LOCATE_NAMES = ("locations.csv", "summary.json")
"""Files that ``slam locate`` writes."""

LOOPS_NAMES = ("loops.json", "loops.png", "summary.json")
"""Files that ``slam loops`` writes."""

REPLAY_NAMES = ("replay.png", "summary.json")
"""Files that ``slam replay`` writes."""

REPRODUCE_NAMES = (
    "reproduce.html",
    "summary.json",
    *(f"{name}{suffix}" for name in EXPERIMENTS for suffix in (".json", ".png")),
)
"""Files that ``slam reproduce`` writes."""

CRITICISE_NAMES = ("verdict.json", "extended.toml", "report.html", "summary.json")
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
    "mosaic.png.aux.xml",
    "mosaic.tif.aux.xml",
    "mosaic.tif.ovr",
)
"""Files that viewers create beside pictures; they may be deleted with them."""

_LEFTOVERS = tuple(partial_path(Path(name)).name for name in EVALUATE_NAMES)
"""Files that ``slam evaluate`` leaves if it is killed."""

_MARK = "summary.json"
"""File of every finished output; a folder without it is not replaced."""


@contextmanager
def output_folder(target: str | Path) -> Iterator[Path]:
    """Provide an empty folder; it becomes ``target`` when the block ends without an error.

    An earlier output in ``target`` stays until the new one is complete. Raises ``InputError`` where
    ``target`` is a file, holds something that slam did not write, is being written by another run, or cannot
    be written.
    """
    target = _checked(Path(target))
    _refuse_foreign(target)
    with atomic_folder(target, replace=True) as folder:
        yield folder


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


def _refuse_foreign(target: Path) -> None:
    try:
        entries = sorted(os.scandir(target), key=lambda entry: entry.name)
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"{target}: {explain(error)}") from None
    ours = {
        *OPTIMIZE_NAMES, MODEL_NAME, *ESTIMATE_NAMES, *EVALUATE_NAMES, *LOCATE_NAMES, *LOOPS_NAMES,
        *REPLAY_NAMES, *REPRODUCE_NAMES, *CRITICISE_NAMES, *_VIEWER_FILES, *_LEFTOVERS,
    }  # fmt: skip
    foreign = [
        entry.name for entry in entries if entry.name not in ours or entry.is_dir(follow_symlinks=False)
    ]
    if not is_output(target):
        foreign = foreign or [entry.name for entry in entries]
    if foreign:
        raise InputError(
            f"{target}: holds {foreign[0]!r}, which slam did not write; choose another --out or move it away"
        )
