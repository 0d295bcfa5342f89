"""Heights of neighbouring floor points that go together: how many count as one, and what it does to a map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.refinement import refine
from backend.bundle.relief_correlation import design_effect
from tests.backend.bundle.made_scenes import SONAR, SURVEY, errors_squared
from tests.backend.made_floor import Scene, make

RELIEF = 0.02


@pytest.mark.parametrize("wild", [0, 6])
def test_independent_heights_count_each(wild: int):
    """A few may be wrong."""
    rng, found = np.random.default_rng(0), []
    for _ in range(200):
        variance = rng.uniform(0.1, 2.0, 300) * RELIEF**2
        z = rng.normal(0, np.sqrt(RELIEF**2 + variance))
        z[:wild] = 50 * RELIEF
        found.append(design_effect(rng.uniform(0, 3, (300, 2)), z, variance, RELIEF))
    assert np.count_nonzero(np.array(found) > 1) <= 3


@pytest.mark.parametrize("precision", [0.1, 1.0])
@pytest.mark.parametrize("together", [5, 20])
def test_points_of_one_height_count_as_one(together: int, precision: float):
    """Terraces of one height each, and pictures that tell heights better than the relief, or as well."""
    rng, found = np.random.default_rng(1), []
    for _ in range(20):
        terraces, std = 12, precision * RELIEF
        xy = rng.uniform(0, terraces, (together * terraces**2, 2))
        height = rng.normal(0, RELIEF, (terraces, terraces))[tuple(xy.astype(int).T)]
        z = height + rng.normal(0, std, len(xy))
        found.append(design_effect(xy, z, np.full(len(xy), std**2), RELIEF))
    # Their numbers of points are Poisson's. The largest of several estimates is a little too large.
    assert 0.95 < np.mean(found) / (1 + together) < 1.35


def test_waves_count_as_their_length_tells():
    """Four times as many points to a wave are twice as long waves, or twice as dense points."""
    rng = np.random.default_rng(2)
    xy = rng.uniform(0, 10, (6000, 2))
    effect = {}
    for length in (1.0, 2.0):
        z = 2 * RELIEF * np.sin(2 * np.pi * xy / length).prod(axis=1)
        effect[length] = design_effect(xy, z, np.full(len(xy), 1e-8), RELIEF)
    half = design_effect(xy[:1500], z[:1500], np.full(1500, 1e-8), RELIEF)
    assert effect[2.0] / effect[1.0] == pytest.approx(4, rel=0.15)
    assert effect[2.0] / half == pytest.approx(4, rel=0.15)


def test_a_point_far_off_does_not_hide_the_waves():
    rng = np.random.default_rng(3)
    xy = rng.uniform(0, 5, (1000, 2))
    z = 2 * RELIEF * np.sin(2 * np.pi * xy).prod(axis=1)
    variance = np.full(1000, 1e-8)
    alone = design_effect(xy, z, variance, RELIEF)
    xy[0] = 1e4
    assert design_effect(xy, z, variance, RELIEF) == pytest.approx(alone, rel=0.1)


@pytest.mark.parametrize("count", [0, 1, 50])
@pytest.mark.parametrize("spacing", [0.0, 0.1])
def test_points_on_a_line_or_in_one_place_or_none_count_each(count: int, spacing: float):
    xy = np.column_stack([spacing * np.arange(count), np.zeros(count)])
    assert design_effect(xy, np.ones(count), np.zeros(count), RELIEF) == 1.0


@pytest.mark.parametrize("seed", [2, 3])
def test_waves_are_no_noise_of_the_attitude(seed: int):
    """Ground that counts as flat at first tilts the map, which the attitude then seems to contradict."""
    made = make(replace(SONAR, rolling=0.04, wavelengths=(2.5, 4.0), points_in_view=100), seed)
    found = refine(made.measurements, made.start, made.floor_z_m)
    assert found.noise.roll_pitch_rad == pytest.approx(SONAR.attitude_std_rad, rel=0.3)
    assert errors_squared(made, found).mean() < 8


def test_crests_of_waves_are_no_structure():
    """One or two waves have heights of any distribution. As structure they gave squared errors of 193."""
    made = make(replace(SONAR, rolling=0.04, wavelengths=(2.0, 3.0), points_in_view=150, keyframes=24), 5)
    found = refine(made.measurements, made.start, made.floor_z_m)
    assert not found.optimum.problem.raised.any()
    assert errors_squared(made, found).mean() < 15


@pytest.mark.parametrize(
    "scene", [SONAR, replace(SURVEY, relief=0.0, keyframes=24)], ids=["sonar and attitude", "gps"]
)
def test_rolling_ground_has_honest_covariances(scene: Scene):
    """With each height counted by itself the mean is 365 with sonar and attitude, and 10 with GPS."""
    rolling = replace(scene, rolling=0.04, wavelengths=(2.0, 3.0), points_in_view=100)
    made = [make(rolling, seed) for seed in range(3)]
    found = [refine(each.measurements, each.start, each.floor_z_m) for each in made]
    drawn = [errors_squared(m, bundle).mean() for m, bundle in zip(made, found, strict=True)]
    assert 3.0 < np.mean(drawn) < 8.0
