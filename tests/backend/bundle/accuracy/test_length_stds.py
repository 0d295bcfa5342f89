"""Standard deviations of distances: errors of made scenes, and what both places share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from backend.bundle.accuracy.length_stds import length_stds, shown_places
from backend.bundle.refinement import refine
from slam.core.estimate import over_floor
from tests.backend.bundle.optimum_at_truth import at_the_truth, peak_bytes
from tests.backend.made_floor import Scene, make

SCENE = Scene(keyframes=8, points_in_view=20, range_gain_std=0.05)


def refined(scene: Scene, seed: int = 0):
    made = make(scene, seed)
    return made, refine(made.measurements, made.start)


def shown_without_error(made, bundle, places):
    """Where the true cameras show, on the true floor, what the estimated ones show at ``places``."""
    hat = over_floor(bundle.w_T_b, bundle.floor_slope_rad, bundle.floor_z_m) @ bundle.b_T_c
    true = over_floor(made.w_T_b, made.slope_rad, made.floor_z_m) @ made.measurements.camera.b_T_c
    found, shown = [], []
    for k, xy in zip(places.keyframe, places.place_m, strict=True):
        # The places have their origin on the floor, as the poses.
        ray = hat[k, :3, :3].T @ (np.array([*xy, bundle.floor_z_m]) - hat[k, :3, 3])
        turned = true[k, :3, :3] @ ray
        place = true[k, :3, 3] + turned * (made.floor_z_m - true[k, 2, 3]) / turned[2]
        found.append(xy)
        shown.append(place[:2])
    return np.array(found), np.array(shown)


@pytest.mark.slow
def test_distances_are_as_wrong_as_their_standard_deviations_say():
    """One pair a scene, so that all errors are independent."""
    squares, seeds = [], range(40)
    for seed in seeds:
        made, bundle = refined(
            replace(SCENE, range_gain=1 + 0.05 * np.random.default_rng(seed).normal()), seed
        )
        places = shown_places(bundle.optimum)
        found, true = shown_without_error(made, bundle, places)
        length_m, std_m = places.lengths()
        i, j = np.triu_indices(len(found), 1)
        true_m = np.linalg.norm(true[j] - true[i], axis=1)
        pick = seed % len(length_m)
        squares.append(((length_m - true_m) / std_m)[pick] ** 2)
    low, high = chi2.ppf([0.001, 0.999], len(seeds))
    assert low < sum(squares) < high


def test_the_scale_is_counted_once():
    """Where it is vague, a distance is as uncertain as its share of the scale, however far the origin is."""
    _, bundle = refined(replace(SCENE, range_gain_std=0.2))
    assert bundle.scale_std > 0.05
    length_m, std_m = shown_places(bundle.optimum).lengths()
    np.testing.assert_allclose(std_m, bundle.scale_std * length_m, rtol=0.1, atol=0.004)


def test_what_moves_the_whole_map_moves_no_distance():
    _, bundle = refined(replace(SCENE, position_std_m=(3.0, 3.0), range_gain_std=0.0))
    for _, typical_m, worst_m in length_stds(bundle.optimum):
        assert typical_m <= worst_m < 0.1 * bundle.middle_std_m


def test_distances_grow_along_the_table():
    _, bundle = refined(SCENE)
    table = np.array(length_stds(bundle.optimum))
    assert (np.diff(table[:, 0]) > 0).all()
    assert (np.diff(table[:, 1]) > 0).all(), "the scale makes long distances less certain"


def test_no_floor_point_takes_memory_for_each_place():
    optimum = at_the_truth(70)
    linear = optimum.linearise()
    system = peak_bytes(lambda: linear.eliminate())
    of_points = optimum.at.point.size * 2 * 64 * 8
    assert peak_bytes(lambda: shown_places(optimum)) < system + 3 * of_points
