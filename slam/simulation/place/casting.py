"""Compiled ray casting on upright prisms: the first surface that a pixel or a sonar beam meets."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backend.numba_cache import discard_stale, njit
from slam.simulation.place.obstacles import BASE, COS, HALF_LENGTH, HALF_WIDTH, ROUND, SIN, TOP, X, Y

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

discard_stale([Path(__file__), Path(__file__).with_name("obstacles.py")])

TOP_FACE, SIDE_FACE = 0, 1
GRAZING = 0.15
"""Least cosine of incidence by which a pixel's footprint is stretched."""


class SampleRays(NamedTuple):
    """Directions of the samples of a picture, and the poses of its rows."""

    rays: NDArray[np.float32]
    """(h, w, 2) directions in camera axes, with z = 1."""
    w_R_c: Array
    """(1 or h, 3, 3) rotation of the whole picture or of each row."""
    w_t_c: Array
    """(1 or h, 3) position, likewise."""
    spacing: float
    """Angle between samples, in rad."""


class VisiblePrisms(NamedTuple):
    """Prisms that a picture may show, and their textures."""

    prisms: Array
    """(n, 9) rows as in ``obstacles.prisms``."""
    bounds: NDArray[np.int64]
    """(n, 4) first and last row, first and last column of the samples that each may cover."""
    texels: Image
    """(t, 3) BGR colours."""
    levels: NDArray[np.int64]
    """(n, 2, levels, 3) position of the mip levels of top and side: first texel, height, width."""
    metres_per_texel: float


@njit(cache=True)
def _slab(origin: float, direction: float, low: float, high: float) -> tuple[float, float]:
    """Return where a ray enters and leaves the space between two planes, in lengths of its direction."""
    if direction == 0.0:
        if low < origin < high:
            return -np.inf, np.inf
        return np.inf, -np.inf
    a, b = (low - origin) / direction, (high - origin) / direction
    return min(a, b), max(a, b)


@njit(cache=True)
def _enter(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, prism: Array
) -> tuple[float, int, float, float, float]:
    """Return where the ray o + s d enters a prism: (s, face, cosine, along, across).

    The ray is in prism axes except for z. s is in lengths of d, infinite where the ray misses or starts
    inside. The cosine is that between ray and face normal times the length of d. The point is (along, across)
    in prism axes.
    """
    near_z, far_z = _slab(oz, dz, prism[BASE], prism[TOP])
    cosine_side = 0.0
    if prism[ROUND] != 0.0:
        near, far = np.inf, -np.inf
        a, b = dx * dx + dy * dy, ox * dx + oy * dy
        c = ox * ox + oy * oy - prism[HALF_LENGTH] ** 2
        if a == 0.0:
            if c < 0.0:
                near, far = -np.inf, np.inf
        elif b * b >= a * c:
            root = np.sqrt(b * b - a * c)
            near, far = (-b - root) / a, (-b + root) / a
            cosine_side = root / prism[HALF_LENGTH]
    else:
        near_x, far_x = _slab(ox, dx, -prism[HALF_LENGTH], prism[HALF_LENGTH])
        near_y, far_y = _slab(oy, dy, -prism[HALF_WIDTH], prism[HALF_WIDTH])
        near, far = max(near_x, near_y), min(far_x, far_y)
        cosine_side = abs(dx) if near_x > near_y else abs(dy)
    s = max(near, near_z)
    if s >= min(far, far_z) or s <= 0.0:
        return np.inf, SIDE_FACE, 1.0, 0.0, 0.0
    if near_z >= near:
        return s, TOP_FACE, abs(dz), ox + s * dx, oy + s * dy
    return s, SIDE_FACE, cosine_side, ox + s * dx, oy + s * dy


@njit(cache=True)
def _around(prism: Array, along: float, across: float) -> float:
    """Return the position on the side face as a share of the perimeter, 0 to 1.

    It counts counter-clockwise from the right rear edge.
    """
    a, b = prism[HALF_LENGTH], prism[HALF_WIDTH]
    if prism[ROUND] != 0.0:
        return float((np.arctan2(across, along) / (2 * np.pi)) % 1.0)
    perimeter = 4 * (a + b)
    if abs(along) / a > abs(across) / b:
        return float(((b + across) if along > 0 else 2 * (a + b) + (b - across)) / perimeter)
    return float((2 * b + (a - along) if across > 0 else 4 * b + 2 * a + (a + along)) / perimeter)


