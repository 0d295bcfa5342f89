"""What stands on the ground is drawn from one picture, and seams run around it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frontend.camera import Camera
from frontend.mosaic.canvas import CELL_PX
from frontend.mosaic.plan import MosaicPlan, plan_mosaic
from frontend.mosaic.structures import structures
from frontend.mosaic.surface import HeightSource, Surface
from tests.frontend.mosaic.scene import FLOOR_Z_M, pose

CAMERA = Camera((300.0, 300.0), (199.5, 149.5), (400, 300))
POSES = np.array([pose(0.5 * (k % 4) - 0.75, 0.5 * (k // 4) - 0.75, 2.0) for k in range(16)])
GSD_M, CELL_M = 0.006, 0.012
SIDE_M = 4.0


def village(houses: list[tuple[float, float, float, float]], slope: float = 0.0) -> Surface:
    """Houses of half a metre (west, east, south, north), on ground that rises to the east."""
    middle = (np.arange(round(SIDE_M / CELL_M)) + 0.5) * CELL_M - SIDE_M / 2
    x, y = np.meshgrid(middle, -middle)
    height = slope * x
    for west, east, south, north in houses:
        height = height + 0.5 * ((x > west) & (x < east) & (y > south) & (y < north))
    height_m = height.astype(np.float32)
    source = np.full(height.shape, HeightSource.PICTURES, np.uint8)
    return Surface(-SIDE_M / 2, SIDE_M / 2, CELL_M, height_m, np.full_like(height_m, 0.005), source)


def owners(plan: MosaicPlan, west: float, east: float, south: float, north: float) -> set[int]:
    """Owners of the cells whose middles lie in a rectangle."""
    rows, cols = plan.owner.shape
    x = plan.west_m + (np.arange(cols) + 0.5) * CELL_PX * plan.gsd_m
    y = plan.north_m - (np.arange(rows) + 0.5) * CELL_PX * plan.gsd_m
    inside = np.ix_((y > south) & (y < north), (x > west) & (x < east))
    return set(np.unique(plan.owner[inside]).tolist())


HOUSES = [(-0.3, 0.2, -0.2, 0.3), (-0.95, -0.5, -0.7, -0.4), (0.55, 0.9, 0.3, 0.9)]


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_no_seam_crosses_a_roof_with_ground_around_it(slope):
    flat = plan_mosaic(CAMERA, POSES, FLOOR_Z_M, GSD_M, surface=village([], slope))
    plan = plan_mosaic(CAMERA, POSES, FLOOR_Z_M, GSD_M, surface=village(HOUSES, slope))
    assert max(len(owners(flat, *house)) for house in HOUSES) > 1
    for house in HOUSES:
        assert len(owners(plan, *house)) == 1
    assert np.array_equal(plan.owner >= 0, flat.owner >= 0)
    assert len(np.unique(plan.owner)) > 4  # the ground still has its seams


def test_a_slope_is_no_structure():
    """All of a hillside would be one, and would be drawn from any picture that shows it."""
    plan = plan_mosaic(CAMERA, POSES, FLOOR_Z_M, GSD_M)
    assert structures(village([], 0.3), plan, 1.0)[1] == []
    assert len(structures(village(HOUSES, 0.3), plan, 1.0)[1]) == len(HOUSES)


@pytest.mark.parametrize(("std_m", "count"), [(0.1, len(HOUSES)), (0.2, 0)])
def test_heights_must_be_sure_to_be_those_of_a_structure(std_m, count):
    plan, seen = plan_mosaic(CAMERA, POSES, FLOOR_Z_M, GSD_M), village(HOUSES)
    uncertain = replace(seen, std_m=np.full_like(seen.height_m, std_m))
    assert len(structures(uncertain, plan, 1.0)[1]) == count


def test_a_roof_that_no_picture_shows_whole_keeps_its_seams():
    long = (-1.6, 1.6, -0.2, 0.1)
    plan = plan_mosaic(CAMERA, POSES, FLOOR_Z_M, GSD_M, surface=village([long]))
    assert len(owners(plan, *long)) > 1
