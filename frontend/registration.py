"""Two pictures registered: match, robust homography, gates. The unit of all front-end work."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Features
from frontend.gates import GateConfig, local_scale, reject_reason
from frontend.homography import HomographyConfig, transfer
from frontend.matching import match
from frontend.motions import Expectation, floor_motion

Array = NDArray[np.float64]

HIGHER = 1.5
"""A picture from this many times as high is much the larger one."""


@dataclass(frozen=True)
class Registration:
    """Picture j registered to picture i, or the reason why not."""

    i: int
    j: int
    reason: str
    """Empty where the registration holds."""
    matches: NDArray[np.integer]
    """(m, 2) inlier matches: feature of i, feature of j. A long flight has millions: in few bytes each."""
    i_H_j: Array
    """(3, 3) undistorted pixels of j to pixels of i; NaN where there is none."""
    corner_covariance: Array
    """(8, 8) px², corners of j carried into i."""
    noise_px: float
    overlap: float
    """Share of picture j that picture i shows too."""
    elsewhere: NDArray[np.integer] = field(default_factory=lambda: np.empty(0, np.int32))
    """(k,) features of j that move together by themselves: on something else than the floor."""
    least_overlap: float = 1.0
    """``overlap``, or that of what moves by itself where it is less."""
    lead: float = 0.0
    """By how much the floor is told from other motions, as `frontend.motions.Expectation` has it."""

    @property
    def ok(self) -> bool:
        """Whether the registration holds."""
        return not self.reason


def register(
    i: int,
    j: int,
    a: Features,
    b: Features,
    camera: Camera,
    homography: HomographyConfig,
    gates: GateConfig,
    expected: Expectation | None = None,
) -> Registration:
    """Register picture j to picture i from their features, and from where the floor is expected."""
    pairs = match(a, b).astype(np.min_scalar_type(max(len(a), len(b))))
    if len(pairs) < gates.min_inliers:
        return refused(i, j, "too few matches")
    points_i, points_j = a.points[pairs[:, 0]], b.points[pairs[:, 1]]
    corners = camera.undistort(camera.corners_px)
    found = floor_motion(points_i, points_j, b.pixel, corners, camera.size_px, homography, expected)
    if found is None:
        return refused(i, j, "no plane fits the matches")
    fit = found.fit
    covered = overlap(fit.i_H_j, camera)
    reason = reject_reason(fit, points_j.pixel, camera, _shared(fit.i_H_j, covered, camera, gates), gates)
    return Registration(
        i,
        j,
        reason,
        pairs[fit.inlier],
        fit.i_H_j,
        fit.corner_covariance,
        fit.noise_px,
        covered,
        pairs[found.elsewhere, 1],
        covered if found.other_i_H_j is None else min(covered, overlap(found.other_i_H_j, camera)),
        found.lead,
    )


def overlap(i_H_j: Array, camera: Camera) -> float:
    """Share of picture j that lies inside picture i after transfer; 0 where the transfer folds."""
    corners = camera.corners_px
    w = corners @ i_H_j[2, :2] + i_H_j[2, 2]
    if (w <= 0).any():
        return 0.0
    quad = transfer(i_H_j, corners).astype(np.float32)
    area = cv2.contourArea(quad, oriented=True)  # negative: mirrored, as no floor is seen
    if not np.isfinite(quad).all() or area < 1.0 or not cv2.isContourConvex(quad):
        return 0.0
    shared, _ = cv2.intersectConvexConvex(quad, corners.astype(np.float32))
    return float(min(1.0, max(0.0, shared) / area))


def _shared(i_H_j: Array, covered: float, camera: Camera, gates: GateConfig) -> float:
    """Share of picture j, ``covered``; of picture i where j is from much higher.

    Of a picture from three times as high no other shows more than a ninth.
    """
    if covered == 0.0 or covered >= gates.min_overlap or local_scale(i_H_j, camera) < HIGHER:
        return covered
    j_H_i = np.linalg.inv(i_H_j)
    return overlap(np.asarray(j_H_i / j_H_i[2, 2], dtype=float), camera)


def refused(i: int, j: int, reason: str) -> Registration:
    """A pair without a registration, and why."""
    nothing = np.full((3, 3), np.nan)
    return Registration(
        i, j, reason, np.empty((0, 2), np.int32), nothing, np.full((8, 8), np.nan), np.nan, 0.0
    )
