"""Floors: the seeded texture of the ground, with marks that a person can find in the mosaic.

A floor is one picture, row 0 at the largest y, with mip levels for cameras that are higher up. The puzzle
floor is that of the paper: a repeated tile of foam puzzle pieces. Weathering (stains, grain, specks,
scratches) distinguishes the tiles; it repeats only if the recipe asks for it. Boxes and pylons stand on the
floor (``slam.simulation.place.obstacles``), and ``slam.simulation.place.terrain`` gives their height.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam.core.errors import InputError
from slam.simulation.place.court import lines_floor
from slam.simulation.place.ground import Ground, Hill
from slam.simulation.place.gym import gym_floor
from slam.simulation.place.marks import draw_mark
from slam.simulation.place.obstacles import Box, Obstacle, Pylon, Tree, corners, covers, prisms, steps
from slam.simulation.place.photograph import MAX_TEXELS, check_photograph, photographed_floor
from slam.simulation.place.puzzle import puzzle_tile
from slam.simulation.place.weathering import NEUTRAL, apply_weathering, draw_weathering

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

FLOORS = ("puzzle", "gym", "lines", "plain")
"""Names of generated textures; any other name is the path of a photograph."""
MIP_LEVELS = 5
STEPS = 1
"""Random stream of the layout of steps."""
SURROUND_BGR = (122, 131, 138)
"""The bare floor around the puzzle pieces."""
STEEPEST = 0.6
"""Steepest slope of a hill: 31 degrees, which a picture sees from above up to 59 degrees off nadir."""
SHADOW, SHADOW_WIDTH_M = 0.5, 0.05
"""Loss of brightness at an obstacle's foot, and the width of that shadow."""


Slope = Annotated[float, Field(ge=-0.5, le=0.5)]


@dataclass(frozen=True)
class World:
    """The place: the floor, its texture and its obstacles."""

    texture: Annotated[str, Field(min_length=1)] = "puzzle"
    """``puzzle``, ``gym`` (planks with the lines of its courts), ``lines`` (a court's lines on one colour),
    ``plain`` (one grey), or the path of a photograph of a floor, mirrored beyond its edge."""
    extent_m: tuple[float, float, float, float] = (-0.15, -0.15, 4.65, 4.65)
    """x0, y0, x1, y1 of the floor over which flights are allowed."""
    margin_m: Annotated[float, Field(ge=0, le=50)] = 1.0
    """Width of the ground around the floor, weathered like it but without puzzle pieces."""
    metres_per_px: Annotated[float, Field(ge=1e-4, le=1)] = 0.002
    tile_m: Annotated[float, Field(ge=0.2, le=50)] = 1.6
    """Side of the repeated puzzle tile."""
    repeat: bool = False
    """Whether the weathering repeats with the tile too, so that places differ by their marks alone."""
    mark_diameter_m: Annotated[float, Field(ge=0, le=1)] = 0.12
    """Size of a landmark's mark; 0 draws none."""
    blanks_m: Annotated[tuple[tuple[float, float, float, float], ...], Field(max_length=200)] = ()
    """x0, y0, x1, y1 of pieces of the floor that are painted in one grey, without texture."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the floor. Each flight has its own seed, so several flights can share a floor."""
    boxes: Annotated[tuple[Box, ...], Field(max_length=200)] = ()
    pylons: Annotated[tuple[Pylon, ...], Field(max_length=200)] = ()
    trees: Annotated[tuple[Tree, ...], Field(max_length=200)] = ()
    hills: Annotated[tuple[Hill, ...], Field(max_length=20)] = ()
    slope: tuple[Slope, Slope] = (0.0, 0.0)
    """Slope of the floor along x and y; its height is 0 at the origin."""

    @property
    def ground(self) -> Ground:
        """The ground without obstacles."""
        return Ground(self.slope, self.hills)

    @property
    def prisms(self) -> Array:
        """(n, 11) obstacles, as ``slam.simulation.place.obstacles`` defines them."""
        return prisms((*self.boxes, *self.pylons, *self.trees), self.ground)


Marks = tuple[tuple[str, float, float], ...]
"""Name, x and y in metres of each landmark."""


@dataclass(frozen=True)
class Floor:
    """A texture with its mip levels, seen vertically from above."""

    levels: tuple[Image, ...]
    """(h, w, 4) BGR pictures, each half the size of the one before, with a fourth channel without meaning:
    OpenCV interpolates between pixels of four bytes in less than half the time of three."""
    corner_m: tuple[float, float]
    """World x and y of the outer corner of the first texel: smallest x, largest y."""
    metres_per_px: float

    def texel_H_world(self, level: int) -> Array:
        """Return the homography (3, 3) from world x, y to texels; the centre of the first texel is (0, 0)."""
        size = self.metres_per_px * 2**level
        x, y = self.corner_m
        return np.array([[1 / size, 0, -x / size - 0.5], [0, -1 / size, y / size - 0.5], [0, 0, 1]])

    def level_for(self, spacing_m: float) -> int:
        """Return the mip level whose texels are nearest in size to the sample spacing on the ground."""
        return int(np.clip(np.rint(np.log2(spacing_m / self.metres_per_px)), 0, len(self.levels) - 1))


