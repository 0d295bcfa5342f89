"""Poses as lines of the TUM RGB-D benchmark, which evo and many other tools read."""

from __future__ import annotations

from pathlib import Path

from slam.io.estimate_text import pose_lines
from slam.io.exports.exported_map import ExportedMap


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write ``stamp tx ty tz qx qy qz qw`` of w_T_b for each keyframe."""
    frames = exported.keyframes
    lines = pose_lines(frames.stamps_ns, frames.w_T_b, exported.estimate.metric)
    target.write_text("\n".join([*lines, ""]), encoding="ascii")
    return ()
