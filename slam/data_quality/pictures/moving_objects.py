"""Objects that move over the floor: parts of a picture that do not follow the floor's motion.

The earlier picture is overlaid on the later one, and dense optical flow (Kroeger et al., ECCV 2016) gives the
motion of each pixel. Noise, light and lens distortion leave no flow of several pixels that passes the
forward-backward check. High objects at rest have a flow along that of the floor.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.data_quality.pictures.overlaid import Image, Overlaid

Light = NDArray[np.float32]

OFF, BACK = 0.017, 0.006
"""Flow of a moving object in picture widths, and largest closure error of its backward flow."""
LEAST_SHARE, ALONG, ON_LENS = 0.35, 0.9, 1.15
"""Least share of the floor's flow, as lens distortion and rolling shutter displace pixels by less. A flow
within the cosine of the floor's flow belongs to a high object, or to one on the lens, which has the whole
flow."""
LEVELS, LEFT = 8.0, 0.5
"""Least reduction of the local difference by the flow in grey levels, and share that may remain."""
PATCH = (5, 5)
PASS_S, LEAST_PASS = 1.0, 3
"""Greatest time between two pictures of a moving object, and least number of them beyond chance."""
BORDER_PX = 4
LEAST_SEEN = 0.2
LEAST_AREA = 0.005
"""Smallest area of a moving object, as a share of the picture. Over floors of two generators none of 900
healthy pairs exceeded it; objects as large as a third of the picture exceeded it in two pairs of three."""


def has_moving_object(small_i: Image, laid: Overlaid, camera: Camera) -> bool:
    """Return whether an object moves between a reduced picture (h, w) and the one overlaid on it."""
    kernel = np.ones((2 * BORDER_PX + 1, 2 * BORDER_PX + 1), np.uint8)
    seen = cv2.erode(laid.seen.astype(np.uint8), kernel, borderValue=0) > 0
    if seen.mean() < LEAST_SEEN:
        return False
    own, other = (np.where(seen, levels, 0.0).astype(np.float32) for levels in (small_i, laid.other))
    ahead = _flow(own, other)
    moves = seen & _moves_apart(ahead, laid, camera.size_px[0] / small_i.shape[1])
    if _largest(moves) < LEAST_AREA * moves.size:
        return False
    came = _taken(other, ahead)
    before, after = (cv2.blur(np.abs(own - levels), PATCH) for levels in (other, came))
    moves &= (before - after > LEVELS) & (after < LEFT * before)
    there_and_back = ahead + _taken(_flow(other, own), ahead)
    moves &= np.linalg.norm(there_and_back, axis=2) < BACK * small_i.shape[1]
    return bool(_largest(moves) >= LEAST_AREA * moves.size)


def passes_of(times_s: NDArray[np.float64]) -> list[int]:
    """Return the number of pictures of each object, from the stamps (n,) of all pictures of moving ones."""
    parts = np.split(times_s, np.flatnonzero(np.diff(times_s) > PASS_S) + 1)
    return [len(part) for part in parts if len(part) >= LEAST_PASS]


def _flow(a: Light, b: Light) -> Light:
    """Return the optical flow (h, w, 2) of each pixel from a to b."""
    solver = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    levels = [np.clip(np.rint(x), 0, 255).astype(np.uint8) for x in (a, b)]
    flow = np.zeros((*a.shape, 2), np.float32)
    return np.asarray(solver.calc(levels[0], levels[1], flow), dtype=np.float32)


def _moves_apart(flow: Light, laid: Overlaid, scale: float) -> NDArray[np.bool_]:
    """Return where the flow is large, no share of the floor's, and not along it at a smaller size."""
    floor = (laid.is_px - laid.was_px) / scale
    size, speed = np.linalg.norm(flow, axis=2), np.linalg.norm(floor, axis=2)
    along = np.abs((flow * floor).sum(axis=2)) > ALONG * size * speed
    unmoved = along & (size < ON_LENS * speed)
    return np.asarray((size > OFF * flow.shape[1]) & (size > LEAST_SHARE * speed) & ~unmoved)


def _taken(image: Light, flow: Light) -> Light:
    """Return the image at the end of each pixel's flow."""
    columns, rows = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in flow.shape[1::-1]))
    x, y = columns + flow[..., 0], rows + flow[..., 1]
    taken = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(taken, dtype=np.float32)


def _largest(where: NDArray[np.bool_]) -> int:
    """Return the number of pixels of the largest connected piece."""
    count, _, stats, _ = cv2.connectedComponentsWithStats(where.astype(np.uint8))
    return int(stats[1:, cv2.CC_STAT_AREA].max()) if count > 1 else 0
