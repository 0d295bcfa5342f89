"""A ROS 2 bag of the estimate: a folder with a sqlite3 file and ``metadata.yaml``."""

from __future__ import annotations

from pathlib import Path

from slam.io.exports.bag_messages import write_bag
from slam.io.exports.exported_map import ExportedMap

_NAME = "estimate"


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write the bag into an empty folder. Raises ``InputError`` as ``write_bag`` does."""
    made = target / _NAME
    write_bag(exported, made)
    for path in made.iterdir():  # the library makes a folder of its own, and names files in it relatively
        path.rename(target / path.name)
    made.rmdir()
    return exported.navigation_notes()
