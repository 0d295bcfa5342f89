"""Standard deviations of floor points: the dense covariance, and how they grow with the distance."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np

from backend.bundle.accuracy.refined_points import metric_point_stds, metric_points
from backend.bundle.factors import WORLD
from backend.bundle.refinement import refine
from tests.backend.bundle.optimum_at_truth import at_the_truth, peak_bytes
from tests.backend.made_floor import Scene, make

SCENE = Scene(keyframes=5, points_in_view=12, range_gain_std=0.05)


def refined(scene: Scene):
    made = make(scene, 0)
    return refine(made.measurements, made.start)


def moved(optimum, world, point):
    values = gtsam.Values(optimum.values)
    values.update(WORLD, world)
    return replace(optimum, at=replace(optimum.at, values=values, point=point))


def test_they_are_those_of_the_dense_covariance():
    """With positions the world is fixed, so that the places themselves can be differentiated."""
    optimum = refined(replace(SCENE, position_std_m=(0.5, 0.5))).optimum
    linear = optimum.linearise()
    A = linear.jacobian()[0].toarray()
    world, point = optimum.values.atVector(WORLD), optimum.at.point
    begin, size = linear.structure.columns(WORLD).start, linear.eliminate().size
    J = np.zeros((*point.shape, A.shape[1]))
    rows, step = np.arange(len(point)), 1e-6

    def slope(by_world, by_point):
        ends = [
            metric_points(moved(optimum, world + s * by_world, point + s * by_point)) for s in (step, -step)
        ]
        return (ends[0] - ends[1]) / (2 * step)

    for k, unit in enumerate(np.eye(len(world))):
        J[:, :, begin + k] = slope(unit, np.zeros(3))
    for k, unit in enumerate(np.eye(3)):
        J[rows, :, size + 3 * rows + k] = slope(np.zeros(len(world)), unit)
    P = np.linalg.inv(A.T @ A)
    dense = np.sqrt(np.einsum("tac,cd,tad->ta", J, P, J))
    found = metric_point_stds(optimum, seed=1, draws=1000)
    ratio = found / dense
    assert np.abs(ratio - 1).max() < 0.12, "a deviation of 1000 draws is known to 2.2 %"
    assert abs(np.median(ratio) - 1) < 0.02


def test_they_grow_with_the_distance_from_the_first_keyframe_where_the_scale_is_vague():
    bundle = refined(replace(SCENE, range_gain_std=0.2))
    away_m = np.linalg.norm((metric_points(bundle.optimum) - bundle.w_T_b[0, :3, 3])[:, :2], axis=1)
    std_m = metric_point_stds(bundle.optimum)
    along_m = np.linalg.norm(std_m[:, :2], axis=1)
    assert np.corrcoef(away_m, along_m)[0, 1] > 0.9
    assert (metric_point_stds(bundle.optimum) == std_m).all(), "the seed draws them"


def test_memory_of_the_draws_is_bounded(monkeypatch):
    optimum = at_the_truth(40)
    at_once = metric_point_stds(optimum)
    peak = peak_bytes(lambda: metric_point_stds(optimum))
    rows = len(optimum.linearise().jacobian()[1])
    monkeypatch.setattr("backend.bundle.reduced_system.MOST_NUMBERS", 2 * rows)
    assert peak_bytes(lambda: metric_point_stds(optimum)) < 0.7 * peak
    assert np.abs(np.log(metric_point_stds(optimum) / at_once)).max() < 0.3, "deviations of 200 other draws"
