"""Messages about fixes: each by its name, with its distance, and whether the result may be wrong."""

import re
from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.position_steps import PositionStep
from slam.core.units import SPACE
from slam.mapping.gps.consensus import Agreement
from slam.mapping.gps.fixes import Fixes
from slam.mapping.gps.messages import fix_messages
from slam.mapping.gps.steps import step_warning


def fixes(n):
    names = tuple(f"P{k:02}.jpg" for k in range(n))
    return Fixes(2.0 * np.arange(n), np.zeros((n, 3)), (1.0, 1.0, 2.0), True, names, np.zeros(n, bool))


def agreement(off_m, bad=(), bad_altitude=()):
    n = len(off_m)
    used = ~np.isin(np.arange(n), bad)
    return Agreement(used, used & ~np.isin(np.arange(n), bad_altitude), off_m)


def plain(line):
    return line.replace(SPACE, " ")


def noise(n):
    return np.random.default_rng(0).normal(0, 0.5, (n, 3))


def test_fixes_that_agree_need_no_messages():
    assert fix_messages(fixes(12), agreement(noise(12))).remarks == ()
    assert fix_messages(fixes(12), agreement(noise(12))).warnings == ()


def test_few_outliers_are_named_and_do_no_harm():
    off = noise(12)
    off[3], off[7] = [443.0, 0, 0], [0, 2e4, 0]
    messages = fix_messages(fixes(12), agreement(off, bad=[3, 7]))
    assert messages.warnings == ()
    (line,) = map(str, messages.remarks)
    assert "2 of 12 fixes" in line
    assert "P03.jpg (443 m), P07.jpg (20.0 km)" in plain(line)
    assert messages.left_out == ("P03.jpg", "P07.jpg")


def test_more_than_thirty_percent_may_be_the_right_ones():
    off = noise(12)
    off[:5, 0] += 100.0
    (line,) = map(str, fix_messages(fixes(12), agreement(off, bad=range(5))).warnings)
    assert "so many may be right" in line


@pytest.mark.parametrize("seed", range(20))
def test_a_step_in_the_altitudes_is_told_with_its_size(seed):
    off = np.random.default_rng(seed).normal(0, 0.1, (12, 3))
    off[6:, 2] = 400.0 + 10 * off[6:, 2]  # the map leans where it has no altitude
    messages = fix_messages(fixes(12), agreement(off, bad_altitude=range(6, 12)))
    (line,) = map(str, messages.warnings)
    assert re.search("6 fixes from P06.jpg to P11.jpg lie (399|400|401) m above", plain(line))
    assert "two altitude references" in line
    assert messages.remarks == ()


def test_single_altitudes_are_named():
    off = noise(12)
    off[2, 2], off[9, 2] = -80.0, 300.0
    (line,) = map(str, fix_messages(fixes(12), agreement(off, bad_altitude=[2, 9])).remarks)
    assert "2 of 12 altitudes" in line
    assert "P02.jpg (-80.0 m), P09.jpg (300 m)" in plain(line)


@pytest.mark.parametrize(("off_m", "told"), [(200.0, True), (0.5, False)])
def test_three_fixes_that_contradict_the_pictures_are_told_without_a_culprit(off_m, told):
    off = np.zeros((3, 3))
    off[:, 0] = [off_m, -off_m, 0.0]
    warnings = tuple(map(str, fix_messages(fixes(3), agreement(off)).warnings))
    assert len(warnings) == told
    if told:
        assert "P00.jpg, P01.jpg, P02.jpg" in warnings[0]
        assert "it takes 4 to tell which is wrong" in warnings[0]


@pytest.mark.parametrize("n", [4, 6])
def test_few_fixes_that_contradict_the_pictures_are_told_without_a_culprit(n):
    """Half of them may be moved: any two fit the map exactly."""
    off = np.zeros((n, 3))
    off[:, 0] = 8.0 * (-1.0) ** np.arange(n)
    (line,) = map(str, fix_messages(fixes(n), agreement(off)).warnings)
    assert "it takes 7 to tell which half is wrong (P00.jpg, P01.jpg" in line
    assert fix_messages(fixes(n), agreement(noise(n))).warnings == ()


@pytest.mark.parametrize(("noise_m", "told"), [(8.0, True), (0.5, False)])
def test_fixes_out_of_reach_of_the_others_are_told_where_the_noise_hides_them(noise_m, told):
    off = np.random.default_rng(1).normal(0, noise_m, (12, 3))
    doubted = replace(fixes(12), suspect=np.arange(12) > 9)
    warnings = tuple(map(str, fix_messages(doubted, agreement(off)).warnings))
    assert len(warnings) == told
    if told:
        assert "uses 2 fixes out of reach of the others (P10.jpg, P11.jpg)" in warnings[0]
    assert fix_messages(fixes(12), agreement(off)).warnings == ()


def test_a_jump_is_told_with_the_fixes_on_both_sides():
    off = noise(12)
    off[6:, 1] += 40.0
    (line,) = map(str, fix_messages(replace(fixes(12), stated=False), agreement(off)).warnings)
    assert re.search("jump against the pictures by (39|40|41).* m from P05.jpg to P06.jpg", plain(line))


def test_a_step_of_the_fixes_is_told_with_its_photograph_and_size():
    step = PositionStep(3, np.array([0.3, -0.4, 0.0]), np.array([0.05, 0.05, 0.1]))
    line = step_warning(step, fixes(6), 2.0 * np.arange(6))
    assert f"from about {fixes(6).names[3]} on, the fixes lie 0.50{SPACE}m aside" in line.text
    assert "correct the fixes of one side" in line.text
