"""Heights of the ground from two placed pictures: rectification, semi-global matching, and the way back.

Both pictures are turned in place until their rows run along the base between the cameras and they look down
as far as that allows. Points then differ by a disparity along the row alone (Fusiello, Trucco and Verri 2000,
A compact algorithm for rectification of stereo pairs). Semi-global matching finds it (Hirschmueller 2008,
Stereo processing by semi-global matching and mutual information; OpenCV's variant).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.mosaic.view import Lattice, MosaicView, homography_maps

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]

BLOCK_PX = 3
"""Side of the matched blocks: the smallest, as larger ones widen roofs by half their side."""
SMALL_STEP, LARGE_STEP = 8 * BLOCK_PX**2, 32 * BLOCK_PX**2
"""Costs of a change of disparity by one, and by more: OpenCV's recommendation for one channel."""
UNIQUE_PERCENT = 5
"""Margin in percent by which the best cost must be below the next: OpenCV's recommendation is 5 to 15."""
SPECKLE_PX, SPECKLE_STEP = 100, 2
"""Regions of less than this area whose disparity differs from their surroundings' are dropped, likewise."""
MOST_GROWTH = 2.0
"""Pixels of a turned picture over those for a level base. With more, a pixel of the picture is stretched over
several, which tell no more than it did."""
STEP = 16
"""Disparities of `cv2.StereoSGBM` are multiples of 1/16 px, and their number is a multiple of 16."""


@dataclass(frozen=True)
class Placed:
    """A picture, and where it was taken from."""

    camera: Camera
    view: MosaicView
    grey: Image
    """(h, w); perhaps reduced from the camera's size."""

    @property
    def w_p_c_m(self) -> Array:
        """Position of the camera over the floor z = 0."""
        return np.array([*self.view.w_p_c_m[:2], self.view.height_m])

    @property
    def c_R_w(self) -> Array:
        """Rotation from the world to the camera."""
        east, north = (np.linalg.inv(self.camera.matrix) @ self.view.pixel_H_floor)[:, :2].T
        return np.column_stack([east, north, np.cross(east, north)])


@dataclass(frozen=True)
class Rectified:
    """Common axes of two pictures, and the rectangle of their rows and columns over a piece of ground."""

    v_R_w: Array
    """Rotation from the world to the rectified axes: x along the base, z down."""
    base_m: float
    focal_px: float
    left_px: float
    """Position u of column 0 of the first picture."""
    top_px: float
    """Position v of row 0."""
    offset_px: float
    """Disparity f B / Z of a pixel of disparity 0."""
    disparities: int
    first: int
    """Disparity of the lowest ground that is searched."""
    last: int
    """Disparity of the highest ground that is searched; those beyond it fill the last `STEP`."""
    rows: int
    cols: int


def rectified(
    a: Placed, b: Placed, lattice: Lattice, heights_m: tuple[float, float], gsd_m: float
) -> Rectified | None:
    """Return the rectification of two pictures over a lattice, for heights from the lowest to the highest.

    None for a base so steep that the turned pictures would look past the ground, or grow by `MOST_GROWTH`.
    """
    base = b.w_p_c_m - a.w_p_c_m
    east, south = lattice.step_m * np.array([lattice.cols, lattice.rows])
    x0, y0 = lattice.x0_m - lattice.step_m / 2, lattice.y0_m + lattice.step_m / 2
    corners = np.array([(x0 + e, y0 - s, h) for e in (0, east) for s in (0, south) for h in heights_m])
    focal = a.view.height_m / gsd_m
    found, level = (
        _rectangle(along, float(np.linalg.norm(base)), focal, corners - a.w_p_c_m)
        for along in (base, base * [1.0, 1.0, 0.0])
    )
    if found is None or level is None or found.rows * found.cols > MOST_GROWTH * level.rows * level.cols:
        return None
    return found


