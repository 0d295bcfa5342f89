"""A pose graph as plain arrays: what a g2o file holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from backend.measurements import RelativePose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PoseGraph:
    """Vertices and edges; edges name vertices by their position in ``ids``."""

    dimension: Literal[2, 3]
    ids: NDArray[np.int64]
    """(n,) number of each vertex in the file, increasing."""
    poses: Array
    """(n, 4, 4) given poses, NaN where the file gives none."""
    i: NDArray[np.int64]
    """(m,)."""
    j: NDArray[np.int64]
    """(m,)."""
    ij_T: Array
    """(m, 4, 4) pose of vertex j seen from vertex i."""
    information: Array
    """(m, d, d) in gtsam's tangent order: (x, y, heading) for d = 3, rotation first for d = 6."""
    fixed: NDArray[np.bool_]
    """(n,) vertices that the file holds in place."""
    warnings: tuple[str, ...] = ()
    """What was skipped, repaired or dropped when the file was read."""

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(n,) whether the file gives the vertex a pose."""
        return _finite(self.poses)


def _finite(T: Array) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(T).all(axis=(1, 2)))


def pose_graph(w_T_b: Array, relative_poses: tuple[RelativePose, ...]) -> PoseGraph:
    """A spatial graph of placed keyframes and their relative poses.

    ``w_T_b`` is (n, 4, 4); a keyframe without a finite pose is left out together with its edges.
    """
    placed = _finite(w_T_b)
    number = np.cumsum(placed) - 1
    edges = [e for e in relative_poses if placed[e.i] and placed[e.j]]
    return PoseGraph(
        dimension=3,
        ids=np.flatnonzero(placed),
        poses=w_T_b[placed],
        i=number[np.array([e.i for e in edges], dtype=np.int64)],
        j=number[np.array([e.j for e in edges], dtype=np.int64)],
        ij_T=np.array([e.i_T_j for e in edges]).reshape(-1, 4, 4),
        information=np.linalg.inv(np.array([e.covariance for e in edges]).reshape(-1, 6, 6)),
        fixed=np.zeros(int(placed.sum()), dtype=bool),
    )
