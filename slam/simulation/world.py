"""Floors: the texture of the ground, seeded, with marks that a person finds again in the mosaic.

A floor is one picture, row 0 at the largest y, and its halvings: mip levels for cameras that see it from
higher up. The puzzle floor is the paper's: a tile of foam puzzle pieces, repeated. What tells one tile from
the next is wear (stains, grain, specks, scratches), which does not repeat unless the recipe asks for it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from pydantic import Field

from slam.errors import InputError
from slam.simulation.puzzle import puzzle_tile

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

MAX_TEXELS = 64_000_000
MIP_LEVELS = 5
NEUTRAL = 128
"""Grey of a plain floor, and the wear that changes nothing."""
SURROUND_BGR = (122, 131, 138)
"""The bare floor around the puzzle pieces."""
WEAR_CONTRAST = 0.16
"""Standard deviation of the wear, as a share of the brightness."""
SPECKS_PER_M2 = 200
SCRATCHES_PER_M2 = 7


@dataclass(frozen=True)
class World:
    """What the floor looks like."""

    texture: Annotated[str, Field(min_length=1)] = "puzzle"
    """``puzzle``, ``plain`` (one grey), or the path of a photograph of a floor, mirrored beyond its edge."""
    extent_m: tuple[float, float, float, float] = (-0.15, -0.15, 4.65, 4.65)
    """x0, y0, x1, y1 of the floor that may be flown over."""
    margin_m: Annotated[float, Field(ge=0, le=50)] = 1.0
    """Ground around it, worn like the floor but without puzzle pieces."""
    metres_per_px: Annotated[float, Field(ge=1e-4, le=1)] = 0.002
    tile_m: Annotated[float, Field(ge=0.2, le=50)] = 1.6
    """Side of the puzzle tile that is repeated."""
    repeat: bool = False
    """The wear repeats with the tile too: places look alike but for the marks."""
    mark_diameter_m: Annotated[float, Field(ge=0, le=1)] = 0.12
    """Size of a landmark's mark; 0 draws none."""
    seed: Annotated[int, Field(ge=0)] = 0
    """The floor is a place: another flight over it has another seed, the floor keeps its own."""


Marks = tuple[tuple[str, float, float], ...]
"""Name, x and y in metres of each landmark."""


@dataclass(frozen=True)
class Floor:
    """A texture with its mip levels, on the plane z = 0."""

    levels: tuple[Image, ...]
    """(h, w, 3) BGR, each half the size of the one before."""
    corner_m: tuple[float, float]
    """World x and y of the outer corner of the first texel: smallest x, largest y."""
    metres_per_px: float

    def texel_H_world(self, level: int) -> Array:
        """(3, 3) world x, y to texel coordinates of a level; the centre of the first texel is (0, 0)."""
        size = self.metres_per_px * 2**level
        x, y = self.corner_m
        return np.array([[1 / size, 0, -x / size - 0.5], [0, -1 / size, y / size - 0.5], [0, 0, 1]])

    def level_for(self, spacing_m: float) -> int:
        """The mip level whose texels are nearest in size to the spacing of samples on the ground."""
        return int(np.clip(np.rint(np.log2(spacing_m / self.metres_per_px)), 0, len(self.levels) - 1))


def check_world(world: World) -> None:
    """Raise ``InputError`` for a floor of no or too great a size, or a photograph that cannot be read."""
    x0, y0, x1, y1 = world.extent_m
    if not (np.all(np.isfinite(world.extent_m)) and x1 > x0 and y1 > y0):
        raise InputError(
            f"world.extent_m {list(world.extent_m)} is empty; give x0, y0, x1, y1 with x0 < x1, y0 < y1"
        )
    width, height = _size_px(world)
    if width * height > MAX_TEXELS or world.tile_m / world.metres_per_px > 16_384:
        raise InputError(
            f"world: a texture of {width} x {height} px is too large; "
            "make extent_m smaller or metres_per_px greater"
        )
    if world.texture not in ("puzzle", "plain"):
        _check_photograph(Path(world.texture))


