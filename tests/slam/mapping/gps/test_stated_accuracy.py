"""A receiver that states far less than its fixes differ from the map: which of the two is doubted."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.mapping.gps.comparison import FixComparison
from slam.mapping.gps.fixes import Fixes
from slam.mapping.gps.stated_accuracy import (
    FixesOnMap,
    altitude_contradiction,
    mirror_contradiction,
    pattern,
    stated_accuracy_contradiction,
)

STATED = (0.01, 0.01, 0.02)


def stated_accuracy_warning(made, stated):
    found = stated_accuracy_contradiction(made, stated)
    return str(found.warning) if found else ""


def survey(rng, n=40):
    """Lanes flown there and back; the vehicle looks along its way."""
    lane, along = np.arange(n) // 8, np.arange(n) % 8
    back = lane % 2 == 1
    x = 12.0 * np.where(back, 7 - along, along)
    heading = np.where(back, np.pi, 0.0) + rng.normal(0, 0.1, n)
    w_R_b = Rotation.from_euler("z", heading[:, None]).as_matrix()
    velocity = np.column_stack([np.where(back, -4.0, 4.0), np.zeros(n)]) * rng.uniform(0.5, 1.5, (n, 1))
    return np.column_stack([x, 15.0 * lane]), w_R_b, velocity


def fixes(kind, n=40, seed=0, std_m=0.01):
    rng = np.random.default_rng(seed)
    place, w_R_b, velocity = survey(rng, n)
    centred = (place - place.mean(axis=0)) / 45.0
    off = {
        "body": w_R_b[:, :2, :2] @ [0.4, -0.2],
        "place": 0.5 * centred * np.sum(centred**2, axis=1, keepdims=True) + 0.4 * centred[:, :1] ** 2,
        "delay": -0.15 * velocity + [0.3, -0.1] + 0.2 * centred,
        "step": -0.15 * velocity * (np.arange(n) >= 0.6 * n)[:, None] + [0.3, -0.1],
        "scale": 45.0 * 0.2 * centred + [0.3, -0.1],
        "": rng.normal(0, 0.5, (n, 2)),
        "good": np.zeros((n, 2)),
    }[kind] + rng.normal(0, std_m, (n, 2))
    return FixesOnMap(off, place, w_R_b, velocity, tuple(f"fix {k}" for k in range(n)))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("kind", "doubted"),
    [
        ("body", "the camera model is doubted"),
        ("place", "the map's shape is doubted"),
        ("delay", "the clocks are doubted"),
        ("step", "from fix 24 on"),
        ("scale", "lengths by the GPS are 1.2 times those of the map"),
        ("", "the stated accuracy is doubted"),
    ],
)
def test_the_pattern_of_the_differences_says_what_is_doubted(kind, doubted, seed):
    made = fixes(kind, seed=seed)
    assert pattern(made).kind == kind
    line = stated_accuracy_warning(made, STATED)
    assert doubted in line
    assert "states 0.01 m" in line
    assert "\n" not in line


def mirrored(rng, std_m, n=40, size=1.0):
    """The map as a similarity fits it to mirrored fixes with noise."""
    place, w_R_b, velocity = survey(rng, n)
    read = size * place * [1.0, -1.0] + rng.normal(0, std_m, (n, 2))
    made, seen = read @ (1, 1j), place @ (1, 1j)
    J = np.column_stack([np.ones(n), seen])
    fitted = J @ np.linalg.lstsq(J, made, rcond=None)[0]
    here = np.column_stack([fitted.real, fitted.imag])
    return FixesOnMap(read - here, here, w_R_b, velocity, tuple(f"fix {k}" for k in range(n)))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size", [0.2, 1.0, 10.0])
def test_a_mirror_image_is_told_whatever_accuracy_is_stated(seed, size):
    found = mirror_contradiction(mirrored(np.random.default_rng(seed), 2.0, size=size))
    assert found is not None
    assert "they are a mirror image of the map" in found.warning.text


@pytest.mark.parametrize("n", [3, 4, 12, 40])
def test_fixes_that_are_as_the_map_are_no_mirror_image(n):
    for kind in ("good", "", "body", "place", "delay", "step", "scale"):
        assert not any(mirror_contradiction(fixes(kind, n, seed)) for seed in range(30))
    for seed in range(200):  # a line is as its mirror image, and noise hides a shape
        rng = np.random.default_rng(seed)
        made = fixes("good", n, seed)
        line = replace(made, w_p_m=made.w_p_m * [1.0, 0.0], off_m=rng.normal(0, 1.0, (n, 2)))
        assert mirror_contradiction(line) is None
        vague = replace(made, off_m=rng.normal(0, 300.0, (n, 2)))
        assert mirror_contradiction(vague) is None


def test_the_pattern_is_told_in_figures():
    assert "+0.4 m forward, -0.2 m left" in stated_accuracy_warning(fixes("body"), STATED)
    assert "+0.15 s" in stated_accuracy_warning(fixes("delay"), STATED)
    assert "(+0.15 s;" in stated_accuracy_warning(fixes("step"), STATED)


@pytest.mark.parametrize("n", [3, 4, 12, 40])
def test_a_receiver_that_keeps_its_word_is_not_contradicted(n):
    for seed in range(50):
        assert stated_accuracy_warning(fixes("good", n, seed), STATED) == ""
    assert stated_accuracy_warning(fixes("good", n, std_m=0.02), STATED) == ""


def test_fixes_without_attitude_or_motion_are_no_trouble():
    made = fixes("", n=6)
    standing = FixesOnMap(
        made.off_m, np.zeros((6, 2)), np.tile(np.eye(3), (6, 1, 1)), np.zeros((6, 2)), made.names
    )
    assert "doubted" in stated_accuracy_warning(standing, STATED)


def test_a_pattern_that_leaves_most_of_the_differences_is_none():
    """Fixes that drift: a step of the clock somewhere would explain half of the squares."""
    made = fixes("good")
    drift = replace(made, off_m=np.column_stack([np.linspace(-0.5, 0.5, 40), np.zeros(40)]) + made.off_m)
    assert pattern(drift).kind in ("", "place")
    half = replace(made, off_m=made.off_m + 0.3 * np.random.default_rng(0).normal(size=(40, 2)) + 0.1)
    assert pattern(half).kind == ""


def test_an_assumed_accuracy_is_told_as_one():
    found = stated_accuracy_contradiction(fixes(""), STATED, stated=False)
    assert found is not None
    assert "gps0: 0.01 m assumed, but its fixes differ" in found.warning.text
    assert "the assumed accuracy is doubted" in found.warning.text


def test_altitudes_that_climb_while_the_map_does_not_are_told():
    ramp = 10.0 * np.linspace(-5.5, 5.5, 12)
    found = altitude_contradiction(ramp, 10.0, stated=False)
    assert found is not None
    assert "10 m assumed for altitudes, but they differ from the map by 40 m (4 sigmas)" in found.warning.text
    assert altitude_contradiction(0.5 * ramp, 10.0) is None
    assert altitude_contradiction(ramp[:3], 0.1) is None


@pytest.mark.parametrize("climb_m", [10.0, 0.0])
def test_a_map_compares_altitudes_as_well_as_positions(climb_m):
    place, w_R_b, _ = survey(np.random.default_rng(0), 12)
    stamps_s = np.arange(12.0)
    w_T_b = np.tile(np.eye(4), (12, 1, 1))
    w_T_b[:, :3, :3], w_T_b[:, :2, 3] = w_R_b, place
    w_p_antenna_m = w_T_b[:, :3, 3] + np.outer(climb_m * np.linspace(-5.5, 5.5, 12), [0, 0, 1])
    fixes = Fixes(stamps_s, w_p_antenna_m, (1.0, 1.0, 10.0), False, ("fix",) * 12, np.zeros(12, bool))
    comparison = FixComparison(fixes, stamps_s)
    found = comparison.contradictions(comparison.exact(w_T_b), w_T_b)
    assert [("altitudes" in each.warning.text) for each in found] == [True] * (climb_m > 0)
