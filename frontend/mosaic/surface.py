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


@dataclass(frozen=True)
class Surface:
    """Heights over the floor on a lattice; cell (r, c) has its centre at x = west + (c + 1/2) cell,
    y = north - (r + 1/2) cell."""

    west_m: float
    north_m: float
    cell_m: float
    height_m: Float32
    """(rows, cols) height over the floor."""
    std_m: Float32
    """(rows, cols) standard deviation of the height; NaN where it was filled."""
    source: NDArray[np.uint8]
    """(rows, cols) ``HeightSource`` of each height."""

    @cached_property
    def digest(self) -> bytes:
        """Digest of the heights and their place."""
        place = repr((self.west_m, self.north_m, self.cell_m, self.height_m.shape))
        return blake2b(place.encode() + self.height_m.tobytes(), digest_size=16).digest()

    def heights(self, lattice: Lattice) -> Float32 | None:
        """Return the interpolated heights (rows, cols) at the nodes of a lattice, 0 beyond the surface.

        None where all of them are 0, so that the floor's homography describes the ground.
        """
        step = lattice.step_m / self.cell_m
        left = (lattice.x0_m - self.west_m) / self.cell_m - 0.5
        above = (self.north_m - lattice.y0_m) / self.cell_m - 0.5
        cell_H_node = np.array([[step, 0.0, left], [0.0, step, above]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = (lattice.cols, lattice.rows)
        heights = np.asarray(cv2.warpAffine(self.height_m, cell_H_node, size, flags=flags))
        return heights if heights.any() else None

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
        """Follow each line of sight towards the camera, a node at a time, up to the highest ground around.

        Ground that is higher by less than a step hides less than a step, and is ignored.
        """
        shape = (lattice.rows, lattice.cols)
        hidden = np.zeros(shape, bool)
        x = lattice.x0_m + lattice.step_m * np.arange(lattice.cols)
        y = lattice.y0_m - lattice.step_m * np.arange(lattice.rows)
        east, north = (
            np.broadcast_to(a, shape).astype(np.float32)
            for a in (view.w_p_c_m[0] - x[None], view.w_p_c_m[1] - y[:, None])
        )
        away = np.maximum(np.hypot(east, north), np.float32(1e-6))
        pad, around = self._around(lattice, float(away.max()), view.height_m)
        if not around.any():
            return hidden
        heights = around[pad : pad + lattice.rows, pad : pad + lattice.cols]
        climb = np.maximum(np.float32(view.height_m) - heights, np.float32(1e-6)) / away
        steps = (around.max() - heights) / climb / np.float32(lattice.step_m)
        c, r = (np.arange(n, dtype=np.float32) + pad for n in (lattice.cols, lattice.rows))
        for k in range(1, int(np.ceil(float(steps.max()))) + 1):
            at = c[None] + k * east / away, r[:, None] - k * north / away
            ground = cv2.remap(around, *at, cv2.INTER_LINEAR)
            hidden |= ground > heights + (k * climb + 1) * np.float32(lattice.step_m)
        return hidden

    def _around(self, lattice: Lattice, away_m: float, camera_m: float) -> tuple[int, Float32]:
        """Return the number of nodes added on each side, and the heights at the nodes and around them.

        They reach as far as ground may hide a node: on the way to the camera's nadir the line of sight rises
        above everything at a share of it.
        """
        low, high = float(self.height_m.min()), float(self.height_m.max())
        share = np.clip((high - low) / max(camera_m - low, 1e-9), 0.0, 1.0)
        pad = int(np.ceil(share * away_m / lattice.step_m)) + 1
        wider = Lattice(
            lattice.x0_m - pad * lattice.step_m, lattice.y0_m + pad * lattice.step_m, lattice.step_m,
            lattice.rows + 2 * pad, lattice.cols + 2 * pad,
        )  # fmt: skip
        heights = self.heights(wider)
        return pad, np.zeros((wider.rows, wider.cols), np.float32) if heights is None else heights


def ground_maps(
    camera: Camera, view: MosaicView, lattice: Lattice, surface: Surface | None
) -> tuple[Float32, Float32]:
    """Return the pixel (u, v) of the ground at each node: of the surface, or of the floor without one."""
    heights = surface.heights(lattice) if surface else None
    if heights is None:
        return pixel_maps(camera, view, lattice)
    return raised_maps(camera, view, lattice, heights)


def ground_seen(view: MosaicView, lattice: Lattice, surface: Surface | None) -> Mask:
    """Return whether the lens sees the ground at each node, and no higher ground hides it."""
    seen, _, _ = visible(view, lattice)
    return seen if surface is None else seen & ~surface.hidden(view, lattice)
