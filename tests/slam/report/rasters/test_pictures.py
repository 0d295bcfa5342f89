"""Pictures of what the sonar heard and how well the map is known, for a person."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from frontend.mosaic.quality import MosaicQuality
from slam.core.plot_style import UNMEASURED
from slam.io.geotiff import Grid
from slam.report.rasters.elevation import elevation_picture
from slam.report.rasters.quality import quality_picture

GRID = Grid(0.0, 4.0, 0.1, 60, 40, None)
HOLES = np.zeros((40, 60), bool)
HOLES[10:30, 20:40] = True


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def share(png: bytes, colour: str) -> float:
    wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return float((np.abs(pixels(png) - wanted).sum(axis=2) < 10).mean())


def heights(size_m: float) -> np.ndarray:
    drawn = np.random.default_rng(0).normal(0, size_m, (40, 60)).astype(np.float32)
    drawn[HOLES] = np.nan
    return drawn


def test_a_flat_floor_stands_in_the_middle_of_the_colours_and_holes_are_distinguished():
    flat = elevation_picture(heights(1e-4), GRID)
    middle = "#21918c"  # viridis at one half
    assert share(flat, middle) > 0.25
    assert 0.05 < share(flat, UNMEASURED) < 0.3
    assert share(elevation_picture(heights(0.3), GRID), middle) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(40, 60), (60, 20), (12, 90)])
def test_pictures_of_maps_have_no_wide_margins(shape):
    grid = Grid(0.0, 4.0, 0.1, shape[1], shape[0], None)
    values = np.full(shape, 0.01, np.float32)
    quality = MosaicQuality(0.1, values, values, values)
    for png in (quality_picture(quality, grid), elevation_picture(values, grid)):
        blank = (pixels(png) > 250).all(axis=2)
        wide_px = 0.02 * max(blank.shape)
        for lines in (blank.all(axis=1), blank.all(axis=0)):
            inked = np.flatnonzero(~lines)
            assert inked[0] < wide_px
            assert len(lines) - inked[-1] < wide_px
