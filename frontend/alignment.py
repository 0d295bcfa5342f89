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
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.flow import NOISE_FLOOR
from frontend.flow_frame import FlowFrame
from frontend.gates import GateConfig, local_scale
from frontend.homography import CAUCHY_SIGMAS, HomographyConfig, jacobian, transfer
from frontend.registration import Registration, overlap
from frontend.robust import NORMAL, median

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Grey = NDArray[np.float32]

WINDOW_PX = 16
"""Side of the windows."""
BLUR_PX = 1.2
"""Standard deviation of the blur before the pictures are compared: pixels sample a sharp edge too coarsely to
be interpolated, and show steps along a slanted line that move with the pixels."""
REDUCED = 4
"""Reduction of the first level. Its reach is several of its pixels, less than the distance of two lines."""
LINE_SHARE = 0.08
"""Least share of the information across a line that detail along it must have: noise of the pixels and steps
along a slanted line have less."""
VISIBLE_SHARE = 0.1
"""Least information of a window over that of a typical one with a line."""
LEAST_CONTRAST = 5.0
"""Least change of the grey level, per pixel of the blurred picture, at the strongest edges: several standard
deviations of the noise of a camera's pixels."""
LEAST_WINDOWS = 6
"""Fewest windows with structure: two lines across half a picture."""
OPEN_PX = 1.0
"""A direction in which the corners of the picture would have a larger standard deviation is open: detail of
the pictures farther apart is no longer the same."""
SHAPE_SHARE = 0.01
"""Standard deviation of the shape of a predicted picture, over its side: tilt and height to a percent."""
STEPS, STILL_PX = 12, 5e-3
"""Most Gauss-Newton steps at a level, and the displacement below which it ends."""
AROUND_PX = 2.0
"""If the pictures do not come to look alike, the start is moved by so many reduced pixels each way."""
MOST_UNEXPLAINED = 0.1
"""Largest share of the variance of the common picture that may differ after the alignment."""


class _Windows(NamedTuple):
    """Windows with structure, in axes along and across their strongest edge."""

    axes: Array
    """(m, 2, 2) columns: the direction of least change, and that of most."""
    at: Array
    """(m, 2) middles."""
    moved: Array
    """(m, 2) displacement along the axes."""
    weight: Array
    """(m, 2) information relative to that across an edge."""


class _Solution(NamedTuple):
    """A step of the corners of picture i."""

    step: Array
    """(8,) px."""
    covariance: Array
    """(8, 8) px², of the corners of picture i."""


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
        grey = self.levels[0]
        change = cv2.magnitude(*(_slope(grey, *axis) for axis in ((1, 0), (0, 1))))
        strongest = _block_max(change * self.seen)
        return int((strongest > LEAST_CONTRAST).sum()) >= LEAST_WINDOWS

    def register(
        self,
        i: int,
        j: int,
        other: AlignmentTemplate,
        predicted: Array,
        lead: float,
        homography: HomographyConfig,
        gates: GateConfig,
    ) -> Registration | None:
        """Register picture j, ``other``, to this picture i, starting at a predicted homography (3, 3).

        ``lead``: as in `frontend.motions.Expectation`.

        None where the pictures do not come to look alike.
        """
        corners = self.frame.camera.undistort(self.frame.camera.corners_px)
        to, floor_px = self.frame.reduced_H_full, NOISE_FLOOR * homography.noise_floor_px
        start = to @ predicted @ np.linalg.inv(to)
        for right, down in product(*(AROUND_PX * REDUCED * np.array([[0, 1, -1]] * 2))):
            shift = np.array([[1, 0, right], [0, 1, down], [0, 0, 1]])
            aligned = self._from_start(other, shift @ start, floor_px, gates)
            if aligned is not None:
                break
        else:
            return None
        H, covariance = aligned
        i_H_j = np.asarray(np.linalg.inv(to) @ H @ to, dtype=float)
        i_H_j /= i_H_j[2, 2]
        covered = overlap(i_H_j, self.frame.camera)
        return Registration(
            i=i, j=j, reason="", matches=np.empty((0, 2), np.int32), i_H_j=i_H_j,
            corner_covariance=_of_corners(covariance, H, self.frame, corners), noise_px=floor_px,
            overlap=covered, least_overlap=covered, lead=lead, by_lines=True,
        )  # fmt: skip

    def _from_start(
        self, other: AlignmentTemplate, H: Array, floor_px: float, gates: GateConfig
    ) -> tuple[Array, Array] | None:
        """Return the homography from the other picture that a start leads to, and the covariance of the
        corners of this one; None where the pictures do not come to look alike."""
        covariance = np.empty((8, 8))
        for level in (1, 0):
            aligned = _at_level(self, other, H, level, floor_px)
            if aligned is None:
                return None
            H, covariance = aligned[0], aligned[1].covariance
        to, camera = self.frame.reduced_H_full, self.frame.camera
        i_H_j = np.asarray(np.linalg.inv(to) @ H @ to, dtype=float)
        if overlap(i_H_j, camera) < gates.min_overlap or not _alike(self, other, H):
            return None
        plausible = 1.0 / gates.max_scale < local_scale(i_H_j, camera) < gates.max_scale
        return (H, covariance) if plausible else None


