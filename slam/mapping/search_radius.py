"""Limits by the known poses and covariances: where to search for loops, and which edges are implausible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.measurements import LinkCheck, Rejection, RelativePose
from backend.pose_graph.heights import HeightEstimate
from backend.pose_graph.solution import Solution
from frontend.camera import Camera
from slam.core.units import unit
from slam.mapping.config import LoopConfig
from slam.mapping.setup import Setup

Array = NDArray[np.float64]

WIDENED_BY_TILT = 1.5
"""A tilted picture sees farther: the factor of a wide lens tilted by 15 degrees."""


@dataclass(frozen=True)
class SearchRadius:
    """Around each keyframe the circle that holds all that it may have seen."""

    w_p_b: Array
    """(n, 3) positions, in the units of the pose graph."""
    radius: Array
    """(n,) half the view's diagonal and some standard deviations of the position; NaN where not known."""
    component: NDArray[np.int64]
    """(n,) parts that nothing joins yet have no place relative to each other."""
    metric: bool = True
    """Whether lengths are metres; else heights of the camera."""

    def holds(self, j: int, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(m,) which keyframes may have seen what ``j`` has; all of which nothing is known."""
        apart, most = self._apart(j, rows)
        return np.asarray(~((apart > most) & (self.component[rows] == self.component[j])))

    def reason(self, i: int, j: int) -> Rejection:
        """Why a pair beyond reach is not compared."""
        apart, most = self._apart(j, np.array([i]))
        m = unit(self.metric)
        return Rejection(
            LinkCheck.REACH,
            f"{apart[0]:.2f} {m} apart by the poses so far, at most {most[0]:.2f} {m} allowed",
        )

    def _apart(self, j: int, rows: NDArray[np.int64]) -> tuple[Array, Array]:
        apart = np.linalg.norm(self.w_p_b[rows] - self.w_p_b[j], axis=1)
        return apart, self.radius[rows] + self.radius[j]


@dataclass(frozen=True)
class KnownPoses:
    """Known poses of the keyframes, in any unit of length."""

    w_T_b: Array
    covariances: Array | None
    """(n, 6, 6)."""
    component: NDArray[np.int64]
    """(n,) parts that nothing joins yet have no place relative to each other."""
    height_m: Array
    """(n,) over the floor, in the same unit."""
    metric: bool = True
    """Whether the unit is the metre; else the height of the camera."""


@dataclass(frozen=True)
class Misplacements:
    """How far the second ends of m edges lie from where the known poses have them."""

    off: Array
    """(m,) distance of measured and known place of j in i, in the units of the poses."""
    limit: Array
    """(m,) largest one that the uncertainty of both explains."""
    is_known: NDArray[np.bool_]
    """(m,) whether both ends lie in one part. Separate parts have no place relative to each other."""

    @staticmethod
    def of(edges: Sequence[RelativePose], known: KnownPoses, trust: LoopConfig) -> Misplacements:
        """Compare edges, in the unit of the ``known`` poses, with these and with their covariances."""
        assert known.covariances is not None
        w_T_b, covariances = known.w_T_b, known.covariances
        i, j = np.array([(r.i, r.j) for r in edges]).T
        measured = np.array([r.i_T_j[:3, 3] for r in edges])
        expected = np.einsum("mba,mb->ma", w_T_b[i, :3, :3], w_T_b[j, :3, 3] - w_T_b[i, :3, 3])
        variance = sum(np.trace(c[:, 3:, 3:], axis1=1, axis2=2) for c in (covariances[i], covariances[j]))
        variance = variance + np.array([np.trace(r.covariance[3:, 3:]) for r in edges])
        limit = np.maximum(
            trust.plausible_sigmas * np.sqrt(variance), trust.plausible_heights * known.height_m[i]
        )
        off = np.linalg.norm(measured - expected, axis=1)
        return Misplacements(off, limit, known.component[i] == known.component[j])

    @property
    def beyond(self) -> NDArray[np.bool_]:
        """(m,) whether an edge lies where the known poses cannot have it."""
        return self.is_known & (self.off > self.limit)


def implausible_edges(
    edges: Sequence[RelativePose], known: KnownPoses, trust: LoopConfig
) -> dict[tuple[int, int], Rejection]:
    """Edges that lie where the poses known so far cannot have them: (i, j) -> reason.

    ``edges`` in the unit of ``known``. This separates a look-alike floor from a
    place that was visited before.
    """
    if known.covariances is None or not edges:
        return {}
    placed, m = Misplacements.of(edges, known, trust), unit(known.metric)
    return {
        (edges[k].i, edges[k].j): Rejection(
            LinkCheck.PLACE,
            f"{placed.off[k]:.2f} {m} from where the poses put it, at most {placed.limit[k]:.2f} {m} allowed",
        )
        for k in np.flatnonzero(placed.beyond).tolist()
    }


def view_radius(camera: Camera) -> float:
    """Return the radius of the circle that holds all that a camera sees, over its height."""
    corner = camera.rays(camera.undistort(camera.corners_px))
    return WIDENED_BY_TILT * float(np.linalg.norm(corner[:, :2], axis=1).max())


def search_radius(setup: Setup, heights: HeightEstimate, known: Solution) -> SearchRadius:
    """Compute the circle around each keyframe that holds all that it may have seen."""
    height_m = heights.height_m
    covariances = known.covariances
    if covariances is None:
        covariances = np.full((len(height_m), 6, 6), np.nan)
    view_m = view_radius(setup.camera) * height_m
    std_m = np.sqrt(np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2))
    return SearchRadius(
        w_p_b=known.w_T_b[:, :3, 3],
        radius=view_m + setup.config.loops.plausible_sigmas * std_m,
        component=known.component,
        metric=bool(heights.metric.all()),
    )
