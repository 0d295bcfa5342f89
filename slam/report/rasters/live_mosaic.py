"""The mosaic of a live map: coarse, and drawn again only where it changed."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.mosaic.canvas import MosaicError
from frontend.mosaic.exposure import Exposure
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import plan_mosaic
from frontend.mosaic.render import render_tiles
from frontend.views import Load
from frontend.workers import Workers
from slam.core.streams import Image

Array = NDArray[np.float64]

_PICTURE_PX = 160
"""Width of a keyframe in the mosaic."""
_MOST_PIXELS, _TILE_PX = 8_000_000, 128
_KEPT_MB = 64
"""Memory for reduced pictures; the others are read again when they are needed."""


class LiveMosaic:
    """Draws the keyframes at their current poses. ``load`` returns the picture of a frame."""

    def __init__(self, camera: Camera, load: Load) -> None:
        self._camera, self._load = camera.narrowed(_PICTURE_PX), load
        self._drawn: dict[int, Array] = {}
        """Frame -> the pose at which it was drawn last."""
        self._gsd_m: float | None = None
        self._tiles: dict[str, Image] = {}
        """Fingerprint -> pixels of the tiles of the last update."""
        self._pictures: OrderedDict[int, Image] = OrderedDict()
        self.rendered = 0
        """Tiles drawn by the last update."""

    def update(self, frames: NDArray[np.int64], w_T_b: Array) -> Image | None:
        """Return the mosaic (h, w, 3) of keyframes ``frames`` (n,) at poses (n, 4, 4) over the floor at 0.

        NaN leaves a keyframe out. Returns None while no keyframe sees the floor.
        """
        placed = np.flatnonzero(np.isfinite(w_T_b).all(axis=(1, 2))).tolist()
        poses = np.array([self._pose(int(frames[k]), w_T_b[k]) for k in placed]).reshape(-1, 4, 4)
        try:
            plan = replace(plan_mosaic(self._camera, poses, 0.0, self._gsd_m, _MOST_PIXELS), tile_px=_TILE_PX)
        except MosaicError:
            if self._gsd_m is None:
                return None
            self._gsd_m, self._tiles = None, {}  # the map outgrew its resolution
            return self.update(frames, w_T_b)
        self._gsd_m = plan.gsd_m
        number = [int(frames[k]) for k in placed]
        pictures = Pictures(plan, lambda k: self._picture(number[k]), _KEPT_MB)
        canvas = np.full((plan.height, plan.width, 3), 255, np.uint8)
        tiles: dict[str, Image] = {}
        self.rendered = 0
        neutral = Exposure.neutral(len(plan.views))
        known, one = (lambda tile, mark: self._tiles.get(mark)), Workers(1)  # the others track the flight
        for made in render_tiles(plan, pictures, neutral, None, known, one):
            tiles[made.fingerprint] = made.rgba
            self.rendered += not made.reused
            tile, shown = made.tile, made.rgba[..., 3] > 0
            part = canvas[tile.row : tile.row + tile.rows, tile.col : tile.col + tile.cols]
            part[shown] = made.rgba[shown][:, 2::-1]
        self._tiles = tiles
        return canvas

    def _pose(self, frame: int, w_T_b: Array) -> Array:
        """Return the pose at which a keyframe is drawn: the last one while it is off by less than a pixel."""
        before = self._drawn.get(frame)
        if before is not None and self._gsd_m is not None:
            off = self._camera.footprint(w_T_b) - self._camera.footprint(before)
            if np.isfinite(off).all() and np.abs(off).max() < self._gsd_m:
                return before
        self._drawn[frame] = w_T_b
        return w_T_b

    def _picture(self, frame: int) -> Image | None:
        if frame in self._pictures:
            self._pictures.move_to_end(frame)
            return self._pictures[frame]
        image = self._load(frame)
        if image is None:
            return None
        reduced = np.asarray(cv2.resize(image, self._camera.size_px, interpolation=cv2.INTER_AREA))
        self._pictures[frame] = reduced
        if len(self._pictures) * reduced.nbytes > _KEPT_MB * 1e6:
            self._pictures.popitem(last=False)
        return reduced
