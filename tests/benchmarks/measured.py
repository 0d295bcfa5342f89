"""Location of the measured recordings."""

from __future__ import annotations

import os
from pathlib import Path

from tests.benchmarks.metric import Skipped


def folder(name: str) -> Path:
    """Return a folder of the measured data. Raises ``Skipped`` where it does not exist."""
    data = os.environ.get("SLAM_DATA")
    if not data:
        raise Skipped("SLAM_DATA does not name the folder of measured data")
    path = Path(data) / name
    if not path.is_dir():
        raise Skipped(f"SLAM_DATA holds no folder {name}")
    return path
