"""The floor points of a refined part, relative to its keyframes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.bundle.accuracy.refined_points import metric_point_stds, metric_points
from backend.bundle.refinement import Bundle
from backend.sparse_cholesky import SingularMatrixError
from slam.core.floor_points import FloorPoints

_LEAST_VIEWS = 2
"""Views that determine a place: the rest of a point that lost them stays where the floor is assumed."""


def refined_floor_points(bundle: Bundle, members: NDArray[np.int64]) -> FloorPoints:
    """Return the points that two keyframes or more determine; ``members`` (m,) are those of the part."""
    tracks, used = bundle.optimum.problem.tracks, bundle.optimum.used
    place = metric_points(bundle.optimum)
    views = np.bincount(tracks.track[used], minlength=len(place))
    first = np.full(len(place), len(members), dtype=np.int64)
    np.minimum.at(first, tracks.track[used], tracks.keyframe[used])
    kept = views >= _LEAST_VIEWS
    b_T_w = se3.inverse(bundle.w_T_b)[first[kept]]
    b_p_m = np.einsum("tab,tb->ta", b_T_w[:, :3, :3], place[kept]) + b_T_w[:, :3, 3]
    try:
        std_m = metric_point_stds(bundle.optimum)[kept]
    except SingularMatrixError:
        std_m = np.full((int(kept.sum()), 3), np.nan)
    return FloorPoints(members[first[kept]], b_p_m, views[kept], std_m)
