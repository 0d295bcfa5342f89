"""The elevation map against brute force, and over a box that a beam passes."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.elevation import NEAREST, elevation_map


def test_each_cell_is_the_median_of_the_nearest_echoes_that_reach_it():
    rng = np.random.default_rng(0)
    place, height, radius = rng.uniform(0, 3, (60, 2)), rng.normal(size=60), rng.uniform(0.2, 0.4, 60)
    made = elevation_map(place, height, radius)
    rows, cols = made.height_m.shape
    assert made.gsd_m == pytest.approx(np.median(radius) / 8)
    checked = 0
    for r in range(0, rows, 7):
        for c in range(0, cols, 7):
            at = np.array([made.west_m + (c + 0.5) * made.gsd_m, made.north_m - (r + 0.5) * made.gsd_m])
            distance = np.linalg.norm(place - at, axis=1)
            nearest = np.argsort(distance)[:NEAREST]
            reached = [k for k in nearest if distance[k] <= radius[k]]
            expected = np.median(height[reached]) if reached else np.nan
            assert made.height_m[r, c] == pytest.approx(expected, nan_ok=True, abs=1e-6)
            assert made.at(at[:1], at[1:])[0] == pytest.approx(made.height_m[r, c], nan_ok=True)
            checked += bool(reached)
    assert checked > 20


def test_a_box_under_the_way_stands_in_the_map_where_it_stands():
    """A pencil of sound that its maker calls 0.3 m wide passes a box of 0.25 m from x = 1 to 1.5."""
    x = np.arange(0, 3, 0.02)
    noise = np.random.default_rng(1).normal(0, 0.01, len(x))
    height = np.where((x > 1) & (x < 1.5), 0.25, 0.0) + noise
    made = elevation_map(np.column_stack([x, 0 * x]), height, np.full(len(x), 0.15))
    inside, before, after = (
        made.at(np.array(at), np.zeros(2)) for at in ([1.05, 1.4], [0.3, 0.9], [1.6, 2.5])
    )
    np.testing.assert_allclose(inside, 0.25, atol=0.02)
    np.testing.assert_allclose(np.append(before, after), 0.0, atol=0.02)
    assert np.isnan(made.at(np.array([1.2, 99.0, np.nan]), np.array([0.3, 0.0, 0.0]))).all()
    spiked = height.copy()
    spiked[50] = -3.0
    same = elevation_map(np.column_stack([x, 0 * x]), spiked, np.full(len(x), 0.15))
    np.testing.assert_allclose(
        same.at(np.array([1.0, 1.2]), np.zeros(2)), made.at(np.array([1.0, 1.2]), np.zeros(2)), atol=0.3
    )


def test_nothing_heard_is_no_map_and_a_great_land_has_bounded_cells():
    nothing = np.full(3, np.nan)
    assert elevation_map(np.zeros((3, 2)), nothing, np.ones(3)) is None
    far = np.array([[0.0, 0.0], [4000.0, 3000.0]])
    assert elevation_map(far, np.zeros(2), np.full(2, 0.2)).height_m.size < 1.2e6
