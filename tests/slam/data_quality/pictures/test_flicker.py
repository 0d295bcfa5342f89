"""Bands of light are seen as such, and nothing else that darkens a picture is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.data_quality.pictures.cells import Cells
from slam.data_quality.pictures.flicker import LEAST_FLICKER, flicker_of

Array = NDArray[np.float64]
Light = Callable[[Array, int, np.random.Generator], Array]
CAMERA = Camera((140.8, 140.8), (87.5, 71.5), (176, 144))
COLUMNS, ROWS = 15, 12


def cells(light: Light, pairs: int = 60) -> Cells:
    """Of pictures that moved by some pixels; ``light`` of pixels in a picture, as a logarithm."""
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)), axis=-1).reshape(-1, 2) * 12.0 + 5.5
    found = []
    for k in range(pairs):
        was = grid + rng.uniform(-25.0, 25.0, 2)
        both = (was > 0).all(axis=1) & (was < CAMERA.size_px).all(axis=1)
        pixel_i, pixel_j = grid[both], was[both]
        ratio = light(pixel_i, k + 1, rng) - light(pixel_j, k, rng) + 0.002 * rng.standard_normal(both.sum())
        found.append((k, k + 1, np.column_stack([pixel_i, pixel_j, ratio])))
    return Cells.of(found)


def flicker(size: float, axis: int) -> Light:
    phase = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, 100)

    def light(pixel: Array, picture: int, rng: np.random.Generator) -> Array:
        return np.log1p(size * np.sin(2.0 * np.pi * pixel[:, axis] / 60.0 + phase[picture]))

    return light


def dark_edges(pixel: Array, picture: int, rng: np.random.Generator) -> Array:
    return np.log1p(-0.5 * ((pixel - CAMERA.center_px) ** 2).sum(axis=1) / (np.hypot(176, 144) / 2) ** 2)


def stain(pixel: Array, picture: int, rng: np.random.Generator) -> Array:
    return np.log1p(-0.6 * np.exp(-((pixel - (120.0, 50.0)) ** 2).sum(axis=1) / (2 * 9.0**2)))


def things(pixel: Array, picture: int, rng: np.random.Generator) -> Array:
    """A tenth of the picture, elsewhere in each."""
    at = rng.uniform(20.0, 120.0, 2)
    return np.where((np.abs(pixel - at) < 25.0).all(axis=1), 0.7, 0.0)


def exposure(pixel: Array, picture: int, rng: np.random.Generator) -> Array:
    return np.full(len(pixel), 0.2 * rng.standard_normal())


@pytest.mark.parametrize("axis", [0, 1])
def test_flicker_is_bands_at_their_size(axis: int) -> None:
    found = flicker_of(CAMERA, cells(flicker(0.08, axis)))
    # Two pictures differ by the root of two of what one has, most pairs by more than half of that.
    assert 0.03 < found < 0.08


@pytest.mark.parametrize("light", [dark_edges, stain, things, exposure], ids=lambda f: f.__name__)
def test_what_is_no_band_is_none(light: Light) -> None:
    assert flicker_of(CAMERA, cells(light)) < 0.5 * LEAST_FLICKER


def test_few_pairs_show_nothing() -> None:
    assert flicker_of(CAMERA, cells(flicker(0.2, 1), pairs=10)) == 0.0
    assert flicker_of(CAMERA, Cells.of(())) == 0.0