@lru_cache(maxsize=2)
def build_floor(world: World, marks: Marks) -> Floor:
    """The floor of a world; the same for the same arguments, and kept for the next call."""
    rng = np.random.default_rng(world.seed)
    width, height = _size_px(world)
    if world.texture == "puzzle":
        texture = _puzzle_floor(world, width, height, rng)
    elif world.texture == "plain":
        texture = np.full((height, width, 3), NEUTRAL, np.uint8)
    else:
        texture = _photographed_floor(Path(world.texture), width, height)
    corner_m = (world.extent_m[0] - world.margin_m, world.extent_m[3] + world.margin_m)
    if world.mark_diameter_m > 0:
        for name, x, y in marks:
            center = (
                (x - corner_m[0]) / world.metres_per_px - 0.5,
                (corner_m[1] - y) / world.metres_per_px - 0.5,
            )
            _draw_mark(texture, name, center, world.mark_diameter_m / 2 / world.metres_per_px)
    levels = [texture]
    while len(levels) < MIP_LEVELS and min(levels[-1].shape[:2]) >= 64:
        levels.append(cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    for level in levels:
        level.flags.writeable = False
    return Floor(tuple(levels), corner_m, world.metres_per_px)


def _size_px(world: World) -> tuple[int, int]:
    """Width and height of the texture, rounded up to what can be halved into every mip level."""
    x0, y0, x1, y1 = world.extent_m
    step = 2 ** (MIP_LEVELS - 1)
    sides = np.array([x1 - x0, y1 - y0]) + 2 * world.margin_m
    width, height = np.ceil(np.round(sides / world.metres_per_px / step, 6)).astype(int) * step
    return int(width), int(height)


def _puzzle_floor(world: World, width: int, height: int, rng: np.random.Generator) -> Image:
    """Puzzle tiles inside the extent, the bare surround outside, and wear over both."""
    tile = puzzle_tile(round(world.tile_m / world.metres_per_px), rng)
    n = len(tile)
    margin = round(world.margin_m / world.metres_per_px)
    rows, cols = (np.arange(size) - margin for size in (height, width))
    inside = [
        (index >= 0) & (index < round((high - low) / world.metres_per_px))
        for index, low, high in ((rows, *world.extent_m[1::2]), (cols, *world.extent_m[::2]))
    ]
    texture = np.full((height, width, 3), SURROUND_BGR, np.uint8)
    texture[np.ix_(*inside)] = tile[np.ix_(rows[inside[0]] % n, cols[inside[1]] % n)]
    if world.repeat:
        wear = _wear(n, n, world.metres_per_px, rng)[np.ix_(rows % n, cols % n)]
    else:
        wear = _wear(height, width, world.metres_per_px, rng)
    for channel in range(3):
        texture[..., channel] = cv2.multiply(texture[..., channel], wear, scale=1 / NEUTRAL)
    return texture


def _wear(height: int, width: int, metres_per_px: float, rng: np.random.Generator) -> Image:
    """Brightness that a floor's use leaves, ``NEUTRAL`` where none: stains and grain, specks, scratches.

    Stains and grain have the spectrum of natural pictures (amplitude falls with frequency, equal power in
    each octave, from 1.2 m down to the texel), and are periodic, so that a tile of them repeats seamlessly.
    """
    spectrum = scipy.fft.rfft2(rng.standard_normal((height, width), dtype=np.float32))
    fy = scipy.fft.fftfreq(height, metres_per_px).astype(np.float32)[:, None]
    fx = scipy.fft.rfftfreq(width, metres_per_px).astype(np.float32)[None]
    spectrum /= np.hypot(np.hypot(fx, fy), np.float32(1 / 1.2))
    spectrum[0, 0] = 0
    stains = scipy.fft.irfft2(spectrum, (height, width), overwrite_x=True)
    stains *= NEUTRAL * WEAR_CONTRAST / stains.std()
    wear = np.clip(stains + NEUTRAL, 30, 225).astype(np.uint8)
    area_m2 = height * width * metres_per_px**2
    for _ in range(int(SPECKS_PER_M2 * area_m2)):
        x, y = rng.uniform(0, [width, height])
        radius = rng.uniform(0.0015, 0.006) / metres_per_px
        _disc(wear, (x, y), radius, int(rng.choice([rng.integers(40, 90), rng.integers(165, 215)])))
    for _ in range(int(SCRATCHES_PER_M2 * area_m2)):
        _scratch(wear, metres_per_px, rng)
    return wear


def _scratch(wear: Image, metres_per_px: float, rng: np.random.Generator) -> None:
    """A bent line of some centimetres, clipped at the border."""
    height, width = wear.shape
    turn = rng.uniform(0, 2 * np.pi) + np.linspace(0, rng.normal(0, 0.7), 12)
    step = rng.uniform(0.03, 0.30) / 12 / metres_per_px
    points = rng.uniform(0, [width, height]) + np.cumsum(
        step * np.column_stack([np.cos(turn), np.sin(turn)]), 0
    )
    shade, thickness = (
        int(rng.choice([60, 85, 175, 200])),
        max(1, round(rng.uniform(0.001, 0.004) / metres_per_px)),
    )
    cv2.polylines(wear, [np.int32(points * 16)], False, shade, thickness, cv2.LINE_AA, 4)


def _disc(image: Image, center: tuple[float, float], radius: float, shade: int | tuple[int, ...]) -> None:
    at = (round(center[0] * 16), round(center[1] * 16))
    cv2.circle(image, at, round(radius * 16), shade, -1, cv2.LINE_AA, 4)


def _draw_mark(texture: Image, name: str, center: tuple[float, float], radius: float) -> None:
    """A white disc with a black ring and its letter, drawn eight times too large and averaged down."""
    fine, half = 8, int(np.ceil(radius)) + 2
    size = (2 * half + 1) * fine
    corner = np.floor(np.array(center) + 0.5).astype(int) - half
    middle = (np.array(center) - corner + 0.5) * fine - 0.5
    y, x = np.mgrid[:size, :size]
    distance = np.hypot(x - middle[0], y - middle[1]) / (radius * fine)
    patch = np.full((size, size), 245, np.uint8)
    patch[(distance > 0.74) & (distance < 0.90)] = 15
    font, bold = cv2.FONT_HERSHEY_DUPLEX, max(1, round(radius * fine / 7))
    (w, h), _ = cv2.getTextSize(name, font, 1.0, 1)
    scale = 0.95 * radius * fine / np.hypot(w, h)
    (w, h), _ = cv2.getTextSize(name, font, scale, bold)
    cv2.putText(
        patch, name, (round(middle[0] - w / 2), round(middle[1] + h / 2)), font, scale, 15, bold, cv2.LINE_AA
    )
    area = (2 * half + 1, 2 * half + 1)
    ink = cv2.resize(patch, area, interpolation=cv2.INTER_AREA).astype(float)
    cover = cv2.resize((distance < 1).astype(np.float32), area, interpolation=cv2.INTER_AREA)
    rows, cols = (np.arange(2 * half + 1) + corner[axis] for axis in (1, 0))
    r, c = ((rows >= 0) & (rows < texture.shape[0])), ((cols >= 0) & (cols < texture.shape[1]))
    if r.any() and c.any():
        under = texture[np.ix_(rows[r], cols[c])]
        over, share = ink[np.ix_(r, c)][..., None], cover[np.ix_(r, c)][..., None]
        texture[np.ix_(rows[r], cols[c])] = np.rint(share * over + (1 - share) * under).astype(np.uint8)


def _check_photograph(path: Path) -> None:
    """Judge the file by its header, before anything of it is decoded."""
    from PIL import Image as Photograph

    if not path.is_file():
        raise InputError(
            f"world.texture: {str(path)!r}: no such file; give 'puzzle', 'plain' or a photograph"
        )
    too_large = InputError(f"world.texture: {str(path)!r}: more than {MAX_TEXELS} px; scale it down")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Photograph.DecompressionBombWarning)
            with Photograph.open(path) as photograph:
                width, height = photograph.size
    except (Photograph.DecompressionBombWarning, Photograph.DecompressionBombError):
        raise too_large from None
    except (OSError, ValueError):
        raise InputError(
            f"world.texture: {str(path)!r}: not a picture that can be read; give a JPEG or PNG"
        ) from None
    if width * height > MAX_TEXELS:
        raise too_large


def _photographed_floor(path: Path, width: int, height: int) -> Image:
    """The photograph at the floor's lower left corner, mirrored beyond its edges to fill the texture."""
    photograph = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if photograph is None:
        raise InputError(f"world.texture: {str(path)!r}: damaged or not a picture; give a JPEG or PNG")
    photograph = photograph[-height:, :width]
    h, w = photograph.shape[:2]
    return cv2.copyMakeBorder(photograph, height - h, 0, 0, width - w, cv2.BORDER_REFLECT)
