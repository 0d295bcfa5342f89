"""Text files of an estimate, for other tools and readers: trajectory.tum and loops.csv."""

from __future__ import annotations

import csv
import io

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.estimate import Estimate
from slam.core.units import unit

Array = NDArray[np.float64]

_NS = 1_000_000_000


def trajectory_text(estimate: Estimate) -> str:
    """Return the placed keyframes as TUM lines: ``stamp tx ty tz qx qy qz qw`` of w_T_b, seconds with 9
    decimals.

    The stamps are written from integers, exact to the nanosecond. A keyframe that could not be placed has no
    line here, but a row in estimate.npz.
    """
    placed = estimate.placed
    lines = pose_lines(estimate.stamps_ns[placed], estimate.w_T_b[placed], estimate.metric)
    return "\n".join(lines) + "\n"


def pose_lines(stamps_ns: NDArray[np.int64], w_T_b: Array, metric: bool) -> list[str]:
    """Return poses (n, 4, 4) as TUM lines, after a line that names the columns."""
    lines = [f"# timestamp [s] tx ty tz [{unit(metric)}] qx qy qz qw of w_T_b"]
    if len(w_T_b):
        quaternions = Rotation.from_matrix(w_T_b[:, :3, :3]).as_quat()
        for stamp_ns, position, q in zip(stamps_ns.tolist(), w_T_b[:, :3, 3], quaternions, strict=True):
            numbers = " ".join(f"{v:.9f}" for v in position)
            turn = " ".join(f"{v:.12f}" for v in q)
            lines.append(f"{_seconds(stamp_ns)} {numbers} {turn}")
    return lines


def _seconds(stamp_ns: int) -> str:
    whole, rest = divmod(abs(stamp_ns), _NS)
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{rest:09d}"


def loops_text(estimate: Estimate) -> str:
    """Return every loop candidate with its verdict and reason as CSV."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["i", "j", "verdict", "reason", "stamp_i [ns]", "stamp_j [ns]"])
    stamps_ns = estimate.stamps_ns
    for loop in estimate.loops:
        rows.writerow(
            [loop.i, loop.j, loop.verdict, loop.reason, int(stamps_ns[loop.i]), int(stamps_ns[loop.j])]
        )
    return text.getvalue()
