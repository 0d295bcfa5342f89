"""Optical flow from a keyframe to a later picture, and the floor's homography from its tracks.

The picture is first warped into the keyframe by the predicted homography, so that the flow has only the
error of the prediction to find: neither rotation nor change of height deforms the windows. Every picture is
compared with the keyframe itself, so errors do not add up from picture to picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.cells import cells, occupied
from frontend.features import Features
from frontend.flow_frame import WINDOW_PX, FlowFrame
from frontend.gates import GateConfig, reject_reason
from frontend.homography import HomographyConfig, HomographyFit, fit_homography, transfer
from frontend.motions import ELSEWHERE, Expectation
from frontend.points import Points
from frontend.registration import Registration, overlap
from frontend.robust import median

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

LEVELS = 2
"""Reductions of the pyramid by two. The reach is half a window of the coarsest level, 40 px."""
ROUND_TRIP_PX = 0.5
"""Largest distance from its start at which a track may end that is followed there and back: several times the
noise of a track, and less than the distance to other detail."""
STEP_PX, STEPS = 0.01, 10
"""The search for a window ends with a step below this, or after so many."""
FAR_PX = 3.0
"""If the prediction was off by more than this, the flow is repeated with the homography that was found."""
NOISE_FLOOR = 0.5
"""Lower bound of the noise of tracks over that of features. Both pictures show a window's shape alike, so its
bias is smaller than a detector's; `tests/benchmarks/flow.py` measures both."""


@dataclass(frozen=True)
class FlowTemplate:
    """Points of a keyframe that are followed in later pictures."""

    frame: FlowFrame
    picture: Image
    """(h, w) normalised picture of the keyframe, rectified and reduced."""
    points: Points
    """(m,) points of the keyframe, at most one in each cell of a window's size."""

    @staticmethod
    def of(image: Image, features: Features, camera: Camera) -> FlowTemplate:
        """Return the template of a keyframe."""
        frame = FlowFrame(camera)
        whole = features.points[frame.shows(features.pixel, None)]
        points = whole[_one_per_cell(whole, frame.scale)]
        return FlowTemplate(frame, frame.warped(frame.grey(image), np.eye(3)), points)

    @cached_property
    def _corners(self) -> Array:
        return self.frame.camera.undistort(self.frame.camera.corners_px)

    def register(
        self,
        i: int,
        j: int,
        image: Image,
        mask: Image | None,
        expected: Expectation,
        homography: HomographyConfig,
        gates: GateConfig,
    ) -> Registration | None:
        """Register picture j to the keyframe i; None where the flow alone does not settle it.

        That is so where the tracks are few, cover little of the common floor, follow a second motion, fail a
        gate, or lead elsewhere than expected. Only features can tell then.
        """
        camera, compared = self.frame.camera, self.frame.grey(image)
        predicted = expected.homography(self._corners)
        found = self._fit(compared, mask, predicted, homography)
        far_px = FAR_PX * self.frame.scale[0]
        if found is not None and _off_px(found.fit.i_H_j, predicted, self._corners) > far_px:
            found = self._fit(compared, mask, found.fit.i_H_j, homography)
        away_px = expected.within_widths * camera.size_px[0]
        if found is None or expected.off_px(found.fit.i_H_j, self._corners) > away_px:
            return None
        fit, covered = found.fit, overlap(found.fit.i_H_j, camera)
        if not found.explains_floor(camera) or reject_reason(fit, found.tracked_px, camera, covered, gates):
            return None
        return Registration(
            i=i, j=j, reason=None, matches=np.empty((0, 2), np.int32), i_H_j=fit.i_H_j,
            corner_covariance=fit.corner_covariance, noise_px=fit.noise_px, overlap=covered,
            least_overlap=covered, lead=expected.lead,
        )  # fmt: skip

    def _fit(
        self, compared: Image, mask: Image | None, i_H_j: Array, config: HomographyConfig
    ) -> _Flow | None:
        """Follow all points that a prediction has in the picture, and fit the homography."""
        if not np.isfinite(i_H_j).all() or abs(np.linalg.det(i_H_j)) < 1e-9:
            return None
        j_H_i = np.asarray(np.linalg.inv(i_H_j), dtype=float)
        visible = self.points[self.frame.shows(transfer(j_H_i, self.points.pixel), mask)]
        if len(visible) == 0:
            return None
        at = transfer(self.frame.reduced_H_full, visible.pixel).astype(np.float32)
        tracked, found, strength = _follow(self.picture, self.frame.warped(compared, i_H_j), at)
        # The keyframe's windows define what is followed: all errors are those of the tracks.
        spread = np.sqrt(np.median(strength[found]) / strength[found]) if found.any() else np.empty(0)
        points_i = Points(visible.pixel[found], spread)
        landed = transfer(j_H_i, visible.pixel[found] + (tracked - at)[found] * self.frame.scale)
        points_j = Points(landed, np.zeros(len(landed)))
        config = replace(config, noise_floor_px=NOISE_FLOOR * config.noise_floor_px)
        fit = fit_homography(points_i, points_j, self._corners, config)
        if fit is None:
            return None
        agree = np.flatnonzero(found)[fit.inlier]
        fit = replace(fit, corner_covariance=fit.corner_covariance * _common_share(at[agree]))
        return _Flow(visible.pixel, agree, landed, fit)


