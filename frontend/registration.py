"""Registration of two pictures: match features, fit a robust homography, apply the gates."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from backend.measurements import LinkCheck, Rejection
from frontend.camera import Camera
from frontend.features import Features
from frontend.gates import GateConfig, local_scale, reject_reason
from frontend.homography import HomographyConfig, transfer
from frontend.matching import match, match_near
from frontend.motions import Expectation, FloorMotion, OtherMotion, floor_motion

Array = NDArray[np.float64]

HIGHER = 1.5
"""Ratio of heights above which the overlap is measured in the lower picture."""


@dataclass(frozen=True)
class Registration:
    """Registration of picture j to picture i, or the reason for its rejection."""

    i: int
    j: int
    reason: Rejection | None
    """Reason for the rejection; None where the registration is accepted."""
    matches: NDArray[np.integer]
    """(m, 2) inlier matches: feature of i, feature of j. Small integers save memory: a long flight has
    millions."""
    i_H_j: Array
    """(3, 3) undistorted pixels of j to pixels of i; NaN where there is none."""
    corner_covariance: Array
    """(8, 8) px², covariance of the corners of j transferred into i."""
    noise_px: float
    overlap: float
    """Share of picture j that is also visible in picture i."""
    elsewhere: NDArray[np.integer] = field(default_factory=lambda: np.empty(0, np.int32))
    """(k,) features of j with a common motion other than that of the floor."""
    least_overlap: float = 1.0
    """Smaller one of ``overlap`` and the overlap by the other motion."""
    lead: float = 0.0
    """Confidence in the floor's motion over other motions, defined in `frontend.motions.Expectation`."""
    by_lines: bool = False
    """Whether it rests on grey levels (`frontend.alignment`) instead of matches."""
    other: OtherMotion | None = None
    """The motion that is not the floor's; None without one."""

    @property
    def ok(self) -> bool:
        """Return whether the registration is accepted."""
        return self.reason is None


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
    """Register picture j to picture i from their features and the predicted motion of the floor."""
    pairs = match(a, b)
    if len(pairs) < gates.min_inliers:
        return refused(i, j, Rejection(LinkCheck.TOO_FEW_MATCHES))
    corners = camera.undistort(camera.corners_px)

    def floor(pairs: NDArray[np.int64]) -> FloorMotion | None:
        points_i, points_j = a.points[pairs[:, 0]], b.points[pairs[:, 1]]
        return floor_motion(points_i, points_j, b.pixel, corners, camera.size_px, homography, expected)

    found = floor(pairs)
    off_px = expected.off_px(found.fit.i_H_j, corners) if expected and found else 0.0
    if expected and off_px > expected.within_widths * camera.size_px[0]:
        # On a repetitive floor the features may match where they are expected too.
        predicted = expected.predicted(b.pixel, corners)

        def near(of_a: NDArray[np.intp], of_b: NDArray[np.intp]) -> NDArray[np.bool_]:
            off = a.pixel[of_a] - predicted[of_b]
            return np.asarray(np.hypot(off[:, 0], off[:, 1]) < 0.5 * off_px)

        pairs = np.unique(np.concatenate([pairs, match_near(a, b, near)]), axis=0)
        found = floor(pairs)
    if found is None:
        return refused(i, j, Rejection(LinkCheck.NO_PLANE))
    fit = found.fit
    covered = overlap(fit.i_H_j, camera)
    reason = reject_reason(
        fit, b.pixel[pairs[:, 1]], camera, _shared(fit.i_H_j, covered, camera, gates), gates
    )
    pairs = pairs.astype(np.min_scalar_type(max(len(a), len(b))))
    other = covered if found.other_i_H_j is None else overlap(found.other_i_H_j, camera)
    return Registration(
        i=i, j=j, reason=reason, matches=pairs[fit.inlier], i_H_j=fit.i_H_j,
        corner_covariance=fit.corner_covariance, noise_px=fit.noise_px, overlap=covered,
        elsewhere=pairs[found.elsewhere, 1], least_overlap=min(covered, other), lead=found.lead,
        other=found.other(b.pixel[pairs[:, 1]], camera.size_px),
    )  # fmt: skip


def overlap(i_H_j: Array, camera: Camera) -> float:
    """Return the share of picture j that lies inside picture i after transfer; 0 where the transfer folds."""
    corners = camera.corners_px
    w = corners @ i_H_j[2, :2] + i_H_j[2, 2]
    if (w <= 0).any():
        return 0.0
    quad = transfer(i_H_j, corners).astype(np.float32)
    area = cv2.contourArea(quad, oriented=True)  # negative: mirrored, impossible for a floor
    if not np.isfinite(quad).all() or area < 1.0 or not cv2.isContourConvex(quad):
        return 0.0
    shared, _ = cv2.intersectConvexConvex(quad, corners.astype(np.float32))
    return float(min(1.0, max(0.0, shared) / area))


def _shared(i_H_j: Array, covered: float, camera: Camera, gates: GateConfig) -> float:
    """Return ``covered``, the share of picture j, or the share of picture i where j is from much higher.

    At three times the height, at most a ninth of picture j can be visible in picture i.
    """
    if covered == 0.0 or covered >= gates.min_overlap or local_scale(i_H_j, camera) < HIGHER:
        return covered
    j_H_i = np.linalg.inv(i_H_j)
    return overlap(np.asarray(j_H_i / j_H_i[2, 2], dtype=float), camera)


def refused(i: int, j: int, reason: Rejection) -> Registration:
    """Return the registration of a rejected pair with its reason."""
    nothing = np.full((3, 3), np.nan)
    return Registration(
        i=i, j=j, reason=reason, matches=np.empty((0, 2), np.int32), i_H_j=nothing,
        corner_covariance=np.full((8, 8), np.nan), noise_px=np.nan, overlap=0.0,
    )  # fmt: skip
