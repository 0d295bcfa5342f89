"""Surface of the ground under a mosaic: heights over the floor, and what they hide from a camera."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from hashlib import blake2b

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.mosaic.view import Lattice, MosaicView, pixel_maps, raised_maps, visible

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]


MOST_LINES = 20_000
"""Largest number of lines of sight, below the largest side of a picture that `cv2.remap` accepts."""


class HeightSource(IntEnum):
    """Origin of a height."""

    FLOOR = 0
    """The floor: nothing shows that the ground is not flat here."""
    PICTURES = 1
    """Matched between pictures."""
    SONAR = 2
    """Measured by the sonar alone."""
    FILLED = 3
    """Not measured: taken from the lowest neighbours."""
    UNSEEN = 4
    """No picture of the mosaic shows the ground."""
    LEVEL = 5
    """Taken as the floor: no two pictures show the ground, so that nothing was compared."""


@dataclass(frozen=True)
class Surface:
    """Heights over the floor on a lattice; cell (r, c) has its centre at x = west + (c + 1/2) cell,
    y = north - (r + 1/2) cell.

    Beyond its cells the ground is as high as at its border: a mosaic ends on whole cells of its own.
    """

    west_m: float
    north_m: float
    cell_m: float
    height_m: Float32
    """(rows, cols) height over the floor."""
    std_m: Float32
    """(rows, cols) standard deviation of the height; NaN where it was filled."""
    source: NDArray[np.uint8]
    """(rows, cols) ``HeightSource`` of each height."""

    @property
    def on_floor(self) -> Mask:
        """(rows, cols) whether the height is that of the floor, found flat or taken as level."""
        return np.isin(self.source, (HeightSource.FLOOR, HeightSource.LEVEL))

    @property
    def measured(self) -> Mask:
        """(rows, cols) whether pictures or the sonar measured the height."""
        return np.isin(self.source, (HeightSource.PICTURES, HeightSource.SONAR))

    @cached_property
    def digest(self) -> bytes:
        """Digest of the heights and their place."""
        place = repr((self.west_m, self.north_m, self.cell_m, self.height_m.shape))
        return blake2b(place.encode() + self.height_m.tobytes(), digest_size=16).digest()

    def heights(self, lattice: Lattice) -> Float32 | None:
        """Return the interpolated heights (rows, cols) at the nodes of a lattice.

        None where all of them are 0, so that the floor's homography describes the ground.
        """
        heights = self._on(lattice, self.height_m, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE)
        return heights if heights.any() else None

    def nearest(self, lattice: Lattice, values: Float32) -> Float32:
        """Return (rows, cols) values of the cells, on the surface's own lattice, that hold the nodes of
        another one; NaN beyond the surface."""
        return self._on(lattice, values, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT)

    def _on(self, lattice: Lattice, values: Float32, how: int, border: int) -> Float32:
        step = lattice.step_m / self.cell_m
        left = (lattice.x0_m - self.west_m) / self.cell_m - 0.5
        above = (self.north_m - lattice.y0_m) / self.cell_m - 0.5
        cell_H_node = np.array([[step, 0.0, left], [0.0, step, above]])
        size = (lattice.cols, lattice.rows)
        flags = how | cv2.WARP_INVERSE_MAP
        return np.asarray(
            cv2.warpAffine(values, cell_H_node, size, flags=flags, borderMode=border, borderValue=np.nan)
        )

    def hidden(self, view: MosaicView, lattice: Lattice) -> Mask:
        """Return (rows, cols) whether higher ground hides a node of the lattice from the camera.

        It is found for each cell of the surface, or for each node if these are farther apart.
        """
        group = max(1, round(self.cell_m / lattice.step_m))
        first = (group - 1) / 2 * lattice.step_m
        cells = Lattice(
            lattice.x0_m + first, lattice.y0_m - first, group * lattice.step_m,
            -(-lattice.rows // group), -(-lattice.cols // group),
        )  # fmt: skip
        hidden = self._hidden(view, cells)
        return np.repeat(np.repeat(hidden, group, axis=0), group, axis=1)[: lattice.rows, : lattice.cols]

    def _hidden(self, view: MosaicView, lattice: Lattice) -> Mask:
        """Compare the ground with the shadow of the ground before it, on lines of sight around the nadir.

        On a line away from the nadir, ground is seen if it is at a larger angle than all nearer ground.
        Ground that lies in the shadow by less than a step is seen in part, and counts as seen.
        """
        east_m, north_m = (float(at) for at in view.w_p_c_m[:2])
        x = lattice.x0_m - east_m + lattice.step_m * np.arange(lattice.cols)
        y = lattice.y0_m - north_m - lattice.step_m * np.arange(lattice.rows)
        east, north = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
        away, angle = cv2.cartToPolar(east, north)
        steps = int(np.ceil(float(away.max()) / lattice.step_m)) + 2
        # Lines of sight are a step apart at the farthest node; the circle closes with one more.
        lines = min(int(np.ceil(2 * np.pi * steps)) + 1, MOST_LINES)
        turn = np.linspace(0, 2 * np.pi, lines, dtype=np.float32)[:, None]
        far = (np.arange(steps, dtype=np.float32) * np.float32(lattice.step_m))[None]
        wanted = self._lines(angle, lines)
        used = np.flatnonzero(np.bincount(wanted.ravel(), minlength=lines))
        turn, place = turn[used], np.zeros(lines, np.float32)
        place[used] = np.arange(len(used), dtype=np.float32)
        height = self._at(east_m + far * np.cos(turn), north_m + far * np.sin(turn))
        slope = far / np.maximum(np.float32(view.height_m) - height, np.float32(1e-3))
        nearest = np.maximum.accumulate(slope, axis=1)
        shadow = np.float32(view.height_m) - far / np.maximum(nearest, np.float32(1e-6)) - height
        shadow[:, 0] = 0.0
        depth = cv2.remap(shadow, away / np.float32(lattice.step_m), place[wanted], cv2.INTER_LINEAR)
        return np.asarray(depth > np.float32(lattice.step_m))

    @staticmethod
    def _lines(angle: Float32, lines: int) -> NDArray[np.int64]:
        """Return the number of the line of sight nearest to each angle."""
        return np.asarray(np.rint(angle * np.float32((lines - 1) / (2 * np.pi))), np.int64)

    def _at(self, x_m: Float32, y_m: Float32) -> Float32:
        """Return the interpolated heights at positions."""
        half, cell_m = np.float32(0.5), np.float32(self.cell_m)
        c = (x_m - np.float32(self.west_m)) / cell_m - half
        r = (np.float32(self.north_m) - y_m) / cell_m - half
        return np.asarray(cv2.remap(self.height_m, c, r, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def ground_heights(surface: Surface | None, lattice: Lattice) -> Float32 | None:
    """Return the heights (rows, cols) of the ground at each node; None where all of it is the floor."""
    return None if surface is None else surface.heights(lattice)


def ground_maps(
    camera: Camera, view: MosaicView, lattice: Lattice, height_m: Float32 | None
) -> tuple[Float32, Float32]:
    """Return the pixel (u, v) of the ground at each node, at heights of `ground_heights`."""
    if height_m is None:
        return pixel_maps(camera, view, lattice)
    return raised_maps(camera, view, lattice, height_m)


def ground_seen(
    camera: Camera, view: MosaicView, lattice: Lattice, surface: Surface | None, hidden_too: bool = False
) -> tuple[Float32, Float32, Mask]:
    """Return the pixel (u, v) of the ground at each node, and whether the lens sees it and nothing hides it.

    The pixel may lie beside the picture. ``hidden_too``: whether ground counts as seen that higher ground
    hides.
    """
    height_m = ground_heights(surface, lattice)
    seen, _, _ = visible(view, lattice, height_m)
    if surface is not None and not hidden_too:
        seen &= ~surface.hidden(view, lattice)
    return *ground_maps(camera, view, lattice, height_m), seen