def _rectangle(along: Array, base_m: float, focal_px: float, corners: Array) -> Rectified | None:
    """Return the rectification with rows ``along`` (3,) over corners (n, 3), both from the first camera.

    None where the turned picture does not look at all corners.
    """
    if not np.linalg.norm(along[:2]) > 0:
        return None
    x = along / np.linalg.norm(along)
    z = np.array([0.0, 0.0, -1.0]) - x * -x[2]
    z /= np.linalg.norm(z)
    v_R_w = np.array([x, np.cross(z, x), z])
    v_p = corners @ v_R_w.T
    if (v_p[:, 2] <= 0).any():
        return None
    u, v = focal_px * v_p[:, 0] / v_p[:, 2], focal_px * v_p[:, 1] / v_p[:, 2]
    disparity = focal_px * base_m / v_p[:, 2]
    offset = float(np.floor(disparity.min()) - 1)
    last = int(np.ceil(disparity.max() - offset))
    count = -(-(last + 2) // STEP) * STEP
    # Matching needs as many columns to the left of a pixel as there are disparities.
    left, top = float(np.floor(u.min())) - count, float(np.floor(v.min()))
    return Rectified(
        v_R_w=v_R_w, base_m=base_m, focal_px=focal_px, left_px=left, top_px=top,
        offset_px=offset, disparities=count, first=1, last=last, rows=int(np.ceil(v.max() - top)) + 1,
        cols=int(np.ceil(u.max() - left)) + 1,
    )  # fmt: skip


@dataclass(frozen=True)
class GroundPoints:
    """Points of the ground that match in two pictures."""

    w_p_m: Array
    """(n, 3) the points over the floor."""
    range_in_view: NDArray[np.bool_]
    """(n,) whether the second picture shows the point at each height of the search. Beside its border the
    true match may lie outside, and the best that is left may be wrong."""


def ground_points(a: Placed, b: Placed, over: Rectified) -> GroundPoints:
    """Return the points of the ground over the floor that match in both pictures."""
    left, inside = _turned(a, over, over.left_px)
    right, inside_right = _turned(b, over, over.left_px - over.offset_px)
    matcher = cv2.StereoSGBM.create(
        minDisparity=0, numDisparities=over.disparities, blockSize=BLOCK_PX, P1=SMALL_STEP, P2=LARGE_STEP,
        disp12MaxDiff=1, preFilterCap=31, uniquenessRatio=UNIQUE_PERCENT, speckleWindowSize=SPECKLE_PX,
        speckleRange=SPECKLE_STEP, mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    disparity = matcher.compute(left, right).astype(np.float32) / STEP
    # The best disparity at an end of the range is no minimum: beyond it may be a better one.
    r, c = np.nonzero(inside & (disparity > over.first) & (disparity < over.last))
    d = disparity[r, c]

    def shown(d: Float32 | int) -> NDArray[np.bool_]:
        return np.asarray(inside_right[r, np.clip(np.rint(c - d).astype(int), 0, over.cols - 1)])

    seen = shown(d)
    range_in_view = (shown(over.first) & shown(over.last))[seen]
    r, c, d = r[seen], c[seen], d[seen].astype(float)
    depth = over.focal_px * over.base_m / (d + over.offset_px)
    v_p = np.column_stack([c + over.left_px, r + over.top_px, np.full(len(r), over.focal_px)])
    w_p_m = np.asarray(v_p * (depth / over.focal_px)[:, None] @ over.v_R_w + a.w_p_c_m)
    return GroundPoints(w_p_m, range_in_view)


def _turned(placed: Placed, over: Rectified, left_px: float) -> tuple[Image, NDArray[np.bool_]]:
    """Return a picture in the rectified axes, and where it has content."""
    f = over.focal_px
    ray_H_node = (
        placed.c_R_w
        @ over.v_R_w.T
        @ np.array([[1 / f, 0, left_px / f], [0, 1 / f, over.top_px / f], [0, 0, 1]])
    )
    u, v = homography_maps(placed.camera, ray_H_node, over.rows, over.cols)
    w, h = placed.camera.size_px
    x, y, z = (
        (a * np.arange(over.cols) + c).astype(np.float32)[None]
        + (b * np.arange(over.rows)).astype(np.float32)[:, None]
        for a, b, c in ray_H_node
    )
    in_field = placed.view.in_field(z, np.sqrt(x * x + y * y + z * z))
    inside = in_field & (u >= 0) & (u <= w - 1) & (v >= 0) & (v <= h - 1)
    sx, sy = placed.grey.shape[1] / w, placed.grey.shape[0] / h
    at = ((u + 0.5) * np.float32(sx) - 0.5, (v + 0.5) * np.float32(sy) - 0.5)
    return np.asarray(cv2.remap(placed.grey, *at, cv2.INTER_CUBIC)), inside
