"""The obstacles of a refined map by its raised floor points, where the truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.refinement import refine
from frontend.obstacles import ObstacleList
from slam.core.streams import Sonar
from slam.mapping.config import MaskingConfig
from slam.mapping.obstacle_list import map_elevation, map_obstacles, obstacles_by_points
from slam.mapping.obstacles import RELATIVE_GAMMA
from tests.backend.bundle.made_scenes import SONAR
from tests.backend.made_floor import Scene, make
from tests.slam.mapping.made_map import made_map

BOX = 0.5, 1.0, -0.1, 0.4
"""Over the height of 0.8 m: 0.4 m x 0.4 m around (0.6, 0.12), 0.2 m high."""
VIDEO = replace(SONAR, range_std_m=None, attitude_std_rad=None)


def found_over(scene: Scene, metric: bool = True, config: MaskingConfig = MaskingConfig()) -> ObstacleList:
    made = make(replace(scene, points_in_view=100), 1)
    return obstacles_by_points(refine(made.measurements, made.start, made.floor_z_m), metric, config)


@pytest.mark.parametrize("scene", [SONAR, VIDEO, replace(SONAR, rolling=0.02)])
def test_a_box_is_found_with_a_sonar_and_without(scene: Scene):
    (box,) = found_over(replace(scene, box=BOX)).found
    assert (box.x_m, box.y_m) == pytest.approx((0.6, 0.12), abs=0.05)
    assert box.height_m == pytest.approx(0.2, abs=0.03)
    assert box.area_m2 == pytest.approx(0.16, rel=0.3)
    assert box.measured_by == ("pictures",)


@pytest.mark.parametrize("scene", [SONAR, replace(SONAR, rolling=0.05), replace(SONAR, walls=0.05)])
def test_a_flat_floor_ground_that_rolls_and_single_points_are_none(scene: Scene):
    assert found_over(scene).found == ()


def test_what_is_lower_than_gamma_3_is_none():
    assert found_over(replace(SONAR, box=BOX), config=MaskingConfig(gamma_3_m=0.3)).found == ()


def test_the_relief_of_the_ground_is_none_however_low_gamma_3_is():
    found = found_over(replace(SONAR, box=BOX, rolling=0.02), config=MaskingConfig(gamma_3_m=0.01))
    assert len(found.found) == 1


def test_gamma_3_is_no_length_of_a_map_without_metres():
    found = found_over(replace(VIDEO, box=BOX), False, MaskingConfig(gamma_3_m=1e3))
    assert found.above_m == RELATIVE_GAMMA
    assert len(found.found) == 1


@pytest.mark.parametrize("georeferenced", [False, True])
def test_echoes_of_another_part_are_no_obstacles_of_the_largest(georeferenced: bool):
    """In its own world it flies beside the places of the largest, over a box half a metre high."""
    stamps_s = np.arange(100.0)
    w_T_b = np.tile(np.eye(4), (100, 1, 1))
    w_T_b[:, :3, 3] = np.column_stack([0.1 * (stamps_s % 70), 0 * stamps_s, np.full(100, 2.0)])
    component = (stamps_s >= 70).astype(np.int64)
    w_T_b[component == 1, 1, 3] = 5.0
    heard_s = np.arange(0.0, 99.0, 0.1)
    over_box = (heard_s >= 80) & (heard_s < 90)
    noise_m = np.random.default_rng(0).normal(0, 0.002, len(heard_s))
    sonar = Sonar(heard_s, np.where(over_box, 1.5, 2.0) + noise_m)
    map_ = replace(made_map(w_T_b, component), georeferenced=georeferenced)
    assert map_obstacles(map_, sonar, MaskingConfig()) is None
    assert len(map_obstacles(replace(map_, component=0 * component), sonar, MaskingConfig()).found) == 1
    highest_m = np.nanmax(map_elevation(map_, sonar).height_m)
    assert highest_m == pytest.approx(0.5 if georeferenced else 0.0, abs=0.01)
