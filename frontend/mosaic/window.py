"""Window and fingerprint of a tile.

The fingerprint is a digest of all inputs of the tile: the owners of the cells around it, their views and
pictures. Tiles with the same fingerprint have the same pixels and are not rendered again.
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
from frontend.mosaic.canvas import CELL_PX, SOFT_CELLS, Tile
from frontend.mosaic.exposure import Exposure
from frontend.mosaic.plan import MosaicPlan


def window_of(tile: Tile) -> Tile:
    """Return the tile in whole cells with the margin that blending needs."""
    rows, cols = (-(-n // CELL_PX) * CELL_PX + 2 * REACH_PX for n in (tile.rows, tile.cols))
    return Tile(tile.row - REACH_PX, tile.col - REACH_PX, rows, cols)


def owners_around(plan: MosaicPlan, window: Tile) -> NDArray[np.int32]:
    """Return the owners of cells under the window and ``SOFT_CELLS`` + 1 around; -1 outside the mosaic."""
    pad = SOFT_CELLS + 1
    r0, c0 = window.row // CELL_PX - pad, window.col // CELL_PX - pad
    rows, cols = window.rows // CELL_PX + 2 * pad, window.cols // CELL_PX + 2 * pad
    cells = np.full((rows, cols), -1, np.int32)
    a, b = max(r0, 0), min(r0 + rows, plan.owner.shape[0])
    d, e = max(c0, 0), min(c0 + cols, plan.owner.shape[1])
    cells[a - r0 : b - r0, d - c0 : e - c0] = plan.owner[a:b, d:e]
    return cells


def fingerprint(plan: MosaicPlan, tile: Tile, digest: Callable[[int], bytes], exposure: Exposure) -> str:
    """Return the digest of all inputs of a tile. ``digest`` returns that of the picture of a view."""
    cells = owners_around(plan, window_of(tile))
    present = np.unique(cells[cells >= 0])
    # Views are renumbered in their order, so that the number of other views does not matter.
    number = np.searchsorted(present, cells.ravel())
    number[cells.ravel() < 0] = -1
    place = (plan.gsd_m, plan.first_row + tile.row, plan.first_col + tile.col, tile.rows, tile.cols)
    hasher = blake2b(_software_digest(), digest_size=16)
    hasher.update(repr((tuple(plan.camera.intrinsics), place)).encode())
    if plan.surface is not None:
        hasher.update(plan.surface.digest)
    hasher.update(number.astype(np.int32).tobytes() + exposure.vignette.tobytes())
    for index in present.tolist():
        view = plan.views[index]
        numbers = (view.height_m, view.gsd_m, view.max_off_axis_cos, *view.w_p_c_m, *exposure.gain[index])
        hasher.update(view.pixel_H_floor.tobytes() + np.array(numbers).tobytes() + digest(index))
    return hasher.hexdigest()


@cache
def _software_digest() -> bytes:
    """Return a digest of the rendering code, OpenCV and the processor, as others may give other pixels."""
    hasher = blake2b(repr((cv2.__version__, cv2.getCPUFeaturesLine(), np.__version__)).encode())
    folder = Path(__file__).parent
    for path in (*sorted(folder.glob("*.py")), folder.parent / "camera.py"):
        hasher.update(path.read_bytes())
    return hasher.digest()
