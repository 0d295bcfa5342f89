"""Labels of keyframe pairs, loop or no loop, from the truth or the GPS of the flight.

A true loop shares at least 30 % of the smaller footprint and is at least 10 s apart in time. A pair that
shares 10 to 30 % counts neither way, as in ``slam.evaluation.loop_score``.

With truth the footprints are those of the true poses over z = 0. A GPS fix gives the position, but not the
height above the ground or the heading of the picture. Height and heading are then those of the graph without
loops, aligned with the fixes, so that the labels do not depend on the loops under test. A fix also has an
error of some metres, as large as the difference between fixes and map. A pair therefore counts only where its
label is unchanged when its two positions move together or apart by the standard deviation of their distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.robust import NORMAL
from slam.core.errors import InputError
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation.association import associate
from slam.evaluation.loop_score import APART_S, FALSE_OVERLAP, TRUE_OVERLAP, overlap_share, pair_overlaps

Array = NDArray[np.float64]
Pair = tuple[int, int]

TRUE, FALSE, UNDECIDED = 1, 0, -1


@dataclass(frozen=True)
class Reference:
    """Known labels of the loops of a flight."""

    kind: str
    """The reference: ``truth`` or ``gps``."""
    stamps_s: Array
    """(n,) times of all keyframes, in seconds."""
    position_m: Array
    """(n, 2) positions of the keyframes, in metres; NaN where the reference does not cover them."""
    overlap: dict[Pair, tuple[float, float]]
    """Least and largest overlap share, above 0, of pairs i < j of known keyframes far enough apart in
    time."""
    position_std_m: float = 0.0
    """Standard deviation of one coordinate of one position, in metres."""

    @property
    def known(self) -> NDArray[np.bool_]:
        """(n,) whether the reference covers a keyframe."""
        return np.asarray(np.isfinite(self.position_m).all(axis=1))

    def labels(self, pairs: Sequence[Pair] | NDArray[np.int64]) -> NDArray[np.int64]:
        """(m,) labels TRUE, FALSE or UNDECIDED; a pair with an unknown keyframe is UNDECIDED."""
        pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
        share = np.array([self.overlap.get((i, j), (0.0, 0.0)) for i, j in pairs.tolist()]).reshape(-1, 2)
        surely_false = share[:, 1] < FALSE_OVERLAP
        label = np.where(share[:, 0] >= TRUE_OVERLAP, TRUE, np.where(surely_false, FALSE, UNDECIDED))
        return np.where(self.known[pairs].all(axis=1), label, UNDECIDED)

    def eligible(self, keyframe: NDArray[np.int64]) -> NDArray[np.int64]:
        """(m, 2) pairs i < j of the given keyframes that are far enough apart in time."""
        i, j = (keyframe[index] for index in np.triu_indices(len(keyframe), 1))
        apart = np.abs(self.stamps_s[j] - self.stamps_s[i]) >= APART_S
        return np.column_stack([i[apart], j[apart]])


def reference_of(estimate: Estimate, flight: Flight) -> Reference:
    """Compute the labels of a flight's keyframes. Raises ``InputError`` where no two of them can be a
    loop."""
    camera = flight.camera
    assert camera is not None
    anywhere = replace(
        estimate,
        w_T_b=np.tile(np.eye(4), (len(estimate.stamps_s), 1, 1)),
        component=np.zeros(len(estimate.stamps_s), dtype=np.int64),
    )
    found = associate(anywhere, flight)
    keyframe, poses, floor_z_m, std_m = found.keyframe, found.w_T_b, 0.0, 0.0
    if poses is None:
        poses, floor_z_m = estimate.odometry_w_T_b[keyframe].copy(), estimate.floor_z_m
        poses[:, :2, 3] = found.position_m[:, :2]
        off_m = np.abs(found.position_m[:, :2] - estimate.w_T_b[keyframe, :2, 3])
        std_m = NORMAL * float(np.nanmedian(off_m))
    footprint = np.stack([_footprint(camera, pose, floor_z_m) for pose in poses])
    seen = np.isfinite(footprint).all(axis=(1, 2))
    keyframe, footprint = keyframe[seen], footprint[seen]
    stamps_s = estimate.stamps_s
    if len(keyframe) < 2 or np.ptp(stamps_s[keyframe]) < APART_S:
        kind = "truth" if found.reference == "truth" else "GPS"
        raise InputError(
            f"{flight.name}: {len(keyframe)} keyframes with {kind}, none "
            f"{APART_S:g} s after another: too few for a loop; give a flight that is longer and comes back"
        )
    position = np.full((len(stamps_s), 2), np.nan)
    position[keyframe] = poses[seen, :2, 3]
    overlap = {
        (int(keyframe[a]), int(keyframe[b])): share
        for (a, b), share in overlap_bounds(footprint, stamps_s[keyframe], np.sqrt(2) * std_m).items()
    }
    return Reference(found.reference, stamps_s, position, overlap, std_m)


def overlap_bounds(footprint_m: Array, stamps_s: Array, slack_m: float) -> dict[Pair, tuple[float, float]]:
    """Overlap shares of (m, 4, 2) footprints at least 10 s apart, moved apart and together by ``slack_m``.

    The result has the pairs a < b whose larger share is above 0.
    """
    if slack_m == 0:
        return {pair: (share, share) for pair, share in pair_overlaps(footprint_m, stamps_s).items()}
    centre = footprint_m.mean(axis=1)
    radius = np.linalg.norm(footprint_m - centre[:, None], axis=2).max(axis=1)
    bounds: dict[Pair, tuple[float, float]] = {}
    for a in range(len(footprint_m) - 1):
        way = centre[a + 1 :] - centre[a]
        distance = np.linalg.norm(way, axis=1)
        near = distance < radius[a + 1 :] + radius[a] + slack_m
        for k in np.flatnonzero(near & (np.abs(stamps_s[a + 1 :] - stamps_s[a]) >= APART_S)).tolist():
            b = a + 1 + k
            along = way[k] / distance[k] if distance[k] > 0 else np.array([1.0, 0.0])
            together = min(slack_m, float(distance[k]))
            most = overlap_share(footprint_m[a], footprint_m[b] - together * along)
            if most > 0:
                bounds[a, b] = overlap_share(footprint_m[a], footprint_m[b] + slack_m * along), most
    return bounds


def _footprint(camera: Camera, pose: Array, floor_z_m: float) -> Array:
    if not np.isfinite(pose).all():
        return np.full((4, 2), np.nan)
    return camera.footprint(pose, floor_z_m)
