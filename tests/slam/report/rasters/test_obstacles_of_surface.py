"""Obstacles of a measured surface join those of the floor points and of the echoes in one list."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frontend.mosaic.surface import HeightSource, Surface
from frontend.obstacles import Obstacle, ObstacleList
from frontend.surface.misregistration import Misregistration
from slam.core.estimate import Estimate
from slam.core.summary import summarise
from slam.report.rasters.obstacles import with_all_obstacles
from slam.report.rasters.surface import MeasuredGround, OverPlane
from tests.slam.evaluation.scene import estimate_of

NONE_COMPARED = Misregistration((0, 0), np.zeros((0, 2), np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
STD_M = 0.02


def ground(slope: float = 0.0) -> MeasuredGround:
    """A house of 3 m and a hole that was filled in, on ground that rises to the east by ``slope``."""
    height = np.zeros((200, 300), np.float32)
    height[50:80, 100:140] = 3.0
    height[150:170, 100:140] = 2.0
    source = np.full(height.shape, HeightSource.PICTURES, np.uint8)
    source[150:170] = HeightSource.FILLED
    height += slope * (0.1 * (np.arange(300) + 0.5) + 10.0)
    surface = Surface(
        10.0, 20.0, 0.1, height.astype(np.float32), np.full(height.shape, STD_M, np.float32), source
    )
    plane = OverPlane(np.zeros(height.shape, bool), surface.std_m, {}) if slope else None
    return MeasuredGround(NONE_COMPARED, surface, over_plane=plane)


def known(*found: Obstacle, slope: float = 0.0) -> Estimate:
    poses = estimate_of(np.tile(np.eye(4), (2, 1, 1)))
    return replace(
        poses, obstacles=ObstacleList(0.06, found), floor_slope_rad=(0.0, -float(np.arctan(slope)))
    )


@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_a_house_of_the_surface_is_in_the_list(slope: float):
    made = with_all_obstacles(known(slope=slope), ground(slope))
    assert made.obstacles.above_m == pytest.approx(5 * STD_M)
    (house,) = made.obstacles.found
    assert (house.x_m, house.y_m, house.height_m, house.area_m2) == pytest.approx(
        (22.0, 13.5, 3.0, 12.0), abs=0.01
    )
    assert house.measured_by == ("pictures",)
    (note,) = made.messages
    assert "1 thing that stands higher than" in note.text
    assert note.about == "obstacles"


def test_the_list_has_what_points_and_echoes_show_too():
    points = Obstacle(22.1, 13.4, 2.9, 9.0, ("pictures",))
    echoes = Obstacle(35.0, 5.0, 0.3, 0.5, ("sonar",))
    made = with_all_obstacles(known(points, echoes), ground())
    assert [(one.x_m, one.measured_by) for one in made.obstacles.found] == [
        (pytest.approx(22.0), ("pictures",)),
        (35.0, ("sonar",)),
    ]
    record = summarise(made).to_json()["obstacles"]
    assert [sorted(one) for one in record["found"]] == [
        ["area_m2", "height_m", "measured_by", "x_m", "y_m"]
    ] * 2


def test_a_map_without_a_surface_has_the_other_obstacles():
    echoes = Obstacle(35.0, 5.0, 0.3, 0.5, ("sonar",))
    for measured in (None, MeasuredGround(NONE_COMPARED, None)):
        made = with_all_obstacles(known(echoes), measured)
        assert made.obstacles.found == (echoes,)
        assert not made.messages, "echoes have a note of their own"
    assert with_all_obstacles(replace(known(), obstacles=None), ground()).obstacles is None
