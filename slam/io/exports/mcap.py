"""An MCAP file of the estimate with ROS 2 messages, as Foxglove and ``ros2 bag`` read it."""

from __future__ import annotations

from pathlib import Path

from slam.io.exports.bag_messages import write_bag
from slam.io.exports.exported_map import ExportedMap


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write the file. Raises ``InputError`` as ``write_bag`` does."""
    made = target.with_name("bag")
    write_bag(exported, made, "MCAP")
    (file,) = made.glob("*.mcap")
    file.replace(target)
    return ()