def _slope(grey: Grey, right: int, down: int) -> Grey:
    """Return the change of the grey level per pixel."""
    return np.asarray(cv2.Sobel(grey, cv2.CV_32F, right, down, ksize=1, scale=0.5))


def _blocks(values: Grey) -> Grey:
    """Return the values (rows, WINDOW_PX, columns, WINDOW_PX) of whole windows."""
    h, w = (size // WINDOW_PX for size in values.shape)
    return values[: h * WINDOW_PX, : w * WINDOW_PX].reshape(h, WINDOW_PX, w, WINDOW_PX)


def _block_sum(values: Grey) -> Array:
    return np.asarray(_blocks(values).sum(axis=(1, 3), dtype=float)).ravel()


def _block_max(values: Grey) -> Array:
    return np.asarray(_blocks(values).max(axis=(1, 3))).ravel()


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
    template: AlignmentTemplate, other: AlignmentTemplate, H: Array, level: int, floor_px: float
) -> tuple[Array, _Solution] | None:
    """Return the homography between the whole pictures as improved at a level, and its last step."""
    width, height = template.levels[level].shape[::-1]
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=float)
    S = _reduction(level)
    H = S @ H @ np.linalg.inv(S)
    found, predicted = None, H
    for number in range(STEPS + 1):
        windows = _windows(template, other, H, level)
        if windows is None:
            return None
        last = number == STEPS or (found is not None and np.abs(found.step).max() < STILL_PX)
        off = None if last else (transfer(H @ np.linalg.inv(predicted), corners) - corners).ravel()
        found = _solved(windows, corners, floor_px, max(width, height), off)
        moved = (corners + found.step.reshape(4, 2)).astype(np.float32)
        H = np.asarray(cv2.getPerspectiveTransform(corners.astype(np.float32), moved) @ H, dtype=float)
        if not np.isfinite(H).all() or np.abs(found.step).max() > max(width, height):
            return None
        if last:
            break
    assert found is not None
    return np.asarray(np.linalg.inv(S) @ H @ S, dtype=float), found


def _reduction(level: int) -> Array:
    """Return the matrix (3, 3) from pixels of the whole picture to those of a level."""
    s = 1.0 / REDUCED if level else 1.0
    return np.array([[s, 0, 0.5 * s - 0.5], [0, s, 0.5 * s - 0.5], [0, 0, 1.0]])


