"""Specular highlights: images of lamps in a reflecting floor, which move more slowly than the floor.

The mirror image of a lamp lies far below the floor. When the camera moves, its spot therefore moves more
slowly over the picture than the floor does. An object on the floor moves faster, and paint moves with the
floor. Two pictures overlaid by the floor's homography show the spot at two places. The displacement between
them is opposite to the floor's optical flow.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import center_of_mass, label, maximum

from frontend.camera import Camera
from frontend.homography import transfer
from frontend.robust import robust_std
from slam.data_quality.pictures.overlaid import Image, Overlaid, overlaid, shrunk

Array = NDArray[np.float64]

WIDTH_PX = 88
"""Greatest width of the reduced pictures; spots are larger than their pixels."""
SMOOTH_PX = 3
LEAST_LEVELS, DEVIATIONS = 25.0, 6.0
"""Smallest excess of a spot over the floor, in grey levels and in robust standard deviations of the
difference of the pictures."""
LEAST_SEEN = 0.3
"""Least overlap of two pictures, as a share of the picture."""
MOST_TURN = 0.1
"""Greatest rotation between two pictures in radians, as everything visible rotates alike."""
LEAST_AREA = 1e-3
"""Smallest area of a spot, as a share of the picture."""
MOST_FLOW, LEAST_FLOW = 0.5, 0.015
"""Range of the floor's flow between two pictures, in picture widths, in which a spot can be tracked."""
LEAST_LAG = 0.15
"""Least lag of a spot, as a share of the floor's flow; more than 1 where a spot hides the centre of another.
"""
ACROSS = 0.5
"""Largest motion across the flow, as a share of the motion along it."""
FEWEST_PAIRS, MOSTLY = 6, 0.6
"""Least number of pairs of pictures with lagging spots, and least ratio to the number of pairs with other
spots. The ratio was 0.2 to 0.3 for boxes and moving objects, and 0.9 or more for lamps; healthy pictures have
no spots."""

SATURATED = 1.5
"""Factor from the strongest spots to a lamp's greatest strength: spots on a bright floor saturate."""


@dataclass(frozen=True)
class Spots:
    """Bright spots of a pair of pictures that do not move with the floor."""

    lagging: int
    """Number of spots that move more slowly than the floor."""
    others: int
    """Number of other spots: objects that move or stand on the floor."""
    strength: float
    """Excess of the brightest lagging spot over the floor, as a share of white; NaN without any."""


def are_lamps(found: Array) -> bool:
    """Return whether spots are lamps. The rows (k, >= 2) of ``found`` are the numbers of lagging and of other
    spots in each pair of pictures."""
    lagging, otherwise = (int(np.sum(found[:, k] > 0)) for k in (0, 1))
    return lagging >= FEWEST_PAIRS and lagging >= MOSTLY * otherwise


def strength_of(found: Array) -> tuple[float, float, float]:
    """Return a lamp's strength and the ends of its interval, from spots (k, 3) with strengths."""
    low, strength, high = np.quantile(found[found[:, 0] > 0, 2], [0.5, 0.75, 0.9]).tolist()
    return strength, 0.9 * low, SATURATED * high


def dimmed(image: Image) -> Image:
    """Return the reduced picture of the darkest colour of each pixel: white light raises all three."""
    return shrunk(image if image.ndim == 2 else image.min(axis=2), WIDTH_PX)


def spots(dim_i: Image, dim_j: Image, i_H_j: Array, camera: Camera) -> Spots:
    """Find bright spots in two dimmed pictures of one camera, given the floor's homography between
    undistorted pixels."""
    nothing = Spots(0, 0, np.nan)
    j_H_i = np.asarray(np.linalg.inv(i_H_j), dtype=np.float64)
    middle = np.array([camera.center_px])
    flow = float(np.linalg.norm(middle - transfer(j_H_i, middle))) / camera.size_px[0]
    turn = abs(float(np.arctan2(j_H_i[1, 0] - j_H_i[0, 1], j_H_i[0, 0] + j_H_i[1, 1])))
    if not LEAST_FLOW < flow < MOST_FLOW or turn > MOST_TURN:
        return nothing
    laid = overlaid(dim_i, dim_j, i_H_j, camera)
    pixel, seen, excess = laid.is_px.reshape(-1, 2), laid.seen, _excess(laid, dim_i)
    if seen.mean() < LEAST_SEEN:
        return nothing
    threshold = max(LEAST_LEVELS, DEVIATIONS * robust_std(excess[seen]))
    if excess.max() < threshold or excess.min() > -threshold:
        return nothing
    here, gone = (_blobs(side * excess, threshold, seen) for side in (1, -1))
    lagging, others, strength = 0, 0, np.nan
    for at, level in here:
        if not gone:
            break
        was: Array = min((pixel[b] for b, _ in gone), key=lambda p: float(np.linalg.norm(p - pixel[at])))
        moved = was - transfer(j_H_i, was[None])[0]
        behind, length = pixel[at] - was, float(np.linalg.norm(moved))
        share = -float(behind @ moved) / max(length, 1e-9) ** 2
        across = float(np.linalg.norm(behind + share * moved))
        if share > LEAST_LAG and across < ACROSS * share * length:
            lagging, strength = lagging + 1, np.fmax(strength, level / 255.0)
        else:
            others += 1
    return Spots(lagging, others, float(strength))


def _excess(laid: Overlaid, dim_i: Image) -> Array:
    """Return (h, w) the smoothed excess of i over the overlaid picture, 0 outside the overlap."""
    over = np.where(laid.seen, dim_i.astype(np.float32) - laid.other, np.float32(0.0))
    return np.asarray(cv2.blur(over, (SMOOTH_PX, SMOOTH_PX)).astype(np.float64))


def _blobs(excess: Array, threshold: float, seen: NDArray[np.bool_]) -> list[tuple[int, float]]:
    """Return the flat index of the centre and the peak of each region above the threshold that lies inside
    the overlap."""
    labels, count = label(excess > threshold)
    inside = cv2.erode(seen.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    area, cut = (np.bincount(labels[part], minlength=count + 1) for part in (seen, ~inside))
    found = [k for k in range(1, count + 1) if area[k] > LEAST_AREA * labels.size and cut[k] == 0]
    if not found:
        return []
    middles = np.rint(center_of_mass(excess, labels, found)).astype(np.int64)
    peaks = maximum(excess, labels, found)
    return [(int(y * labels.shape[1] + x), float(p)) for (y, x), p in zip(middles, peaks, strict=True)]
