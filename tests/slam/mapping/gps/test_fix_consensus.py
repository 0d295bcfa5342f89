"""Which fixes agree with a map: gross outliers of any size, in any place, and two altitude references."""

import numpy as np
import pytest

from slam.mapping.gps.consensus import exact_agreement, rough_agreement

STD = (1.0, 1.0, 2.0)


def survey(rng, n, in_line=False):
    """(n, 3) cameras of a survey 30 m over the floor, in metres: lanes, or one line."""
    if in_line:
        xy = np.column_stack([10.0 * np.arange(n), np.zeros(n)])
    else:
        xy = np.column_stack([20.0 * (np.arange(n) // 5), 15.0 * (np.arange(n) % 5)])
    return np.column_stack([xy, 30.0 + rng.normal(0, 0.5, n)])


def in_map_units(world_m, metric):
    """The same cameras in a level map of its own: turned, shifted, and in mean heights unless metric."""
    R = np.array([[np.cos(0.8), -np.sin(0.8), 0], [np.sin(0.8), np.cos(0.8), 0], [0, 0, 1]])
    return (world_m - [40, 70, 0]) @ R / (1.0 if metric else 30.0)


def scattered(rng, count, size_m):
    away = rng.normal(size=(count, 3)) * [1, 1, 0.2]
    return size_m * away / np.linalg.norm(away[:, :2], axis=1, keepdims=True)


@pytest.mark.parametrize("metric", [True, False])
@pytest.mark.parametrize("in_line", [True, False])
@pytest.mark.parametrize("n", [6, 12, 75])
@pytest.mark.parametrize("size_m", [400.0, 2e4, 1e6])
def test_outliers_are_found_before_the_map_is_placed(n, in_line, metric, size_m):
    """Up to 30 %, the first fix among them, and no other fix."""
    rng = np.random.default_rng(n + in_line)
    for share in (0.01, 0.3):
        world = survey(rng, n, in_line)
        fixes = world + rng.normal(0, STD, (n, 3))
        bad = np.arange(n) == 0
        bad[1 + rng.choice(n - 1, max(0, int(share * n) - 1), replace=False)] = True
        fixes[bad] += scattered(rng, int(bad.sum()), size_m)
        found = rough_agreement(in_map_units(world, metric), fixes, metric)
        assert np.array_equal(~found.used, bad)
        assert found.altitude_used[~bad].all()


def test_outliers_that_agree_with_each_other_lose_to_the_majority():
    rng = np.random.default_rng(5)
    world = survey(rng, 20)
    fixes = world + rng.normal(0, 0.3, (20, 3))
    fixes[:6] += [443.0, 0, 0]
    found = rough_agreement(in_map_units(world, False), fixes, False)
    assert np.flatnonzero(~found.used).tolist() == [0, 1, 2, 3, 4, 5]


def test_a_bent_map_costs_no_fix():
    """The ends of a long strip bend away by half of its length."""
    x = np.linspace(-1, 1, 60)
    world = 500.0 * np.column_stack([x, 0 * x, 0 * x]) + [0, 0, 30]
    here = world / 30.0
    here[:, 1] += 8.0 * x**2
    found = rough_agreement(here, world + np.random.default_rng(0).normal(0, STD, (60, 3)), False)
    assert found.used.all()


@pytest.mark.parametrize("n", [2, 3])
def test_too_few_fixes_are_not_judged(n):
    world = survey(np.random.default_rng(0), n)
    fixes = world.copy()
    fixes[0] += 500.0
    assert rough_agreement(in_map_units(world, False), fixes, False).used.all()


@pytest.mark.parametrize("first_group", [4, 6, 8])
def test_two_altitude_references_are_distinguished(first_group):
    """The larger group counts, of equal ones the first; the place of all photographs is used."""
    rng = np.random.default_rng(first_group)
    world = survey(rng, 12)
    fixes = world + rng.normal(0, [1, 1, 0.5], (12, 3))
    fixes[first_group:, 2] += 400.0
    found = rough_agreement(in_map_units(world, False), fixes, False)
    assert found.used.all()
    upper = np.arange(12) >= first_group
    assert np.array_equal(found.altitude_used, upper if first_group == 4 else ~upper)
    again = exact_agreement(fixes - world - [0, 0, 400.0 if first_group == 4 else 0.0], STD)
    assert np.array_equal(again.altitude_used, found.altitude_used)


def test_gaussian_noise_costs_hardly_any_fix():
    """In 1 % of the sets one fix is lost; with nominal deviations that are far too small, too."""
    rng = np.random.default_rng(1)
    lost = {n: 0 for n in (6, 12, 75)}
    for n in lost:
        for _ in range(300):
            found = exact_agreement(rng.normal(0, [1, 1, 2], (n, 3)), (0.01, 0.01, 0.02))
            lost[n] += not (found.used.all() and found.altitude_used.all())
    assert max(lost.values()) <= 300 * 0.05, lost


@pytest.mark.parametrize("n", [12, 75])
def test_outliers_of_twenty_metres_are_found_on_the_refined_map(n):
    rng = np.random.default_rng(n)
    for _ in range(30):
        off = rng.normal(0, [1, 1, 2], (n, 3))
        bad = rng.choice(n, int(0.3 * n), replace=False)
        off[bad] += scattered(rng, len(bad), 20.0)
        assert np.array_equal(np.flatnonzero(~exact_agreement(off, STD).used), np.sort(bad))


def test_one_of_six_altitudes_that_is_far_off_is_found_in_most_draws():
    """The others determine a height alone. Less freedom left for their noise would find half of them."""
    rng, found = np.random.default_rng(5), []
    for _ in range(300):
        off = rng.normal(0, 1, (6, 3))
        off[2, 2] += 15.0
        off[:, 2] -= off[np.arange(6) != 2, 2].mean()
        agreement = exact_agreement(off, (0.01, 0.01, 0.02))
        found.append(agreement.used.all() and not agreement.altitude_used[2])
    assert np.mean(found) > 0.62


def test_a_fix_within_the_nominal_deviations_stays():
    """Errors of centimetres with one of decimetres, from a receiver that promises metres."""
    off = np.random.default_rng(2).normal(0, 0.01, (20, 3))
    off[3] = [0.3, 0, 0]
    assert exact_agreement(off, (5.0, 5.0, 10.0)).used.all()
    assert not exact_agreement(off, (0.01, 0.01, 0.02)).used[3]


def test_fixes_outside_the_map_are_not_judged():
    off = np.random.default_rng(3).normal(0, 1, (10, 3))
    off[4] = np.nan
    off[6, 2] = np.nan
    found = exact_agreement(off, STD)
    assert found.used.all()
    assert found.count == 9


def test_fixes_of_different_accuracy_are_judged_by_their_own():
    """Fixes without RTK differ by metres; one with RTK that is off by half a metre is wrong."""
    rng, n = np.random.default_rng(3), 15
    std_m = np.where(np.arange(n)[:, None] < 8, [0.01, 0.01, 0.02], [5.0, 5.0, 10.0])
    off_m = rng.normal(0, std_m)
    off_m[3] += [0.5, 0.0, 0.0]
    found = exact_agreement(off_m, std_m)
    assert np.flatnonzero(~found.used).tolist() == [3]
    assert found.altitude_used[found.used].all()