def _windows(template: AlignmentTemplate, other: AlignmentTemplate, H: Array, level: int) -> _Windows | None:
    """Measure the displacement of each window with structure; None where there is too little."""
    grey = template.levels[level]
    warped, common = _warped(template, other, H, level)
    same = _same_exposure(grey, warped, common)
    if same is None:
        return None
    middle = 0.5 * (grey + same)
    x, y = (_slope(middle, *axis) * common for axis in ((1, 0), (0, 1)))
    off = same - grey
    tensor = np.array([[_block_sum(x * x), _block_sum(x * y)], [_block_sum(x * y), _block_sum(y * y)]])
    right = np.array([_block_sum(x * off), _block_sum(y * off)])
    strength, axes = np.linalg.eigh(np.moveaxis(tensor, 2, 0))
    visible = strength[:, 1] > LEAST_CONTRAST**2 * WINDOW_PX / (1 + 15 * level)
    if np.count_nonzero(visible) < (LEAST_WINDOWS if level == 0 else 1):
        return None
    visible &= strength[:, 1] > VISIBLE_SHARE * median(strength[visible, 1])
    strength, axes = strength[visible], axes[visible]
    moved = np.einsum("mba,bm->ma", axes, right[:, visible]) / np.maximum(strength, 1e-9)
    share = strength[:, 0] / strength[:, 1]
    whole = np.minimum(1.0, strength[:, 1] / median(strength[:, 1]))
    weight = np.column_stack([np.where(share > LINE_SHARE, share, 0.0), np.ones(len(share))]) * whole[:, None]
    energy = x * x + y * y
    row, column = np.indices(grey.shape, dtype=np.float32)
    total = _block_sum(energy)[visible]
    at = np.column_stack([_block_sum(energy * along)[visible] / total for along in (column, row)])
    return _Windows(axes, at, moved, weight)


def _solved(windows: _Windows, corners: Array, floor_px: float, side_px: int, off: Array | None) -> _Solution:
    """Solve for the corners in the directions that the windows determine.

    With the displacement ``off`` (8,) from the prediction, the shape of the picture is held near that of the
    prediction, whose tilt and height are nearly right.

    Windows along a line see the same edge at a similar place between the pixels, so that the floor of their
    noise is common to all of them, as many as reach across the picture.
    """
    of_corners = _by_corners(windows.at, corners)
    J = np.einsum("mab,mac->mbc", windows.axes, of_corners).reshape(-1, 8)
    moved, weight = windows.moved.ravel(), windows.weight.ravel()
    across = np.abs(windows.moved[:, 1])
    spread = max(floor_px, NORMAL * median(across))
    robust = weight / (1.0 + (moved / (CAUCHY_SIGMAS * spread)) ** 2)
    A = np.asarray((J * robust[:, None]).T @ J)
    information, directions = np.linalg.eigh(A)
    used = weight > 0
    typical_px = np.sqrt((robust * moved**2).sum() / robust.sum())
    noise_px = np.sqrt(typical_px**2 + floor_px**2 * side_px / WINDOW_PX)
    closed = information > (noise_px / OPEN_PX) ** 2
    more = used.sum() / max(1, used.sum() - closed.sum())
    noise_px = np.sqrt(typical_px**2 * more + floor_px**2 * side_px / WINDOW_PX)
    step = directions[:, closed] @ (
        (directions[:, closed].T @ (J.T @ (robust * moved))) / information[closed]
    )
    if off is not None:
        shape = (np.eye(8) - np.kron(np.full((4, 4), 0.25), np.eye(2))) / (SHAPE_SHARE * side_px) ** 2
        held = shape + np.eye(8) / side_px**2
        step = np.linalg.solve(A / noise_px**2 + held, J.T @ (robust * moved) / noise_px**2 - held @ off)
    variance = np.full(8, float(side_px) ** 2)
    variance[closed] = noise_px**2 / information[closed]
    return _Solution(step, np.asarray((directions * variance) @ directions.T, dtype=float))


def _by_corners(at: Array, corners: Array) -> Array:
    """Return the derivatives (m, 2, 8) of a homography near the identity at points by its corners."""

    def by_entries(pixel: Array) -> Array:
        return jacobian(pixel.T, np.column_stack([pixel, np.ones(len(pixel))]).T)

    return np.asarray(by_entries(at) @ np.linalg.inv(by_entries(corners))).reshape(-1, 2, 8)


def _of_corners(covariance: Array, H: Array, frame: FlowFrame, corners_px: Array) -> Array:
    """Return the covariance (8, 8) of the corners of picture j in i, in pixels of the camera."""
    width, height = frame.size_px
    own = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=float)
    landed = transfer(H, transfer(frame.reduced_H_full, corners_px))
    J = np.tile(frame.scale, 4)[:, None] * _by_corners(landed, own).reshape(8, 8)
    found = J @ covariance @ J.T
    return np.asarray(0.5 * (found + found.T))
