"""The checkpoints of a map, in a file beside its output folder, and what makes all of them void."""

from __future__ import annotations

import platform
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

from slam.core.packing import digest_of
from slam.core.version import VERSION
from slam.io.atomic import checkpoint_path
from slam.io.checkpoint_file import CheckpointFile
from slam.io.content_key import file_key

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.mapping.config import PipelineConfig

_PACKAGES = ("slam", "frontend", "backend")
LIBRARIES = (
    "numpy", "scipy", "opencv-contrib-python-headless", "gtsam", "numba", "llvmlite", "pillow", "networkx",
    "rasterio", "rosbags",
)  # fmt: skip
"""Distributions whose versions may change the bits of a result, with those that decode pictures."""


def checkpoints_beside(
    folder: Path, flight: Flight, settings: PipelineConfig, resume: bool, say: Callable[[str], None]
) -> CheckpointFile:
    """Return the checkpoints of the run before, if it was ended from outside and this one would do the same.

    ``folder``: the one that `slam.io.atomic.atomic_folder` gives. ``say`` prints a line.
    """
    made_by = {
        "the program": program_digest().hex(),
        "the settings": digest_of(settings).hex(),
        "the flight": flight.name,
    }
    return CheckpointFile(checkpoint_path(folder), made_by, resume, say)


def program_digest() -> bytes:
    """Return a digest of all that computes a result: this program's files and its libraries."""
    root = Path(__file__).resolve().parents[2]
    paths = sorted(path for name in _PACKAGES for path in (root / name).rglob("*.py"))
    files = [(path.relative_to(root).as_posix(), file_key(path)) for path in paths]
    libraries = {}
    for library in LIBRARIES:
        with suppress(PackageNotFoundError):
            libraries[library] = version(library)
    return digest_of((VERSION, platform.python_version(), platform.machine(), files, libraries))
