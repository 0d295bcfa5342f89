"""Alignment of two pictures by their grey levels, for floors with lines but with few features.

A line displaces a picture across itself alone (the aperture problem): each window measures the displacement
along its gradients, and the homography is solved in the directions that all windows together determine. It
keeps its prediction in the others, and its covariance says that nothing is known there.

Source: Baker and Matthews 2004 (Lucas-Kanade 20 years on: inverse compositional alignment); Shi and Tomasi
1994, section 3 (the structure tensor of a window).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.edge_windows import (
    WINDOW_PX,
    CornerPrior,
    CornerStep,
    by_corners,
    is_structured,
    mean_shift,
    measured,
    place_and_shape,
    solved,
)
from frontend.flow import NOISE_FLOOR
from frontend.flow_frame import FlowFrame
from frontend.gates import GateConfig, local_scale
from frontend.homography import HomographyConfig, transfer
from frontend.registration import Registration, overlap

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Grey = NDArray[np.float32]

BLUR_PX = 1.2
"""Standard deviation of the blur before the pictures are compared: pixels sample a sharp edge too coarsely to
be interpolated, and show steps along a slanted line that move with the pixels."""
REDUCED = 4
"""Reduction of the first level. Its reach is several of its pixels, less than the distance of two lines."""
STEPS, STILL_PX = 12, (5e-3, 0.05)
"""Most Gauss-Newton steps at a level, and the displacement in pixels of each level below which it ends."""
NEAR_PX = 1.0
"""Standard deviation of a prediction from which whole pictures align: their blurred lines overlap."""
MOST_UNEXPLAINED = 0.1
"""Largest share of the variance of the common picture that may differ after the alignment."""
STEP_PX = 2.0 * REDUCED
"""Distance of neighbouring starts: half of it, a reduced pixel, is within the reach of each."""
SEARCH_SIGMAS, MOST_STEPS = 3.0, 3
"""Starts lie within so many standard deviations of the prediction, and so many steps from it at most."""
PLAUSIBLE, CERTAIN = -2 * np.log(1e-4), -2 * np.log(1e-3)
"""Largest squared distance of a displacement from its prediction, in standard deviations: farther is one of
10 000 with two degrees of freedom. Of two displacements one is a thousand times as likely as the other where
their squared distances differ by the second number."""


@dataclass(frozen=True)
class Prediction:
    """Expected place of a picture in another one."""

    i_H_j: Array
    """(3, 3) undistorted pixels of picture j to those of picture i."""
    covariance: Array
    """(2, 2) px², of the mean displacement of its corners."""


@dataclass(frozen=True)
class _Aligned:
    """Result of one start, in pixels of the compared pictures."""

    H: Array
    covariance: Array
    """(8, 8) of the corners."""
    moved: Array
    """(2,) mean displacement of the corners from the prediction, if the shape is as predicted."""
    of_moved: Array
    """Its covariance (2, 2)."""


@dataclass(frozen=True)
class AlignmentTemplate:
    """A picture that later ones are aligned with."""

    frame: FlowFrame
    levels: tuple[Grey, Grey]
    """(h, w) blurred grey picture of an ideal lens, and a reduced one."""
    seen: NDArray[np.uint8]
    """(h, w) whether each pixel was recorded and is not masked."""

    @staticmethod
    def of(image: Image, mask: Image | None, camera: Camera) -> AlignmentTemplate:
        """Prepare a picture."""
        frame = FlowFrame(camera)
        grey, seen = frame.grey(image), np.ones(frame.size_px[::-1], np.uint8)
        if mask is not None:
            seen = (cv2.resize(mask, frame.size_px, interpolation=cv2.INTER_NEAREST) > 0).astype(np.uint8)
        if camera.is_distorted:
            K = frame.reduced_H_full @ camera.matrix
            at = camera.recorded_maps(K, frame.size_px, K)
            grey = cv2.remap(grey, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            seen = cv2.remap(seen, *at, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
        whole = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), BLUR_PX)
        small = cv2.resize(whole, None, fx=1 / REDUCED, fy=1 / REDUCED, interpolation=cv2.INTER_AREA)
        return AlignmentTemplate(frame, (np.asarray(whole), np.asarray(small)), np.asarray(seen))

    @cached_property
    def is_structured(self) -> bool:
        """Whether the picture shows edges in several windows."""
        return is_structured(self.levels[0], self.seen)

    def register(
        self,
        i: int,
        j: int,
        other: AlignmentTemplate,
        predicted: Prediction,
        lead: float,
        homography: HomographyConfig,
        gates: GateConfig,
    ) -> Registration | None:
        """Register picture j, ``other``, to this picture i within the covariance of a prediction.

        ``lead``: as in `frontend.motions.Expectation`.

        None where the pictures do not come to look alike, or do so at several places.
        """
        corners = self.frame.camera.undistort(self.frame.camera.corners_px)
        to, floor_px = self.frame.reduced_H_full, NOISE_FLOOR * homography.noise_floor_px
        found = self._searched(other, predicted, floor_px, gates)
        if found is None:
            return None
        i_H_j = np.asarray(np.linalg.inv(to) @ found.H @ to, dtype=float)
        i_H_j /= i_H_j[2, 2]
        covered = overlap(i_H_j, self.frame.camera)
        return Registration(
            i=i, j=j, reason=None, matches=np.empty((0, 2), np.int32), i_H_j=i_H_j,
            corner_covariance=_of_corners(found.covariance, found.H, self.frame, corners), noise_px=floor_px,
            overlap=covered, least_overlap=covered, lead=lead, by_lines=True,
        )  # fmt: skip

    def _searched(
        self, other: AlignmentTemplate, predicted: Prediction, floor_px: float, gates: GateConfig
    ) -> _Aligned | None:
        """Return the only likely result of all starts within the covariance of the prediction; None where
        there is none."""
        to = self.frame.reduced_H_full
        covariance = predicted.covariance / np.outer(self.frame.scale, self.frame.scale)
        predicted = Prediction(to @ predicted.i_H_j @ np.linalg.inv(to), covariance)
        is_near = bool(np.trace(covariance) < NEAR_PX**2)
        found: list[tuple[float, _Aligned]] = []
        for shift in _starts(covariance):
            if any(_squared(shift - each.moved, each.of_moved) < 1.0 for _, each in found):
                continue  # It leads to the same place, up to what lines leave open.
            each = self._from_start(other, predicted, shift, floor_px, gates) if is_near else None
            each = each or self._from_start(other, predicted, shift, floor_px, gates, (1, 0))
            if each is not None:
                found.append((_squared(each.moved, covariance + each.of_moved), each))
        found = sorted([one for one in found if one[0] < PLAUSIBLE], key=lambda one: one[0])
        if not found:
            return None
        (least, best), others = found[0], found[1:]
        for squared, each in others:
            apart = _squared(each.moved - best.moved, each.of_moved + best.of_moved)
            if squared < least + CERTAIN and apart > PLAUSIBLE:
                return None
        return best

    def _from_start(
        self,
        other: AlignmentTemplate,
        predicted: Prediction,
        shift: Array,
        floor_px: float,
        gates: GateConfig,
        levels: tuple[int, ...] = (0,),
    ) -> _Aligned | None:
        """Return the result of a start that is shifted from the prediction; None where the pictures do not
        come to look alike."""
        H, covariance = np.eye(3), np.empty((8, 8))
        H[:2, 2] = shift
        H = H @ predicted.i_H_j
        for level in levels:
            aligned = _at_level(self, other, H, predicted, level, floor_px)
            if aligned is None:
                return None
            H, covariance = aligned[0], aligned[1].covariance
        to, camera = self.frame.reduced_H_full, self.frame.camera
        i_H_j = np.asarray(np.linalg.inv(to) @ H @ to, dtype=float)
        if overlap(i_H_j, camera) < gates.min_overlap or not _alike(self, other, H):
            return None
        if not 1.0 / gates.max_scale < local_scale(i_H_j, camera) < gates.max_scale:
            return None
        off = transfer(H, self._corners) - transfer(predicted.i_H_j, self._corners)
        return _Aligned(H, covariance, *mean_shift(off.ravel(), covariance, max(self.frame.size_px)))

    @cached_property
    def _corners(self) -> Array:
        width, height = self.frame.size_px
        return np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=float)


def _starts(covariance: Array) -> list[Array]:
    """Return the displacements (2,) from a prediction at which the alignment starts, the most likely one
    first. Along an axis that is known too poorly they go as far as they may, but none starts where both are.
    """
    variance, axes = np.linalg.eigh(covariance)
    std = np.sqrt(np.maximum(variance, 1e-12))
    steps = np.maximum(0, np.ceil(SEARCH_SIGMAS * std / STEP_PX - 0.5)).astype(int)
    if (steps > MOST_STEPS).all():
        return []
    each = [np.arange(-n, n + 1) * STEP_PX for n in np.minimum(steps, MOST_STEPS).tolist()]
    grid = np.array(list(product(*each)))
    order = np.argsort(((grid / std) ** 2).sum(axis=1), kind="stable")
    return [np.asarray(axes @ grid[k]) for k in order.tolist()]


def _squared(off: Array, covariance: Array) -> float:
    """Return the squared distance in standard deviations."""
    return float(off @ np.linalg.solve(covariance, off))


def _warped(
    template: AlignmentTemplate, other: AlignmentTemplate, H: Array, level: int
) -> tuple[Grey, NDArray[np.uint8]]:
    """Return the other picture as seen from the template, and which pixels both show."""
    grey = other.levels[level]
    size = grey.shape[::-1]
    warped = cv2.warpPerspective(grey, H, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    seen, here = (cv2.resize(t.seen, size, interpolation=cv2.INTER_NEAREST) for t in (other, template))
    common = cv2.warpPerspective(seen, H, size, flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    margin = np.ones((5, 5), np.uint8)  # the cubic's support, and that of the slope
    common = cv2.erode(common & here, margin, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(warped), np.asarray(common)


def _same_exposure(grey: Grey, other: Grey, common: NDArray[np.uint8]) -> Grey | None:
    """Return the other picture with the exposure of the first; None where nothing common is seen."""
    if np.count_nonzero(common) < WINDOW_PX**2:
        return None
    (mean_i, std_i), (mean_j, std_j) = (cv2.meanStdDev(g, mask=common) for g in (grey, other))
    gain = float(std_i[0, 0] / max(std_j[0, 0], 1e-6))
    return np.asarray((other - float(mean_j[0, 0])) * np.float32(gain) + float(mean_i[0, 0]), np.float32)


def _alike(template: AlignmentTemplate, other: AlignmentTemplate, H: Array) -> bool:
    """Return whether the aligned pictures are the same but for their exposure."""
    warped, common = _warped(template, other, H, 0)
    grey = template.levels[0]
    same = _same_exposure(grey, warped, common)
    if same is None:
        return False
    shown = common > 0
    return float((same - grey)[shown].var()) < MOST_UNEXPLAINED * float(grey[shown].var())


def _at_level(
    template: AlignmentTemplate,
    other: AlignmentTemplate,
    H: Array,
    predicted: Prediction,
    level: int,
    floor_px: float,
) -> tuple[Array, CornerStep] | None:
    """Return the homography between the whole pictures as improved at a level, and its last step.

    The steps before it hold the prediction, so that it stays in the directions that lines leave open.
    """
    width, height = template.levels[level].shape[::-1]
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=float)
    S = _reduction(level)
    H, expected = (S @ each @ np.linalg.inv(S) for each in (H, predicted.i_H_j))
    found, side_px = None, max(width, height)
    information = place_and_shape(predicted.covariance * S[0, 0] ** 2, side_px)
    for number in range(STEPS + 1):
        grey = template.levels[level]
        warped, common = _warped(template, other, H, level)
        same = _same_exposure(grey, warped, common)
        windows = measured(grey, same, common, level) if same is not None else None
        if windows is None:
            return None
        last = number == STEPS or (found is not None and np.abs(found.step).max() < STILL_PX[level])
        off = (transfer(H @ np.linalg.inv(expected), corners) - corners).ravel()
        found = solved(windows, corners, floor_px, side_px, None if last else CornerPrior(off, information))
        moved = (corners + found.step.reshape(4, 2)).astype(np.float32)
        H = np.asarray(cv2.getPerspectiveTransform(corners.astype(np.float32), moved) @ H, dtype=float)
        if not np.isfinite(H).all() or np.abs(found.step).max() > side_px:
            return None
        if last:
            break
    assert found is not None
    return np.asarray(np.linalg.inv(S) @ H @ S, dtype=float), found


def _reduction(level: int) -> Array:
    """Return the matrix (3, 3) from pixels of the whole picture to those of a level."""
    s = 1.0 / REDUCED if level else 1.0
    return np.array([[s, 0, 0.5 * s - 0.5], [0, s, 0.5 * s - 0.5], [0, 0, 1.0]])


def _of_corners(covariance: Array, H: Array, frame: FlowFrame, corners_px: Array) -> Array:
    """Return the covariance (8, 8) of the corners of picture j in i, in pixels of the camera."""
    width, height = frame.size_px
    own = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=float)
    landed = transfer(H, transfer(frame.reduced_H_full, corners_px))
    J = np.tile(frame.scale, 4)[:, None] * by_corners(landed, own).reshape(8, 8)
    found = J @ covariance @ J.T
    return np.asarray(0.5 * (found + found.T))