def with_place_terms(world: World, marks: Marks, terms: Mapping[str, Mapping[str, float]]) -> World:
    """Return the world with a model's terms ``floor_slope`` and ``floor_steps``; steps do not cover marks."""
    if slope := terms.get("floor_slope"):
        rise = (world.slope[0] + slope.get("x", 0.0), world.slope[1] + slope.get("y", 0.0))
        world = replace(world, slope=rise)
    laid = terms.get("floor_steps", {})
    height_m, share = laid.get("height", 0.0), laid.get("share", 0.0)
    if height_m > 0 and share > 0:
        clear_m = [(x, y) for _, x, y in marks]
        boxes = steps(world.extent_m, height_m, share, clear_m, np.random.default_rng((world.seed, STEPS)))
        world = replace(world, boxes=(*world.boxes, *boxes))
    return world


def check_world(world: World, seen: bool = True) -> None:
    """Raise ``InputError`` for a floor, photograph or obstacle that cannot be used.

    That is a floor that is empty or too large, a photograph that cannot be read, and an obstacle without size
    or off the floor. Without a camera (``seen``) the texture is not checked.
    """
    x0, y0, x1, y1 = world.extent_m
    if not (np.all(np.isfinite(world.extent_m)) and x1 > x0 and y1 > y0):
        raise InputError(
            f"world.extent_m {list(world.extent_m)} is empty; give x0, y0, x1, y1 with x0 < x1, y0 < y1"
        )
    if seen:
        _check_texture(world)
    for k, (left, low, right, high) in enumerate(world.blanks_m):
        if not (right > left and high > low):  # written so that NaN is refused too
            blank = list(world.blanks_m[k])
            raise InputError(
                f"world.blanks_m[{k}] {blank} is empty; give x0, y0, x1, y1 with x0 < x1, y0 < y1"
            )
    for k, box in enumerate(world.boxes):
        _check_obstacle(box, f"world.boxes[{k}]", world)
    for k, pylon in enumerate(world.pylons):
        _check_obstacle(pylon, f"world.pylons[{k}]", world)
    for k, tree in enumerate(world.trees):
        _check_obstacle(tree, f"world.trees[{k}]", world)
    for k, hill in enumerate(world.hills):
        _check_hill(hill, f"world.hills[{k}]")


def _check_texture(world: World) -> None:
    width, height = _size_px(world)
    if width * height > MAX_TEXELS or world.tile_m / world.metres_per_px > 16_384:
        raise InputError(
            f"world: a texture of {width} x {height} px is too large; "
            "make extent_m smaller or metres_per_px greater"
        )
    if world.texture not in FLOORS:
        check_photograph(Path(world.texture))


def _check_obstacle(obstacle: Obstacle, name: str, world: World) -> None:
    sizes = obstacle.size_m if isinstance(obstacle, Box) else (obstacle.radius_m, obstacle.height_m)
    if not (np.all(np.isfinite(sizes)) and min(sizes) > 0):
        raise InputError(f"{name}: sizes {list(sizes)} m: each must be above 0")
    x0, y0, x1, y1 = world.extent_m
    foot = corners(prisms((obstacle,))[0])[:4, :2]
    if not np.all((foot >= (x0, y0)) & (foot <= (x1, y1))):
        x, y = obstacle.center_m
        raise InputError(f"{name} at ({x:g}, {y:g}) reaches off the floor; move it or enlarge world.extent_m")


def _check_hill(hill: Hill, name: str) -> None:
    steepest = np.exp(-0.5) * abs(hill.height_m) / hill.radius_m
    if not (np.all(np.isfinite(hill.center_m)) and steepest <= STEEPEST):
        raise InputError(
            f"{name}: a slope of {steepest:.2g}; at most {STEEPEST:g}, so that no hill hides a part of "
            "itself: make it lower or wider"
        )


