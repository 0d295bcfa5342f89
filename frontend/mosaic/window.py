"""Inputs of a tile: the owners of the ground around it, their views and pictures.

All of it goes into the tile's fingerprint. Where that is the same, so are the pixels: a tile that was
rendered before need not be rendered again.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from hashlib import blake2b
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.blending import REACH_PX
from frontend.mosaic.canvas import CELL_PX, Tile
from frontend.mosaic.exposure import Exposure
from frontend.mosaic.plan import MosaicPlan

SOFT_CELLS = 2
"""Owners are smoothed over this many cells; a picture that ends early is replaced from as far."""


def window_of(tile: Tile) -> Tile:
    """The tile in whole cells, with a margin as wide as blending reaches."""
    rows, cols = (-(-n // CELL_PX) * CELL_PX + 2 * REACH_PX for n in (tile.rows, tile.cols))
    return Tile(tile.row - REACH_PX, tile.col - REACH_PX, rows, cols)


def owners_around(plan: MosaicPlan, window: Tile) -> NDArray[np.int32]:
    """Owners of the cells under the window and ``SOFT_CELLS`` + 1 around it; -1 beyond the mosaic."""
    pad = SOFT_CELLS + 1
    r0, c0 = window.row // CELL_PX - pad, window.col // CELL_PX - pad
    rows, cols = window.rows // CELL_PX + 2 * pad, window.cols // CELL_PX + 2 * pad
    cells = np.full((rows, cols), -1, np.int32)
    a, b = max(r0, 0), min(r0 + rows, plan.owner.shape[0])
    d, e = max(c0, 0), min(c0 + cols, plan.owner.shape[1])
    cells[a - r0 : b - r0, d - c0 : e - c0] = plan.owner[a:b, d:e]
    return cells


def fingerprint(plan: MosaicPlan, tile: Tile, digest: Callable[[int], bytes], exposure: Exposure) -> str:
    """Digest of all that the pixels of a tile come from; ``digest`` is that of the picture of a view."""
    cells = owners_around(plan, window_of(tile))
    present = np.unique(cells[cells >= 0])
    # Views are told by what they are, in their order: how many others the mosaic has does not matter.
    number = np.searchsorted(present, cells.ravel())
    number[cells.ravel() < 0] = -1
    lens = (plan.camera.focal_px, plan.camera.center_px, plan.camera.size_px, plan.camera.distortion)
    place = (plan.gsd_m, plan.first_row + tile.row, plan.first_col + tile.col, tile.rows, tile.cols)
    made = blake2b(_renderer(), digest_size=16)
    made.update(repr((lens, place)).encode())
    made.update(number.astype(np.int32).tobytes() + exposure.vignette.tobytes())
    for index in present.tolist():
        view = plan.views[index]
        numbers = (view.height_m, view.gsd_m, view.max_off_axis_cos, *view.w_p_c_m, *exposure.gain[index])
        made.update(view.pixel_H_floor.tobytes() + np.array(numbers).tobytes() + digest(index))
    return made.hexdigest()


@cache
def _renderer() -> bytes:
    """Return a digest of the drawing code, of OpenCV and of the processor: others may draw differently."""
    made = blake2b(repr((cv2.__version__, cv2.getCPUFeaturesLine(), np.__version__)).encode())
    folder = Path(__file__).parent
    for path in (*sorted(folder.glob("*.py")), folder.parent / "camera.py"):
        made.update(path.read_bytes())
    return made.digest()
