"""The first echo of a sonar over a floor with obstacles."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.simulation.place.obstacles import Box
from slam.simulation.place.terrain import elevation, first_echo
from tests.slam.simulation.place.test_obstacles import FLAT, GYM


def surface_points(world):
    """Points some millimetres apart on the floor and all over the obstacles."""
    grid = np.arange(0.3, 2.7, 0.006)
    x, y = (a.ravel() for a in np.meshgrid(grid, grid))
    points = [np.column_stack([x, y, world.slope[0] * x + world.slope[1] * y])]
    for obstacle in (*world.boxes, *world.pylons):
        c = np.array(obstacle.center_m)
        base = float(np.array(world.slope) @ c)
        if isinstance(obstacle, Box):
            length, width, height = obstacle.size_m
            turn = np.radians(obstacle.heading_deg)
            corner = np.array([(1, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)]) * (length / 2, width / 2)
            rim = np.vstack([np.linspace(a, b, 120) for a, b in pairwise(corner)])
            rim = rim @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        else:
            height = obstacle.height_m
            turn = np.linspace(0, 2 * np.pi, 240)
            rim = obstacle.radius_m * np.column_stack([np.cos(turn), np.sin(turn)])
        sizes, levels = np.linspace(0, 1, 50), np.linspace(0, height, 120)
        top = (rim[None] * sizes[:, None, None]).reshape(-1, 2)
        points.append(np.column_stack([c + top, np.full(len(top), base + height)]))
        side = np.tile(rim, (len(levels), 1))
        points.append(np.column_stack([c + side, base + np.repeat(levels, len(rim))]))
    return np.vstack(points)


@pytest.mark.parametrize(
    ("beam_deg", "slope"),
    [
        (25.0, (0.1, 0.05)),
        *(
            pytest.param(beam_deg, slope, marks=pytest.mark.slow)
            for beam_deg, slope in (
                (10.0, (0.0, 0.0)),
                (50.0, (0.0, 0.0)),
                (10.0, (0.1, 0.05)),
                (50.0, (0.1, 0.05)),
            )
        ),
        pytest.param(25.0, (0.0, 0.0), marks=pytest.mark.slow),
    ],
)
def test_the_first_echo_is_that_of_the_nearest_surface_in_the_cone(beam_deg, slope):
    world = replace(GYM, slope=slope)
    points = surface_points(world)
    rng = np.random.default_rng(2)
    origin = np.column_stack([*rng.uniform(0.9, 2.0, (2, 60)), rng.uniform(0.9, 1.3, 60)])
    axis = Rotation.from_euler("xy", rng.normal(0, 8, (60, 2)), degrees=True).apply([0, 0, -1.0])
    found = first_echo(world, origin, axis, np.radians(beam_deg))
    inside_body = elevation(world, origin[:, 0], origin[:, 1]) > origin[:, 2]
    for o, a, echo in zip(origin[~inside_body], axis[~inside_body], found[~inside_body], strict=True):
        ray = points - o
        distance = np.linalg.norm(ray, axis=1)
        cosine = ray @ a / distance
        # From a cone that is a little narrower, and one a little wider: the points are 6 mm apart.
        narrow = distance[cosine > np.cos(np.radians(beam_deg / 2 - 1))].min()
        wide = distance[cosine > np.cos(np.radians(beam_deg / 2 + 1))].min()
        assert wide - 0.012 < echo < narrow + 1e-3


def test_the_floor_s_echo_is_exact():
    """A wide beam that holds the plumb line reads the height; a tilted ray the slant range."""
    tilt = np.radians([0, 5, 12, 20, 40])
    axis = np.column_stack([np.sin(tilt), 0 * tilt, -np.cos(tilt)])
    origin = np.tile([1.5, 1.5, 1.2], (5, 1))
    assert first_echo(FLAT, origin, axis) == pytest.approx(1.2 / np.cos(tilt))
    wide = 1.2 / np.cos(np.maximum(tilt - np.radians(12.5), 0))
    assert first_echo(FLAT, origin, axis, np.radians(25)) == pytest.approx(wide)
    assert first_echo(FLAT, origin[:1], np.array([[0, 0, 1.0]])) == [np.inf]
