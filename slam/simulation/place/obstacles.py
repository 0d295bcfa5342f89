"""Obstacles: boxes, pylons and trees on the ground, represented as upright prisms, some of them tapered.

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

from slam.simulation.place.ground import FLAT, Ground

Array = NDArray[np.float64]
Length = Annotated[float, Field(gt=0, le=20)]

STEP_CELL_M = 0.6
MAX_STEPS = 190

X, Y, COS, SIN, HALF_LENGTH, HALF_WIDTH, BASE, TOP, ROUND, TAPER_LENGTH, TAPER_WIDTH = range(11)
"""Columns of a prism: position, heading, half sizes at the base (both the radius if round), z of base and
top, round, and the shares by which length and width shrink to the top: (1, 1) for a cone, (0, 1) for a gable
roof."""
COLUMNS = 11


@dataclass(frozen=True)
class Box:
    """A crate on the floor, or a house."""

    center_m: tuple[float, float]
    size_m: tuple[Length, Length, Length]
    """Length (along its heading), width, height."""
    heading_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    roof_m: Annotated[float, Field(ge=0, le=20)] = 0.0
    """Height of a gable roof on top of it, with its ridge along the length; 0 for a flat roof."""


@dataclass(frozen=True)
class Pylon:
    """An upright cylinder on the floor."""

    center_m: tuple[float, float]
    radius_m: Length
    height_m: Length


@dataclass(frozen=True)
class Tree:
    """A cone of leaves that stands on the ground."""

    center_m: tuple[float, float]
    radius_m: Length
    height_m: Length


Obstacle = Box | Pylon | Tree


def prisms(obstacles: Sequence[Obstacle], ground: Ground = FLAT) -> Array:
    """Return one row per obstacle (n, ``COLUMNS``), upright on the ground, in metres; roofs come last."""
    rows = [_standing(_upright(obstacle), ground) for obstacle in obstacles]
    for row, obstacle in zip(tuple(rows), obstacles, strict=True):
        if isinstance(obstacle, Box) and obstacle.roof_m > 0:
            roof = row.copy()
            roof[[BASE, TOP, TAPER_WIDTH]] = row[TOP], row[TOP] + obstacle.roof_m, 1
            rows.append(roof)
    return np.array(rows).reshape(-1, COLUMNS)


def _upright(obstacle: Obstacle) -> Array:
    """Return the prism (``COLUMNS``,) of an obstacle on a floor at z = 0."""
    if isinstance(obstacle, Box):
        length, width, height = obstacle.size_m
        turn = np.radians(obstacle.heading_deg)
        return np.array(
            [*obstacle.center_m, np.cos(turn), np.sin(turn), length / 2, width / 2, 0, height, 0, 0, 0]
        )
    radius, taper = obstacle.radius_m, float(isinstance(obstacle, Tree))
    return np.array([*obstacle.center_m, 1, 0, radius, radius, 0, obstacle.height_m, 1, taper, taper])


def _standing(prism: Array, ground: Ground) -> Array:
    """Return the prism raised to the ground under its centre, with its base on the lowest ground around."""
    around = corners(prism)[:4]
    rise = float(ground.height(prism[X], prism[Y]))
    # The base is sunk on the uphill side, so that it never floats on the other.
    low = float(ground.height(around[:, 0], around[:, 1]).min())
    raised = prism.copy()
    raised[BASE], raised[TOP] = min(rise, low), rise + prism[TOP]
    return raised


def corners(prism: Array) -> Array:
    """Return the corners (8, 3) of a prism's bounding box: lower four, upper four, counter-clockwise."""
    along = prism[HALF_LENGTH] * np.array([1, 1, -1, -1])
    across = prism[HALF_WIDTH] * np.array([-1, 1, 1, -1])
    x = prism[X] + prism[COS] * along - prism[SIN] * across
    y = prism[Y] + prism[SIN] * along + prism[COS] * across
    return np.column_stack([np.tile(x, 2), np.tile(y, 2), np.repeat(prism[[BASE, TOP]], 4)])


def top(prism: Array, x: Array, y: Array) -> Array:
    """Return the height of a prism's upper surface at the positions (x, y) in metres, -inf beside it.

    The arrays have one shape.
    """
    east, north = x - prism[X], y - prism[Y]
    along = np.abs(prism[COS] * east + prism[SIN] * north) / prism[HALF_LENGTH]
    across = np.abs(prism[COS] * north - prism[SIN] * east) / prism[HALF_WIDTH]
    if prism[ROUND]:
        along, across = np.hypot(along, across), np.zeros_like(across)
    share = np.ones_like(along)
    for outward, taper in ((along, prism[TAPER_LENGTH]), (across, prism[TAPER_WIDTH])):
        if taper > 0:
            share = np.minimum(share, (1 - outward) / taper)
    height = prism[BASE] + share * (prism[TOP] - prism[BASE])
    return np.asarray(np.where((along <= 1) & (across <= 1), height, -np.inf))


def covers(prism: Array, x: Array, y: Array) -> NDArray[np.bool_]:
    """Whether the positions (x, y) in metres lie under a prism; arrays of one shape."""
    return np.asarray(np.isfinite(top(prism, x, y)))


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
