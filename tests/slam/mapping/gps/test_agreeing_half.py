"""Half of the fixes agree with the pictures, and the other half agree with each other or with nothing."""

import numpy as np
import pytest

from slam.mapping.gps.agreeing_half import agreeing_half
from slam.mapping.gps.consensus import rough_agreement
from tests.slam.mapping.gps.test_fix_consensus import STD, in_map_units, scattered, survey


def as_complex(points):
    return points[:, 0] + 1j * points[:, 1]


@pytest.mark.parametrize("metric", [True, False])
@pytest.mark.parametrize("in_line", [True, False])
@pytest.mark.parametrize("n", [8, 13, 40])
@pytest.mark.parametrize("kind", ["last", "alternate", "scattered"])
def test_half_of_the_fixes_make_no_wrong_scale(n, in_line, metric, kind):
    """The larger half is used; of equal halves that are moved alike, either has the right scale."""
    rng = np.random.default_rng(n + in_line)
    for along in ([60.0, 0, 0], [-60.0, 0, 0], [0, 60.0, 0]):
        world = survey(rng, n, in_line)
        bad = np.arange(n) >= (n + 1) // 2
        if kind == "alternate":
            bad = np.arange(n) % 2 == 1
        fixes = world + rng.normal(0, STD, (n, 3))
        fixes[bad] += scattered(rng, int(bad.sum()), 100.0) if kind == "scattered" else along
        found = rough_agreement(in_map_units(world, metric), fixes, metric, STD)
        either = [bad] if n % 2 or kind == "scattered" else [bad, ~bad]
        assert any(np.array_equal(~found.used, each) for each in either)


@pytest.mark.parametrize("n", [7, 8, 9, 12, 40])
def test_gaussian_noise_is_no_half(n):
    rng = np.random.default_rng(n)
    for _ in range(100):
        world = survey(rng, n, in_line=True)
        here = as_complex(in_map_units(world, False))
        assert (
            agreeing_half(here, as_complex(world + rng.normal(0, STD, (n, 3))), False, 0.0, 0.0, rng) is None
        )


def test_a_bent_map_has_no_half():
    """The half in the middle of a parabola fits a line well, and the next fix hardly less well."""
    x = np.linspace(-1, 1, 60)
    world = 500.0 * x + 0j
    noise = np.random.default_rng(0).normal(0, 0.01, (2, 60))
    here = world / 30.0 + 8j * x**2
    assert (
        agreeing_half(here, world + noise[0] + 1j * noise[1], False, 0.0, 0.0, np.random.default_rng(1))
        is None
    )


def test_a_step_within_the_nominal_deviations_is_no_half():
    """A receiver of 5 m jumps by 3 m in mid-flight, and errs by centimetres before and after."""
    world = survey(np.random.default_rng(0), 20)
    fixes = world + np.random.default_rng(1).normal(0, 0.02, (20, 3))
    fixes[10:] += [3.0, 0, 0]
    low = world * [1.0, 1.0, 0.1]
    assert rough_agreement(in_map_units(low, True), fixes, True, (5.0, 5.0, 10.0)).used.all()
    assert not rough_agreement(in_map_units(low, True), fixes, True, (0.02, 0.02, 0.04)).used.all()


def test_a_camera_that_leans_makes_no_halves_of_lanes_there_and_back():
    """Its error is constant in the axes of the vehicle, which turns between the lanes."""
    rng = np.random.default_rng(0)
    world = survey(rng, 20)
    fixes = world + rng.normal(0, 0.02, (20, 3))
    fixes[:, 0] += np.where(np.arange(20) < 10, 0.7, -0.7)
    assert rough_agreement(in_map_units(world, False), fixes, False, (0.02, 0.02, 0.04)).used.all()


def test_places_without_motion_are_no_trouble():
    standing = np.zeros(9, complex)
    assert agreeing_half(standing, standing, False, 1.0, 0.0, np.random.default_rng(0)) is None
    assert agreeing_half(standing, np.arange(9) + 0j, True, 1.0, 0.0, np.random.default_rng(0)) is None