@lru_cache(maxsize=2)
def build_floor(world: World, marks: Marks) -> Floor:
    """Return the floor of a world, cached and reproducible."""
    rng = np.random.default_rng(world.seed)
    width, height = _size_px(world)
    if world.texture == "puzzle":
        texture = _puzzle_floor(world, width, height, rng)
    elif world.texture == "gym":
        texture = gym_floor(width, height, world.metres_per_px, rng)
    elif world.texture == "lines":
        texture = lines_floor(width, height, world.metres_per_px, rng)
    elif world.texture == "plain":
        texture = np.full((height, width, 3), NEUTRAL, np.uint8)
    else:
        texture = photographed_floor(Path(world.texture), width, height)
    corner_m = (world.extent_m[0] - world.margin_m, world.extent_m[3] + world.margin_m)
    for blank_m in world.blanks_m:
        _paint_blank(texture, blank_m, corner_m, world.metres_per_px)
    if world.mark_diameter_m > 0:
        for name, x, y in marks:
            center = (
                (x - corner_m[0]) / world.metres_per_px - 0.5,
                (corner_m[1] - y) / world.metres_per_px - 0.5,
            )
            draw_mark(texture, name, center, world.mark_diameter_m / 2 / world.metres_per_px)
    for prism in world.prisms:
        _cast_shadow(texture, prism, corner_m, world.metres_per_px)
    levels: list[Image] = [np.asarray(cv2.cvtColor(texture, cv2.COLOR_BGR2BGRA))]
    while len(levels) < MIP_LEVELS and min(levels[-1].shape[:2]) >= 64:
        levels.append(cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    for level in levels:
        level.flags.writeable = False
    return Floor(tuple(levels), corner_m, world.metres_per_px)


def _size_px(world: World) -> tuple[int, int]:
    """Return width and height of the texture, rounded up so that every mip level is a half."""
    x0, y0, x1, y1 = world.extent_m
    step = 2 ** (MIP_LEVELS - 1)
    sides = np.array([x1 - x0, y1 - y0]) + 2 * world.margin_m
    with np.errstate(over="ignore"):
        steps_px = np.ceil(np.round(sides / world.metres_per_px / step, 6))
    width, height = np.minimum(steps_px, MAX_TEXELS).astype(int) * step  # what is larger is refused anyway
    return int(width), int(height)


def _puzzle_floor(world: World, width: int, height: int, rng: np.random.Generator) -> Image:
    """Draw puzzle tiles inside the extent, the bare surround outside, and weathering over both."""
    tile = puzzle_tile(round(world.tile_m / world.metres_per_px), rng)
    n = len(tile)
    margin = round(world.margin_m / world.metres_per_px)
    x0, y0, x1, y1 = world.extent_m
    rows, cols = (round(side_m / world.metres_per_px) for side_m in (y1 - y0, x1 - x0))
    texture = np.repeat(np.full((1, width, 3), SURROUND_BGR, np.uint8), height, axis=0)
    inside = texture[margin : margin + rows, margin : margin + cols]
    inside[:] = _repeated(tile, *inside.shape[:2])
    if world.repeat:
        weathering = draw_weathering(n, n, world.metres_per_px, rng)
        start = -margin % n
        weathering = _repeated(np.roll(weathering, (-start, -start), (0, 1)), height, width)
    else:
        weathering = draw_weathering(height, width, world.metres_per_px, rng)
    apply_weathering(texture, weathering)
    return texture


def _repeated(tile: Image, height: int, width: int) -> Image:
    """Return (height, width, ...) pixels of a plane covered with a tile, which begins in its first corner."""
    across = np.take(tile, np.arange(width) % tile.shape[1], axis=1)
    return np.asarray(np.take(across, np.arange(height) % tile.shape[0], axis=0))


def _paint_blank(
    texture: Image,
    blank_m: tuple[float, float, float, float],
    corner_m: tuple[float, float],
    metres_per_px: float,
) -> None:
    """Paint a rectangle (x0, y0, x1, y1) in one grey; what lies off the texture is left out."""
    x0, y0, x1, y1 = blank_m
    columns, rows = (np.array([x0, x1]) - corner_m[0]), (corner_m[1] - np.array([y1, y0]))
    (c0, c1), (r0, r1) = (np.maximum(np.rint(at / metres_per_px).astype(int), 0) for at in (columns, rows))
    texture[r0:r1, c0:c1] = NEUTRAL


def _cast_shadow(texture: Image, prism: Array, corner_m: tuple[float, float], metres_per_px: float) -> None:
    """Darken the floor around the foot of an obstacle, where little light arrives."""
    foot = corners(prism)[:4, :2]
    reach = 3 * SHADOW_WIDTH_M
    # Two corners of the piece of texture: columns increase with x, rows decrease with y.
    low = np.array([foot[:, 0].min() - reach - corner_m[0], corner_m[1] - foot[:, 1].max() - reach])
    high = np.array([foot[:, 0].max() + reach - corner_m[0], corner_m[1] - foot[:, 1].min() + reach])
    (c0, r0), (c1, r1) = (np.clip(np.rint(at / metres_per_px).astype(int), 0, None) for at in (low, high))
    piece = texture[r0:r1, c0:c1]
    if piece.size == 0:
        return
    rows, cols = np.mgrid[r0 : r0 + piece.shape[0], c0 : c0 + piece.shape[1]] + 0.5
    under = covers(prism, corner_m[0] + cols * metres_per_px, corner_m[1] - rows * metres_per_px)
    shade = cv2.GaussianBlur(under.astype(np.float32), (0, 0), SHADOW_WIDTH_M / metres_per_px)
    piece[:] = np.rint(piece * (1 - SHADOW * np.minimum(2 * shade, 1))[..., None])
