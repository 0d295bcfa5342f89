"""Height of the surface, and the first echo of a sonar.

A sonar reports the first echo in its cone. The floor is a half space, and each obstacle is convex. The part
of a convex body within a given range is convex. So the first contact of body and cone has one of two places:
the point of the body nearest to the sensor, if it lies inside the cone, or else the cone's rim. Therefore
nearest points and rays along the rim are sufficient.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.simulation.place.ground import Ground
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
    top,
)
from slam.simulation.place.world import World

Array = NDArray[np.float64]

RIM_RAYS = 96
"""Rays along the rim of the cone: at 1 m and 25 degrees a corner less than 1 cm inside may be missed."""
RINGS = (0.33, 0.67, 1.0)
"""Rings of rays over surfaces whose nearest point has no simple formula, as shares of the cone's angle."""


def elevation(world: World, x: Array, y: Array) -> Array:
    """Return the height in metres of the surface at (x, y): the floor, or the highest obstacle there.

    Both arrays and the result have one shape. It is the truth for elevation maps (IMAV 2011 paper, section
    3.1.1).
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    height = world.ground.height(x, y)
    for prism in world.prisms:
        height = np.maximum(height, top(prism, x, y))
    return height


def first_echo(world: World, w_p_sensor: Array, w_direction: Array, beam_width_rad: float = 0.0) -> Array:
    """Return the range (n,) in metres to the nearest surface inside the beam; infinite where there is none.

    ``w_p_sensor`` (n, 3) is in the world. ``w_direction`` (n, 3) is the beam's axis, of any length.
    ``beam_width_rad`` is the full opening angle; 0 is a single ray.
    """
    origin = np.ascontiguousarray(np.atleast_2d(np.asarray(w_p_sensor, dtype=float)))
    axis = np.atleast_2d(np.asarray(w_direction, dtype=float))
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    half_rad = beam_width_rad / 2
    nearest = _ground_echo(world.ground, origin, axis, half_rad)
    prisms = world.prisms
    if len(prisms) == 0:
        return nearest
    # Imported here because it compiles on import, which a world without obstacles does not need.
    from slam.simulation.place.casting import ranges

    for prism in prisms:
        nearest = np.minimum(nearest, _nearest_point_echo(prism, origin, axis, half_rad))
    tapered = bool((prisms[:, [TAPER_LENGTH, TAPER_WIDTH]] > 0).any())
    for ray in _rays(axis, half_rad) if tapered else _rim(axis, half_rad):
        nearest = np.minimum(nearest, ranges(origin, ray, prisms))
    return nearest


def _ground_echo(ground: Ground, origin: Array, axis: Array, half_rad: float) -> Array:
    """Return the range to the plane, or the nearest of rays over the whole cone to hilly ground."""
    if not ground.hills:
        return _floor_echo(ground.slope, origin, axis, half_rad)
    # Imported here because it compiles on import, which flat ground does not need.
    from slam.simulation.place.casting import ground_ranges

    slope, hills = np.array(ground.slope), ground.hill_rows
    rays = (np.ascontiguousarray(ray) for ray in _rays(axis, half_rad))
    return np.asarray(np.min([ground_ranges(origin, ray, slope, hills) for ray in rays], axis=0))


def _floor_echo(slope: tuple[float, float], origin: Array, axis: Array, half_rad: float) -> Array:
    """Return the range along the floor's normal if it lies in the cone, else along the nearest rim ray."""
    down = np.array([slope[0], slope[1], -1.0])
    down /= np.linalg.norm(down)
    distance = -origin @ down
    off_rad = np.maximum(np.arccos(np.clip(axis @ down, -1, 1)) - half_rad, 0.0)
    with np.errstate(divide="ignore"):
        return np.where(off_rad < np.pi / 2, distance / np.cos(off_rad), np.inf)


def _nearest_point_echo(prism: Array, origin: Array, axis: Array, half_rad: float) -> Array:
    """Return the distance (n,) to a prism's nearest point; infinite where it lies outside the cone."""
    c, s = prism[COS], prism[SIN]
    east, north = origin[:, 0] - prism[X], origin[:, 1] - prism[Y]
    along, across = c * east + s * north, c * north - s * east
    if prism[ROUND]:
        inward = np.minimum(1.0, prism[HALF_LENGTH] / np.maximum(np.hypot(along, across), 1e-12))
        near_along, near_across = along * inward, across * inward
    else:
        near_along = np.clip(along, -prism[HALF_LENGTH], prism[HALF_LENGTH])
        near_across = np.clip(across, -prism[HALF_WIDTH], prism[HALF_WIDTH])
    # The nearest point of a tapered prism may lie on its side, which rays find; here only its ridge or apex.
    near_along = np.where(prism[TAPER_LENGTH] > 0, np.clip(near_along, 0, 0), near_along)
    near_across = np.where(prism[TAPER_WIDTH] > 0, np.clip(near_across, 0, 0), near_across)
    near_z = np.clip(origin[:, 2], prism[BASE], prism[TOP])
    x, y = near_along - along, near_across - across
    offset = np.column_stack([c * x - s * y, s * x + c * y, near_z - origin[:, 2]])
    distance = np.linalg.norm(offset, axis=1)
    inside = np.einsum("ni,ni->n", offset, axis) >= np.cos(half_rad) * distance - 1e-12
    return np.where(inside & (distance > 0), distance, np.inf)


def _rays(axis: Array, half_rad: float) -> list[Array]:
    """Return directions all over the cones: their axes, and rings to the rim."""
    rings = [ray for share in RINGS for ray in _rim(axis, share * half_rad)]
    return [axis, *rings] if half_rad > 0 else [axis]


def _rim(axis: Array, half_rad: float) -> list[Array]:
    """Return directions along the rim of the cones, an (n, 3) array a ray; the axis alone without a width."""
    if half_rad == 0:
        return [axis]
    # Any direction other than the axis gives two perpendicular ones.
    other = np.where(np.abs(axis[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    u = np.cross(axis, other)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(axis, u)
    turn = np.linspace(0, 2 * np.pi, RIM_RAYS, endpoint=False)
    return [np.cos(half_rad) * axis + np.sin(half_rad) * (np.cos(a) * u + np.sin(a) * v) for a in turn]
