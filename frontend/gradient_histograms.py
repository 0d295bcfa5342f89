"""Descriptors of keypoints, those of SIFT: histograms of the gradients in a window at the keypoint's scale.

The layout of the 128 numbers is OpenCV's, so both describe a keypoint alike. Each keypoint has one
orientation, the strongest. A second one for a fifth of them would take the places of other keypoints.
Source: Lowe 2004, sections 5 and 6.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.scale_space import PICTURES, Keypoints, ScaleSpace

Floats = NDArray[np.float32]
Ints = NDArray[np.int64]

BINS, WEIGHT_SIGMAS, REACH_SIGMAS = 36, 1.5, 4.5
"""Bins of the orientations about a keypoint; standard deviation of their weights, and half the side of the
window, both in scales of the keypoint."""
CELLS, DIRECTIONS, CELL_SIGMAS = 4, 8, 3.0
"""Cells along a side of the described window, directions of gradients in each, and the side of a cell in
scales of the keypoint."""
LENGTH = CELLS * CELLS * DIRECTIONS
"""Numbers of a descriptor."""
LARGEST = 0.2
"""Largest share of one direction in one cell."""
ORIENTATION_SAMPLES, DESCRIPTION_SAMPLES = 11, 12
"""Samples along a side of the window. Twenty take twice the time of the description for as many matches."""


def descriptors(space: ScaleSpace, keypoints: Keypoints) -> Floats:
    """Return descriptors (n, 128) of keypoints, of unit length."""
    order = np.argsort(keypoints.octave * PICTURES + keypoints.layer, kind="stable")  # each picture at a time
    sorted_keypoints = keypoints[order]
    descriptor = np.empty((len(keypoints), LENGTH), np.float32)
    descriptor[order] = _descriptors(space, sorted_keypoints, _orientations(space, sorted_keypoints))
    return descriptor


def _orientations(space: ScaleSpace, keypoints: Keypoints) -> Floats:
    """Return the strongest direction (n,) of the gradients about each keypoint, in radians from x to y."""
    count = ORIENTATION_SAMPLES
    step = (2 * REACH_SIGMAS / (count - 1) * keypoints.sigma_px).astype(np.float32)
    strength, angle = cv2.cartToPolar(*_gradients(space, keypoints, step, np.zeros_like(step), count))
    off = np.linspace(-REACH_SIGMAS, REACH_SIGMAS, count)
    strength *= np.exp(-(off[:, None] ** 2 + off**2) / (2 * WEIGHT_SIGMAS**2)).astype(np.float32).ravel()
    angle *= np.float32(BINS / (2 * np.pi))
    angle += np.float32(0.5)
    each = angle.astype(np.int32)
    each[each >= BINS] -= BINS
    each += (np.arange(len(keypoints), dtype=np.int32) * BINS)[:, None]
    histogram = np.bincount(each.ravel(), strength.ravel(), len(keypoints) * BINS).reshape(-1, BINS)
    wrapped = np.concatenate([histogram[:, -2:], histogram, histogram[:, :2]], axis=1)
    smooth = sum(share * wrapped[:, k : k + BINS] for k, share in enumerate(np.array([1, 4, 6, 4, 1]) / 16))
    row, peak = np.arange(len(keypoints)), np.argmax(smooth, axis=1)
    before, top, after = (smooth[row, (peak + k) % BINS] for k in (-1, 0, 1))
    curvature = before - 2 * top + after
    off_peak = np.divide(0.5 * (before - after), curvature, out=np.zeros_like(top), where=curvature < 0)
    return np.asarray((peak + off_peak) * (2 * np.pi / BINS), dtype=np.float32)


def _descriptors(space: ScaleSpace, keypoints: Keypoints, angle: Floats) -> Floats:
    """Return descriptors (n, 128) of keypoints at orientations (n,)."""
    count = DESCRIPTION_SAMPLES
    step = ((CELLS + 1) * CELL_SIGMAS / count * keypoints.sigma_px).astype(np.float32)
    gx, gy = _gradients(space, keypoints, np.cos(angle) * step, np.sin(angle) * step, count)
    # A direction gets the cosine of a gradient beyond that of half a right angle, not a linear share.
    # The last bit of OpenCV's magnitude depends on where an array lies in memory.
    least = np.sqrt(gx * gx + gy * gy) * np.float32(np.cos(2 * np.pi / DIRECTIONS))
    by_direction = np.empty((DIRECTIONS, len(keypoints), CELLS * CELLS), np.float32)
    along, weight = np.empty_like(gx), _cell_weights(count)
    for k in range(DIRECTIONS // 2):
        turn = 2 * np.pi * k / DIRECTIONS
        cv2.addWeighted(gx, np.cos(turn), gy, np.sin(turn), 0, dst=along)
        # OpenCV counts directions from y to x.
        for direction, share in ((-k, along - least), (DIRECTIONS // 2 - k, -along - least)):
            np.matmul(np.maximum(share, 0, out=share), weight, out=by_direction[direction])
    found = np.ascontiguousarray(by_direction.transpose(1, 2, 0)).reshape(len(keypoints), -1)
    for largest in (LARGEST, 1.0):
        found /= np.sqrt(np.einsum("nk,nk->n", found, found))[:, None] + np.float32(1e-12)
        np.minimum(found, np.float32(largest), out=found)
    return found


def _gradients(
    space: ScaleSpace, keypoints: Keypoints, cosine: Floats, sine: Floats, count: int
) -> tuple[Floats, Floats]:
    """Return the gradients (n, count²) of a window about each keypoint along x and y; 0 outside the picture.

    ``cosine``, ``sine`` (n,): the step from a sample to the next one in pixels of the octave, times those of
    the window's direction. Keypoints are sorted by their pictures.
    """
    side, n = count + 2, len(keypoints)
    u, v = _grid(side)
    x, y = (np.ascontiguousarray(axis[:, None], dtype=np.float32) for axis in keypoints.at_px.T)
    x, y = x + cosine[:, None] * u - sine[:, None] * v, y + sine[:, None] * u + cosine[:, None] * v
    sample, width = np.empty((n, side * side), np.int16), np.empty((2, n), np.float32)
    picture = keypoints.octave * PICTURES + keypoints.layer
    begin = np.flatnonzero(np.diff(picture, prepend=-1))
    for a, b in zip(begin.tolist(), [*begin[1:].tolist(), n], strict=False):
        source = space.blurred[keypoints.octave[a]][keypoints.layer[a] - 1]
        cv2.remap(source, x[a:b], y[a:b], cv2.INTER_LINEAR, dst=sample[a:b], borderMode=cv2.BORDER_REPLICATE)
        width[:, a:b] = np.array(source.shape[::-1])[:, None]
    window = sample.reshape(n, side, side)
    gradient = np.empty((2, n, count, count), np.float32)
    np.subtract(window[:, 1:-1, 2:], window[:, 1:-1, :-2], out=gradient[0])
    np.subtract(window[:, 2:, 1:-1], window[:, :-2, 1:-1], out=gradient[1])
    at_px, reach = keypoints.at_px.T, np.hypot(cosine, sine) * side / np.sqrt(2)
    near = np.flatnonzero(((at_px < reach) | (at_px > width - 1 - reach)).any(axis=0))
    if len(near):
        within = (x[near] >= 0) & (y[near] >= 0)
        within &= (x[near] <= width[0, near, None] - 1) & (y[near] <= width[1, near, None] - 1)
        gradient[:, near] *= within.reshape(-1, side, side)[:, 1:-1, 1:-1]
    gx, gy = gradient.reshape(2, n, -1)
    return gx, gy


@cache
def _grid(side: int) -> tuple[Floats, Floats]:
    """Return the offsets (side²,) along both axes of the samples of a window from its middle, row by row."""
    off = np.arange(side, dtype=np.float32) - np.float32((side - 1) / 2)
    return np.tile(off, side), np.repeat(off, side)


@cache
def _cell_weights(count: int) -> Floats:
    """Return the weights (count², 16) of the samples in each cell: bilinear, less far from the middle."""
    at = (np.arange(count) - (count - 1) / 2) * (CELLS + 1) / count
    near = np.maximum(0.0, 1.0 - np.abs(at[:, None] - (np.arange(CELLS) - (CELLS - 1) / 2)))
    near *= np.exp(-(at**2) / (2 * (CELLS / 2) ** 2))[:, None]
    weight = np.einsum("yr,xc->yxrc", near, near)
    return np.asarray(weight.reshape(count * count, CELLS * CELLS), dtype=np.float32)
