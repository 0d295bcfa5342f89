"""Displacements of the windows of two pictures with edges, and the homography that they determine together.

Source: Shi and Tomasi 1994, section 3 (the structure tensor of a window).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.homography import CAUCHY_SIGMAS, jacobian
from frontend.robust import NORMAL, median

Array = NDArray[np.float64]
Grey = NDArray[np.float32]

WINDOW_PX = 16
"""Side of the windows."""
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
OTHER_PLACE_PX = 0.5
"""A line that moves so far between the pixels has the opposite error of interpolation, which repeats with the
pixels."""
SHAPE_SHARE = 0.01
"""Standard deviation of the shape of a predicted picture, over its side: tilt and height to a percent."""

_MEAN = np.tile(np.eye(2) / 4, 4)
"""(2, 8) mean displacement of four corners."""


class EdgeWindows(NamedTuple):
    """Windows with structure, in axes along and across their strongest edge."""

    axes: Array
    """(m, 2, 2) columns: the direction of least change, and that of most."""
    at: Array
    """(m, 2) middles."""
    moved: Array
    """(m, 2) displacement along the axes."""
    weight: Array
    """(m, 2) information relative to that across an edge."""


class CornerPrior(NamedTuple):
    """Prediction of the corners of picture i."""

    off: Array
    """(8,) displacement of the corners from it."""
    information: Array
    """(8, 8) px⁻²."""


class CornerStep(NamedTuple):
    """A step of the corners of picture i."""

    step: Array
    """(8,) px."""
    covariance: Array
    """(8, 8) px², of the corners of picture i."""


def is_structured(grey: Grey, seen: NDArray[np.uint8]) -> bool:
    """Return whether a picture shows edges in several windows."""
    x, y = (_slope(grey, *axis) for axis in ((1, 0), (0, 1)))
    # The last bit of OpenCV's magnitude depends on where an array lies in memory.
    change: Grey = np.sqrt(x * x + y * y)
    strongest = _block_max(change * seen)
    return int((strongest > LEAST_CONTRAST).sum()) >= LEAST_WINDOWS


def measured(grey: Grey, same: Grey, common: NDArray[np.uint8], level: int) -> EdgeWindows | None:
    """Measure the displacement of each window with structure; None where there is too little.

    ``same`` is the other picture with the exposure of ``grey``, as seen from there at the present homography,
    and ``common`` has the pixels that both show. ``level``: 0 whole pictures, 1 reduced ones.
    """
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
    return EdgeWindows(axes, at, moved, weight)


def solved(
    windows: EdgeWindows, corners: Array, floor_px: float, side_px: int, prior: CornerPrior | None
) -> CornerStep:
    """Solve for the corners in the directions that the windows determine.

    With a ``prior``, the corners stay as near to their prediction as its information says.

    Windows along a line see the same edge at a similar place between the pixels, so that the floor of their
    noise is common to as many of them as it takes a slanted line to move to another place.
    """
    of_corners = by_corners(windows.at, corners)
    J = np.einsum("mab,mac->mbc", windows.axes, of_corners).reshape(-1, 8)
    moved, weight = windows.moved.ravel(), windows.weight.ravel()
    across = np.abs(windows.moved[:, 1])
    spread = max(floor_px, NORMAL * median(across))
    robust = weight / (1.0 + (moved / (CAUCHY_SIGMAS * spread)) ** 2)
    A = np.asarray((J * robust[:, None]).T @ J)
    information, directions = np.linalg.eigh(A)
    used = weight > 0
    typical_px = np.sqrt((robust * moved**2).sum() / robust.sum())
    common_px = floor_px * np.sqrt(_sharing(windows, side_px))
    noise_px = np.hypot(typical_px, common_px)
    closed = information > (noise_px / OPEN_PX) ** 2
    more = used.sum() / max(1, used.sum() - closed.sum())
    noise_px = np.hypot(typical_px * np.sqrt(more), common_px)
    step = directions[:, closed] @ (
        (directions[:, closed].T @ (J.T @ (robust * moved))) / information[closed]
    )
    if prior is not None:
        right = J.T @ (robust * moved) / noise_px**2 - prior.information @ prior.off
        step = np.linalg.solve(A / noise_px**2 + prior.information, right)
    variance = np.full(8, float(side_px) ** 2)
    variance[closed] = noise_px**2 / information[closed]
    return CornerStep(step, np.asarray((directions * variance) @ directions.T, dtype=float))


def _sharing(windows: EdgeWindows, side_px: int) -> float:
    """Return how many windows along a line see it at a similar place between the pixels."""
    along = np.abs(windows.axes[:, :, 0])
    slant = along.min(axis=1) / along.max(axis=1)
    reach_px = np.clip(OTHER_PLACE_PX / np.maximum(slant, 1e-9), WINDOW_PX, side_px)
    return float(reach_px.mean() / WINDOW_PX)


def place_and_shape(covariance: Array, side_px: int) -> Array:
    """Return the information (8, 8) of the corners of a picture, whose mean displacement is predicted with a
    covariance (2, 2), and whose tilt and height are nearly right."""
    shape = (np.eye(8) - np.kron(np.full((4, 4), 0.25), np.eye(2))) / (SHAPE_SHARE * side_px) ** 2
    return np.asarray(shape + _MEAN.T @ np.linalg.inv(covariance) @ _MEAN)


def mean_shift(off: Array, covariance: Array, side_px: int) -> tuple[Array, Array]:
    """Return the mean displacement (2,) of four corners and its covariance (2, 2), for a picture of about the
    predicted shape.

    ``off`` (8,) are the displacements of the corners from their predictions, and ``covariance`` is theirs. A
    line across the others shows the place of a picture only with its shape: without it a stretch about that
    line is free.
    """
    information = np.linalg.inv(covariance)
    known = np.linalg.inv(information + place_and_shape(np.eye(2) * side_px**2, side_px))
    return _MEAN @ (known @ (information @ off)), np.asarray(_MEAN @ known @ _MEAN.T)


def by_corners(at: Array, corners: Array) -> Array:
    """Return the derivatives (m, 2, 8) of a homography near the identity at points by its corners."""

    def by_entries(pixel: Array) -> Array:
        return jacobian(pixel.T, np.column_stack([pixel, np.ones(len(pixel))]).T)

    return np.asarray(by_entries(at) @ np.linalg.inv(by_entries(corners))).reshape(-1, 2, 8)


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