@njit(cache=True, nogil=True)
def ranges(origin: Array, direction: Array, prisms: Array) -> Array:
    """Return the distance (n,) along each ray to the first prism; infinite without one.

    The unit is the length of the ray's direction. Both inputs are (n, 3) in the world, prisms (k, 9).
    """
    nearest = np.full(len(origin), np.inf)
    for k in range(len(origin)):
        o, d = origin[k], direction[k]
        for prism in prisms:
            c, s = prism[COS], prism[SIN]
            x, y = o[0] - prism[X], o[1] - prism[Y]
            found = _enter(
                c * x + s * y, c * y - s * x, o[2], c * d[0] + s * d[1], c * d[1] - s * d[0], d[2], prism
            )
            nearest[k] = min(nearest[k], found[0])
    return nearest


@njit(cache=True)
def _texel(texels: Image, level: NDArray[np.int64], share_x: float, share_y: float, out: Image) -> None:
    """Interpolate a colour into ``out``, clamped at the border; ``level`` is (first texel, height, width)."""
    first, height, width = level
    x = min(max(share_x * width - 0.5, 0.0), width - 1.0)
    y = min(max(share_y * height - 0.5, 0.0), height - 1.0)
    x0, y0 = int(x), int(y)
    x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
    fx, fy = x - x0, y - y0
    for channel in range(3):
        upper = (1 - fx) * texels[first + y0 * width + x0, channel] + fx * texels[
            first + y0 * width + x1, channel
        ]
        lower = (1 - fx) * texels[first + y1 * width + x0, channel] + fx * texels[
            first + y1 * width + x1, channel
        ]
        out[channel] = np.uint8((1 - fy) * upper + fy * lower + 0.5)


@njit(cache=True)
def _in_prism_axes(prism: Array, w_R_c: Array, w_t_c: Array) -> tuple[Array, Array]:
    """Return a camera's rotation and position in axes of the prism's heading and centre."""
    R, o = w_R_c.copy(), w_t_c.copy()
    cos, sin = prism[COS], prism[SIN]
    R[0], R[1] = cos * w_R_c[0] + sin * w_R_c[1], cos * w_R_c[1] - sin * w_R_c[0]
    x, y = w_t_c[0] - prism[X], w_t_c[1] - prism[Y]
    o[0], o[1] = cos * x + sin * y, cos * y - sin * x
    return R, o


@njit(cache=True, nogil=True)
def draw(samples: Image, view: SampleRays, slope: Array, visible: VisiblePrisms) -> None:
    """Draw prisms over the floor z = slope . (x, y) in ``samples`` (h, w, 3), in place."""
    rays, w_R_c, w_t_c, spacing = view
    prisms, bounds, texels, levels, metres_per_texel = visible
    width = samples.shape[1]
    depth = np.empty(width)
    for r in range(bounds[:, 0].min(), bounds[:, 1].max() + 1):
        pose = r if len(w_t_c) > 1 else 0
        depth[:] = np.inf
        for k in range(len(prisms)):
            if r < bounds[k, 0] or r > bounds[k, 1]:
                continue
            prism = prisms[k]
            R, o = _in_prism_axes(prism, w_R_c[pose], w_t_c[pose])
            rise_x = prism[COS] * slope[0] + prism[SIN] * slope[1]
            rise_y = prism[COS] * slope[1] - prism[SIN] * slope[0]
            above = w_t_c[pose, 2] - slope[0] * w_t_c[pose, 0] - slope[1] * w_t_c[pose, 1]
            for c in range(bounds[k, 2], bounds[k, 3] + 1):
                u, v = rays[r, c, 0], rays[r, c, 1]
                dx = R[0, 0] * u + R[0, 1] * v + R[0, 2]
                dy = R[1, 0] * u + R[1, 1] * v + R[1, 2]
                dz = R[2, 0] * u + R[2, 1] * v + R[2, 2]
                s, face, cosine, along, across = _enter(o[0], o[1], o[2], dx, dy, dz, prism)
                # Skip what is behind another prism, or hidden by a floor that slopes up before it.
                if s >= depth[c] or s * (rise_x * dx + rise_y * dy - dz) > above:
                    continue
                depth[c] = s
                footprint = s * spacing / max(cosine / np.sqrt(dx * dx + dy * dy + dz * dz), GRAZING)
                level = int(np.rint(np.log2(max(footprint / metres_per_texel, 1.0))))
                level = min(level, levels.shape[2] - 1)
                if face == TOP_FACE:
                    share_x = 0.5 + 0.5 * along / prism[HALF_LENGTH]
                    share_y = 0.5 - 0.5 * across / prism[HALF_WIDTH]
                else:
                    share_x = _around(prism, along, across)
                    share_y = (prism[TOP] - o[2] - s * dz) / (prism[TOP] - prism[BASE])
                _texel(texels, levels[k, face, level], share_x, share_y, samples[r, c])
