"""Obstacles: boxes and pylons on the floor, represented as upright prisms.

Source: IMAV 2011 paper, figure 1 (the gym of the pylon challenge) and section 3.1.1 (obstacles break the flat
floor: their parallax bends the map, the sonar sees their height).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

Array = NDArray[np.float64]
Length = Annotated[float, Field(gt=0, le=20)]

STEP_CELL_M = 0.6
MAX_STEPS = 190

X, Y, COS, SIN, HALF_LENGTH, HALF_WIDTH, BASE, TOP, ROUND = range(9)
"""Columns of a prism: position, heading, half sizes (both the radius if round), z of base and top, round."""


@dataclass(frozen=True)
class Box:
    """A crate on the floor."""

    center_m: tuple[float, float]
    size_m: tuple[Length, Length, Length]
    """Length (along its heading), width, height."""
    heading_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0


@dataclass(frozen=True)
class Pylon:
    """An upright cylinder on the floor."""

    center_m: tuple[float, float]
    radius_m: Length
    height_m: Length


def prisms(obstacles: Sequence[Box | Pylon], slope: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Return one row per obstacle (n, 9), upright on the floor z = slope . (x, y), in metres."""
    rows = np.empty((len(obstacles), 9))
    for row, obstacle in zip(rows, obstacles, strict=True):
        if isinstance(obstacle, Box):
            length, width, height = obstacle.size_m
            turn = np.radians(obstacle.heading_deg)
            row[:] = *obstacle.center_m, np.cos(turn), np.sin(turn), length / 2, width / 2, 0, height, 0
        else:
            radius = obstacle.radius_m
            row[:] = *obstacle.center_m, 1, 0, radius, radius, 0, obstacle.height_m, 1
        rise = slope[0] * row[X] + slope[1] * row[Y]
        # The base is sunk on the uphill side, so that it never floats on the other.
        sink = np.hypot(*slope) * np.hypot(row[HALF_LENGTH], row[HALF_WIDTH])
        row[BASE], row[TOP] = rise - sink, rise + row[TOP]
    return rows


def corners(prism: Array) -> Array:
    """Return the corners (8, 3) of a prism's bounding box: lower four, upper four, counter-clockwise."""
    along = prism[HALF_LENGTH] * np.array([1, 1, -1, -1])
    across = prism[HALF_WIDTH] * np.array([-1, 1, 1, -1])
    x = prism[X] + prism[COS] * along - prism[SIN] * across
    y = prism[Y] + prism[SIN] * along + prism[COS] * across
    return np.column_stack([np.tile(x, 2), np.tile(y, 2), np.repeat(prism[[BASE, TOP]], 4)])


def covers(prism: Array, x: Array, y: Array) -> NDArray[np.bool_]:
    """Whether the positions (x, y) in metres lie under a prism's top; arrays of one shape."""
    east, north = x - prism[X], y - prism[Y]
    along = prism[COS] * east + prism[SIN] * north
    across = prism[COS] * north - prism[SIN] * east
    if prism[ROUND]:
        return np.asarray(np.hypot(along, across) <= prism[HALF_LENGTH])
    return np.asarray((np.abs(along) <= prism[HALF_LENGTH]) & (np.abs(across) <= prism[HALF_WIDTH]))


def steps(
    extent_m: tuple[float, float, float, float],
    height_m: float,
    share: float,
    clear_m: Sequence[tuple[float, float]],
    rng: np.random.Generator,
) -> tuple[Box, ...]:
    """Return flat boxes of one height that cover a share of the floor, one a cell, none in ``clear_m``
    cells."""
    low, side = np.array(extent_m[:2]), np.subtract(extent_m[2:], extent_m[:2])
    count = np.maximum(np.rint(side / max(STEP_CELL_M, np.sqrt(side.prod() / MAX_STEPS))), 1).astype(int)
    cell = side / count
    occupied = {tuple(np.minimum((np.subtract(at, low) // cell).astype(int), count - 1)) for at in clear_m}
    free = [at for at in np.ndindex(*count) if at not in occupied]
    fill = np.sqrt(min(share * count.prod() / max(len(free), 1), 0.95))
    boxes = []
    for at in free:
        middle = low + cell * (np.array(at) + 0.5 + (1 - fill) * rng.uniform(-0.5, 0.5, 2))
        boxes.append(Box(tuple(middle.tolist()), (*(fill * cell).tolist(), height_m)))
    return tuple(boxes)