@dataclass(frozen=True)
class _Flow:
    """Tracks of one picture with their homography."""

    visible_px: Array
    """(n, 2) points of the keyframe that should be visible in the picture."""
    agree: NDArray[np.int64]
    """(k,) those whose tracks agree with the homography."""
    tracked_px: Array
    """(m, 2) ends of all tracks in the picture."""
    fit: HomographyFit

    def explains_floor(self, camera: Camera) -> bool:
        """Return whether the tracks that agree cover the common floor.

        By the rule for a second motion: points that are lost or move otherwise may fill cells of their own,
        but only few.
        """
        cell = cells(self.visible_px, camera.size_px)
        filled = occupied(cell[self.agree])
        others = occupied(np.delete(cell, self.agree)) & ~filled
        return bool(others.sum() <= ELSEWHERE * filled.sum())


def _one_per_cell(points: Points, scale: Array) -> NDArray[np.int64]:
    """Return the most exact point in each cell of a window's size: more would see the same pixels."""
    column, row = (points.pixel / scale // WINDOW_PX).astype(np.int64).T
    order = np.argsort(points.spread, kind="stable")
    _, first = np.unique((column * (1 << 16) + row)[order], return_index=True)
    return np.sort(order[first])


def _follow(here: Image, there: Image, at: NDArray[np.float32]) -> tuple[Array, NDArray[np.bool_], Array]:
    """Follow points (n, 2) from one picture to another and back.

    Return where they are (n, 2), whether they came back (n,), and the information of each window (n,): the
    smaller eigenvalue of its structure tensor. Source: Bouguet 2001 (pyramidal Lucas-Kanade); Kalal,
    Mikolajczyk, Matas 2010 (forward-backward error); Shi and Tomasi 1994, section 3.
    """
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, STEPS, STEP_PX)
    window, start = (WINDOW_PX, WINDOW_PX), cv2.OPTFLOW_USE_INITIAL_FLOW
    there_px, forth, strength = cv2.calcOpticalFlowPyrLK(
        here, there, at, at.copy(), None, None, window, LEVELS, stop, start | cv2.OPTFLOW_LK_GET_MIN_EIGENVALS
    )
    # The way back begins with the displacement that all have in common, and needs no coarser levels.
    guess = there_px - np.array([median(moved) for moved in (there_px - at).T], np.float32)
    back_px, back, _ = cv2.calcOpticalFlowPyrLK(
        there, here, there_px, guess, None, None, window, 0, stop, start
    )
    trip = np.linalg.norm(back_px.reshape(-1, 2) - at, axis=1)
    found = (forth.ravel() > 0) & (back.ravel() > 0) & (trip < ROUND_TRIP_PX) & (strength.ravel() > 0)
    return np.asarray(there_px.reshape(-1, 2), dtype=float), found, np.asarray(strength.ravel(), dtype=float)


def _common_share(at: NDArray[np.float32]) -> float:
    """Return the factor by which windows at (n, 2) that overlap widen the covariance of a fit to them.

    Errors of two windows correlate by the share of their pixels that is common. A homography hardly changes
    within a window, so the variance of a fit grows by the mean sum of the correlations.
    """
    across, down = (_overlaps(coordinate / WINDOW_PX) for coordinate in at.T)
    return float(np.vdot(across, down)) / len(at)


def _overlaps(begin: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (n, n) the overlaps of intervals of length 1 that begin at (n,)."""
    apart = begin[:, None] - begin
    np.abs(apart, out=apart)
    np.subtract(1.0, apart, out=apart)
    return np.asarray(np.maximum(apart, 0.0, out=apart))


def _off_px(i_H_j: Array, predicted: Array, corners_px: Array) -> float:
    return float(np.linalg.norm(transfer(i_H_j, corners_px) - transfer(predicted, corners_px), axis=1).max())
