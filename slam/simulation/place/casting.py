"""Compiled ray casting on upright prisms: the first surface that a pixel or a sonar beam meets."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backend.compilation import discard_stale, njit
from slam.simulation.place.obstacles import (
    BASE,
    COS,
    HALF_LENGTH,
    HALF_WIDTH,
    ROUND,
    SIN,
    TAPER_LENGTH,
    TAPER_WIDTH,
    TOP,
    X,
    Y,
)

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

discard_stale([Path(__file__), Path(__file__).with_name("obstacles.py")])

TOP_FACE, SIDE_FACE = 0, 1
GRAZING = 0.15
"""Least cosine of incidence by which a pixel's footprint is stretched."""
MOST_ROUNDS, SETTLED_M = 60, 1e-5
"""Rounds from a ray to hilly ground, and the change of height at which they end. Each round reduces the error
by slope times tangent off nadir, at most 0.6 x 1 at the border of a wide picture."""


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
    """(n, 11) rows as in ``obstacles.prisms``."""
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
def _leans(prism: Array) -> tuple[float, float]:
    """Return by how much half length and half width shrink over a unit of height."""
    rise = prism[TOP] - prism[BASE]
    return (
        prism[TAPER_LENGTH] * prism[HALF_LENGTH] / rise,
        prism[TAPER_WIDTH] * prism[HALF_WIDTH] / rise,
    )


@njit(cache=True)
def _between(
    origin: float, direction: float, up: float, climb: float, half: float, lean: float
) -> tuple[float, float]:
    """Return where a ray is between two planes that lean towards each other: |x| <= half - lean z."""
    near, far = -np.inf, np.inf
    for side in (-1.0, 1.0):
        apart, toward = half - lean * up - side * origin, side * direction + lean * climb
        if toward > 0.0:
            far = min(far, apart / toward)
        elif toward < 0.0:
            near = max(near, apart / toward)
        elif apart <= 0.0:
            return np.inf, -np.inf
    return near, far


@njit(cache=True)
def _enter_cone(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, prism: Array
) -> tuple[float, float, float]:
    """Return where a ray enters and leaves a cylinder or cone without its ends, and the cosine of incidence.

    It solves |p_xy| = r - lean z for a point p = o + s d. The roots belong to the upright cone, because the
    ends bound z below its apex.
    """
    radius, lean = prism[HALF_LENGTH], _leans(prism)[0]
    r = radius - lean * (oz - prism[BASE])
    a = dx * dx + dy * dy - lean * lean * dz * dz
    b = ox * dx + oy * dy + lean * r * dz
    c = ox * ox + oy * oy - r * r
    if a == 0.0:
        if c < 0.0:
            return -np.inf, np.inf, 0.0
        return (-c / (2 * b), np.inf, abs(b) / radius) if b < 0.0 else (np.inf, -np.inf, 0.0)
    if a > 0.0 and b * b < a * c:
        return np.inf, -np.inf, 0.0
    root = np.sqrt(max(b * b - a * c, 0.0))
    cosine = root / (radius * np.sqrt(1.0 + lean * lean))
    if a > 0.0:
        return (-b - root) / a, (-b + root) / a, cosine
    # A ray steeper than the side crosses it once below the apex, and once above.
    if dz < 0.0:
        return (-b - root) / a, np.inf, cosine
    return -np.inf, (-b + root) / a, cosine


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
    if prism[ROUND] != 0.0:
        near, far, cosine_side = _enter_cone(ox, oy, oz, dx, dy, dz, prism)
    else:
        length, width = prism[HALF_LENGTH], prism[HALF_WIDTH]
        lean_x, lean_y = _leans(prism)
        up = oz - prism[BASE]
        near_x, far_x = _between(ox, dx, up, dz, length, lean_x)
        near_y, far_y = _between(oy, dy, up, dz, width, lean_y)
        near, far = max(near_x, near_y), min(far_x, far_y)
        if near_x > near_y:
            cosine_side = (abs(dx) - lean_x * dz) / np.sqrt(1.0 + lean_x * lean_x)
        else:
            cosine_side = (abs(dy) - lean_y * dz) / np.sqrt(1.0 + lean_y * lean_y)
    s = max(near, near_z)
    if s >= min(far, far_z) or s <= 0.0:
        return np.inf, SIDE_FACE, 1.0, 0.0, 0.0
    if near_z >= near:
        return s, TOP_FACE, abs(dz), ox + s * dx, oy + s * dy
    return s, SIDE_FACE, cosine_side, ox + s * dx, oy + s * dy


