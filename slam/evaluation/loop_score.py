"""Precision and recall of the accepted loops against the truth.

A true loop is a pair of keyframes at least 10 s apart whose pictures, taken from the true poses, share at
least 30 % of the smaller footprint on the floor. A pair that shares 10 to 30 % counts neither way: it may or
may not be matched.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.estimate import LoopVerdict

Array = NDArray[np.float64]

TRUE_OVERLAP = 0.30
FALSE_OVERLAP = 0.10
APART_S = 10.0


@dataclass(frozen=True)
class LoopScore:
    """Accepted loops against the truth; a ratio is NaN where its denominator is zero."""

    precision: float
    """True share of the accepted loops that count."""
    recall: float
    """Accepted share of all true pairs of keyframes."""
    keyframe_recall: float
    """Share of the keyframes with a true loop that have an accepted one: one of many pairs is enough."""
    true_kept: int
    false_kept: int
    undecided_kept: int
    """Accepted loops that count neither way: overlap of 10 to 30 %, or a keyframe with an unknown
    footprint."""
    true_pairs: int


def score_loops(
    loops: Iterable[LoopVerdict],
    stamps_s: Array,
    keyframe: NDArray[np.int64],
    w_T_b_true: Array,
    camera: Camera,
) -> LoopScore:
    """Compute precision and recall of the accepted loops.

    ``stamps_s`` (n,) are the times of all keyframes; ``keyframe`` (m,) and ``w_T_b_true`` (m, 4, 4) are the
    numbers and poses of those with truth. Accepted loops less than 10 s apart are ignored. The true floor is
    z = 0.
    """
    footprints = np.stack([camera.footprint(pose) for pose in w_T_b_true])
    overlap = pair_overlaps(footprints, stamps_s[keyframe])
    known = set(keyframe[np.isfinite(footprints).all(axis=(1, 2))].tolist())
    overlap_of = {(int(keyframe[a]), int(keyframe[b])): share for (a, b), share in overlap.items()}
    true_pairs = {pair for pair, share in overlap_of.items() if share >= TRUE_OVERLAP}
    kept = {
        (min(loop.i, loop.j), max(loop.i, loop.j))
        for loop in loops
        if loop.verdict == "kept" and abs(stamps_s[loop.j] - stamps_s[loop.i]) >= APART_S
    }
    judged = {pair for pair in kept if pair[0] in known and pair[1] in known}
    true_kept = judged & true_pairs
    false_kept = {pair for pair in judged if overlap_of.get(pair, 0.0) < FALSE_OVERLAP}
    loopy = {k for pair in true_pairs for k in pair}
    found = {k for pair in true_kept for k in pair}
    return LoopScore(
        precision=_ratio(len(true_kept), len(true_kept) + len(false_kept)),
        recall=_ratio(len(true_kept), len(true_pairs)),
        keyframe_recall=_ratio(len(found), len(loopy)),
        true_kept=len(true_kept),
        false_kept=len(false_kept),
        undecided_kept=len(kept) - len(true_kept) - len(false_kept),
        true_pairs=len(true_pairs),
    )


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def pair_overlaps(footprints_m: Array, stamps_s: Array) -> dict[tuple[int, int], float]:
    """Overlap shares, above 0, of (m, 4, 2) footprints at least 10 s apart: (a, b) with a < b -> share."""
    centre = footprints_m.mean(axis=1)
    radius = np.linalg.norm(footprints_m - centre[:, None], axis=2).max(axis=1)
    overlaps: dict[tuple[int, int], float] = {}
    for a in range(len(footprints_m) - 1):
        # One row at a time: all pairs of a long flight at once would not fit into memory.
        distance = np.linalg.norm(centre[a + 1 :] - centre[a], axis=1)
        with np.errstate(invalid="ignore"):
            near = (distance < radius[a + 1 :] + radius[a]) & (
                np.abs(stamps_s[a + 1 :] - stamps_s[a]) >= APART_S
            )
        for b in np.flatnonzero(near) + a + 1:
            share = overlap_share(footprints_m[a], footprints_m[b])
            if share > 0:
                overlaps[a, int(b)] = share
    return overlaps


def overlap_share(one_m: Array, other_m: Array) -> float:
    """Return the common area of two convex quadrilaterals (4, 2) over the area of the smaller one."""
    # cv2 computes in float32: metres relative to the pair's centre keep the digits.
    origin = 0.5 * (one_m.mean(axis=0) + other_m.mean(axis=0))
    p, q = (one_m - origin).astype(np.float32), (other_m - origin).astype(np.float32)
    smaller = min(float(cv2.contourArea(p)), float(cv2.contourArea(q)))
    if smaller <= 0:
        return 0.0
    return float(cv2.intersectConvexConvex(p, q)[0]) / smaller
