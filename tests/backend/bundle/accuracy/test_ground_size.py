"""Uncertainty of the size and the place of the ground: the dense covariance, and what an untold lens does."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from backend.bundle.accuracy.ground_size import ground_size
from backend.bundle.accuracy.refined_points import metric_points
from backend.bundle.factors import LOG_SCALE, WORLD
from backend.bundle.refinement import refine
from tests.backend.bundle.made_scenes import AT_ONE_HEIGHT
from tests.backend.made_floor import CAMERA, Scene, make

LEVEL = replace(AT_ONE_HEIGHT, keyframes=8, points_in_view=15)


def refined(scene: Scene):
    made = make(scene, 0)
    return refine(made.measurements, made.start, made.floor_z_m)


def test_they_are_those_of_the_dense_covariance():
    """With positions the world is fixed, so that size and middle themselves can be differentiated."""
    optimum = refined(Scene(keyframes=5, points_in_view=12, position_std_m=(0.5, 0.5))).optimum
    linear = optimum.linearise()
    reduced, A = linear.eliminate(), linear.jacobian()[0].toarray()
    world, point = optimum.values.atVector(WORLD), optimum.at.point
    views = np.bincount(optimum.cost.observations.track, minlength=len(point))
    begin, size, step = reduced.structure.columns(WORLD).start, reduced.size, 1e-6

    def quantities(at_world, at_point):
        values = gtsam.Values(optimum.values)
        values.update(WORLD, at_world)
        moved = replace(optimum, at=replace(optimum.at, values=values, point=at_point))
        xy = metric_points(moved)[:, :2]
        middle = np.average(xy, axis=0, weights=views)
        spread = np.average(np.sum((xy - middle) ** 2, axis=1), weights=views)
        return np.array([0.5 * np.log(spread), *middle])

    def slope(by_world, by_point):
        ends = [quantities(world + s * by_world, point + s * by_point) for s in (step, -step)]
        return (ends[0] - ends[1]) / (2 * step)

    J = np.zeros((3, A.shape[1]))
    for k, unit in enumerate(np.eye(len(world))):
        J[:, begin + k] = slope(unit, np.zeros_like(point))
    for t in range(len(point)):
        for k, unit in enumerate(np.eye(3)):
            by_point = np.zeros_like(point)
            by_point[t] = unit
            J[:, size + 3 * t + k] = slope(np.zeros(len(world)), by_point)
    variance = np.diag(J @ np.linalg.inv(A.T @ A) @ J.T)
    found = ground_size(optimum, reduced)
    assert found.log_std == pytest.approx(np.sqrt(variance[0]), rel=1e-4)
    assert found.middle_std_m == pytest.approx(np.sqrt(variance[1] + variance[2]), rel=1e-4)


def test_positions_tell_lengths_whatever_the_focal_length_is():
    """The camera's height over the floor is as uncertain as the focal length, and lengths are not."""
    bundle = refined(LEVEL)
    reduced = bundle.optimum.linearise().eliminate()
    world = reduced.structure.columns(WORLD).start + LOG_SCALE
    unit = np.zeros(reduced.size)
    unit[world] = 1.0
    height_std = np.sqrt(reduced.factor.solve(unit)[world])
    assert height_std > 0.01
    assert bundle.scale_std < 0.3 * height_std


def test_the_middle_is_known_as_the_mean_of_the_positions_where_nothing_leans():
    upright = refined(replace(LEVEL, height_m=2.0, attitude_std_rad=1e-4))
    of_positions_m = np.sqrt(2) * upright.noise.position_m[0] / np.sqrt(8)
    assert upright.middle_std_m == pytest.approx(of_positions_m, rel=0.3)
    assert refined(LEVEL).middle_std_m > 3 * of_positions_m, "50 m below, a lean moves the ground"


def test_a_height_sensor_tells_lengths_no_better_than_the_focal_length_is_known():
    """A length on the ground is the height times an angle."""
    flown = replace(LEVEL, height_m=1.0, position_std_m=None, range_std_m=0.001, attitude_std_rad=0.01)
    assert refined(flown).scale_std == pytest.approx(0.02, rel=0.3)
    held = replace(flown, camera=CAMERA)
    assert refined(held).scale_std < 0.002