@njit(cache=True)
def _around(prism: Array, along: float, across: float, up: float) -> float:
    """Return the position on the side face as a share of the perimeter at its height, 0 to 1.

    It counts counter-clockwise from the right rear edge. ``up`` is the height above the base.
    """
    lean_x, lean_y = _leans(prism)
    a = max(prism[HALF_LENGTH] - lean_x * up, 1e-9)
    b = max(prism[HALF_WIDTH] - lean_y * up, 1e-9)
    if prism[ROUND] != 0.0:
        return float((np.arctan2(across, along) / (2 * np.pi)) % 1.0)
    perimeter = 4 * (a + b)
    if abs(along) / a > abs(across) / b:
        return float(((b + across) if along > 0 else 2 * (a + b) + (b - across)) / perimeter)
    return float((2 * b + (a - along) if across > 0 else 4 * b + 2 * a + (a + along)) / perimeter)


@njit(cache=True, nogil=True)
def ranges(origin: Array, direction: Array, prisms: Array) -> Array:
    """Return the distance (n,) along each ray to the first prism; infinite without one.

    The unit is the length of the ray's direction. Both inputs are (n, 3) in the world, prisms (k, 11).
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


@njit(cache=True)
def _ground_height(x: float, y: float, slope: Array, hills: Array) -> float:
    """Return the height of the ground, as ``ground.Ground.height`` does."""
    z = slope[0] * x + slope[1] * y
    for hill in hills:
        d2 = (x - hill[0]) ** 2 + (y - hill[1]) ** 2
        z += hill[3] * np.exp(-d2 / (2 * hill[2] * hill[2]))
    return float(z)


@njit(cache=True, nogil=True)
def ground_ranges(origin: Array, direction: Array, slope: Array, hills: Array) -> Array:
    """Return the distance (n,) along each ray to the ground; infinite where it does not descend.

    ``origin`` is (1 or n, 3), ``direction`` (n, 3); the unit is the length of the direction. Rays must be
    steeper than the ground, so that the fixed-point iteration from the plane to the hills converges.
    """
    reached = np.full(len(direction), np.inf)
    for k in range(len(direction)):
        o, d = origin[k if len(origin) > 1 else 0], direction[k]
        sinking = slope[0] * d[0] + slope[1] * d[1] - d[2]
        if sinking <= 0.0:
            continue
        above = o[2] - slope[0] * o[0] - slope[1] * o[1]
        s, last = above / sinking, np.inf
        for _ in range(MOST_ROUNDS if len(hills) else 0):
            x, y = o[0] + s * d[0], o[1] + s * d[1]
            hill = _ground_height(x, y, slope, hills) - slope[0] * x - slope[1] * y
            s, last = (above - hill) / sinking, s
            if abs(s - last) * sinking < SETTLED_M:
                break
        reached[k] = s
    return reached


@njit(cache=True, nogil=True)
def draw(samples: Image, view: SampleRays, slope: Array, hills: Array, visible: VisiblePrisms) -> None:
    """Draw prisms over the ground of a slope (2,) and hills (k, 4) in ``samples`` (h, w, 3), in place."""
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
            for c in range(bounds[k, 2], bounds[k, 3] + 1):
                u, v = rays[r, c, 0], rays[r, c, 1]
                dx = R[0, 0] * u + R[0, 1] * v + R[0, 2]
                dy = R[1, 0] * u + R[1, 1] * v + R[1, 2]
                dz = R[2, 0] * u + R[2, 1] * v + R[2, 2]
                s, face, cosine, along, across = _enter(o[0], o[1], o[2], dx, dy, dz, prism)
                # Skip what is behind another prism, or below the ground.
                if s >= depth[c]:
                    continue
                x = prism[X] + prism[COS] * along - prism[SIN] * across
                y = prism[Y] + prism[SIN] * along + prism[COS] * across
                if o[2] + s * dz < _ground_height(x, y, slope, hills):
                    continue
                depth[c] = s
                footprint = s * spacing / max(cosine / np.sqrt(dx * dx + dy * dy + dz * dz), GRAZING)
                level = int(np.rint(np.log2(max(footprint / metres_per_texel, 1.0))))
                level = min(level, levels.shape[2] - 1)
                if face == TOP_FACE:
                    share_x = 0.5 + 0.5 * along / prism[HALF_LENGTH]
                    share_y = 0.5 - 0.5 * across / prism[HALF_WIDTH]
                else:
                    share_x = _around(prism, along, across, o[2] + s * dz - prism[BASE])
                    share_y = (prism[TOP] - o[2] - s * dz) / (prism[TOP] - prism[BASE])
                _texel(texels, levels[k, face, level], share_x, share_y, samples[r, c])
