"""Fixes that a refined map does not use are compared with what it knows of their places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.evaluation.trajectory import umeyama
from slam.mapping.calibration.antenna import NOMINAL_ANTENNA_STD_M
from slam.mapping.gps.comparison import FixComparison
from slam.mapping.gps.fixes import Fixes

COUNT = 14
LAST = np.arange(COUNT) == COUNT - 1
POSE_STD_M = 0.05
STAMPS_S = np.arange(float(COUNT))
COVARIANCES = np.tile(np.eye(3) * POSE_STD_M**2, (COUNT, 1, 1))


def line_and_back() -> np.ndarray:
    """Poses (14, 4, 4) along a line, and the last one on the way back."""
    w_T_b = np.tile(np.eye(4), (COUNT, 1, 1))
    w_T_b[:, 0, 3] = 3.0 * STAMPS_S
    w_T_b[-1, :3, :3] = Rotation.from_euler("z", np.pi).as_matrix()
    return w_T_b


def compared(off_m: np.ndarray, antenna_m: np.ndarray, assumed: bool = False) -> FixComparison:
    """Fixes (14,) that lie ``off_m`` (14, 3) beside an antenna at its told or ``assumed`` place."""
    w_T_b, std_m = line_and_back(), (0.01, 0.01, 0.02)
    w_p_antenna_m = w_T_b[:, :3, 3] + w_T_b[:, :3, :3] @ antenna_m + off_m
    names, none = tuple(f"fix {k}" for k in range(COUNT)), np.zeros(COUNT, bool)
    fixes = Fixes(STAMPS_S, w_p_antenna_m, std_m, True, names, none, antenna_m, antenna_assumed=assumed)
    return FixComparison(fixes, STAMPS_S)


@pytest.mark.parametrize(
    ("off_m", "antenna_m", "assumed", "used"),
    [(0.7, 0.0, True, True), (0.7, 0.1, False, False), (0.7, 0.0, False, False), (3.0, 0.0, True, False)],
)
def test_an_antenna_that_nobody_told_may_be_the_cause_at_another_heading(
    off_m: float, antenna_m: float, assumed: bool, used: bool
) -> None:
    """An antenna 0.35 m ahead of the body's origin lies 0.7 m aside on the way back, and nowhere else."""
    noise = np.random.default_rng(0).normal(0, 0.005, (COUNT, 3))
    fixes = compared(noise + LAST[:, None] * [off_m, 0, 0], np.array([antenna_m, 0, 0]), assumed)
    w_T_b = line_and_back()
    assert not fixes.exact(w_T_b).used[-1], "taken for a fix that the map uses"
    found = fixes.exact(w_T_b, fixes.map_std_m(w_T_b, COVARIANCES, LAST))
    assert found.used[:-1].all()
    assert found.used[-1] == used


def test_the_deviation_is_the_scatter_of_drawn_maps_and_antennas() -> None:
    rng, w_T_b = np.random.default_rng(1), line_and_back()
    w_T_b[:, :3, :3] = Rotation.from_euler("zyx", rng.normal(0, 1, (COUNT, 3))).as_matrix()
    fixes = compared(np.zeros((COUNT, 3)), np.zeros(3), assumed=True)
    antenna = w_T_b[:, :3, :3] @ rng.normal(0, NOMINAL_ANTENNA_STD_M, (20_000, 1, 3, 1))
    moved = antenna[:, -1, :, 0] - antenna[:, :-1, :, 0].mean(axis=1)
    moved += rng.normal(0, POSE_STD_M, moved.shape)
    found = fixes.map_std_m(w_T_b, COVARIANCES, LAST)
    assert found[-1] == pytest.approx(moved.std(axis=0), rel=0.03)
    assert not found[:-1].any()
    told = FixComparison(replace(fixes.fixes, antenna_assumed=False), STAMPS_S)
    assert told.map_std_m(w_T_b, COVARIANCES, LAST)[-1] == pytest.approx(POSE_STD_M)
    assert not fixes.map_std_m(w_T_b, COVARIANCES, ~LAST & LAST).any()


@pytest.mark.parametrize(("off_m", "known"), [(0.0, True), (0.0, False), (0.7, False)])
def test_a_fix_is_not_called_back_by_a_pose_of_unknown_accuracy(off_m: float, known: bool) -> None:
    fixes = compared(LAST[:, None] * [off_m, 0, 0], np.zeros(3), assumed=True)
    covariances = np.where(LAST[:, None, None] & (not known), np.nan, COVARIANCES)
    std_m = fixes.map_std_m(line_and_back(), covariances, LAST)
    assert np.isfinite(std_m[-1]).all() == known
    assert fixes.exact(line_and_back(), std_m).used[-1] == known


@pytest.mark.parametrize("turned", [[[0, 0.99, 0], [1.41, 0, 0], [0, 0, 1]], np.diag([1, -1, 1]), np.eye(3)])
def test_mirrored_fixes_are_told_where_the_map_agrees_with_one_lane_of_them(turned: np.ndarray) -> None:
    """Latitude and longitude exchanged at 45 degrees north stretch the map, too."""
    w_T_b = np.tile(np.eye(4), (COUNT, 1, 1))
    w_T_b[:, :2, 3] = [(6.0 * k, 0) if k < 7 else (6.0 * (COUNT - k), 20) for k in range(COUNT)]
    place_m = w_T_b[:, :3, 3] @ np.asarray(turned) + np.random.default_rng(0).normal(0, 0.01, (COUNT, 3))
    names, none = tuple(f"fix {k}" for k in range(COUNT)), np.zeros(COUNT, bool)
    fixes = FixComparison(Fixes(STAMPS_S, place_m, (0.01, 0.01, 0.02), True, names, none), STAMPS_S)
    used = fixes.rough(w_T_b, False).used
    assert used.all() == np.array_equal(turned, np.eye(3))
    fit = umeyama(w_T_b[used, :3, 3], place_m[used], with_scale=True)
    w_T_b[:, :3, 3] = fit.apply(w_T_b[:, :3, 3])
    told = [each.warning.text for each in fixes.contradictions(fixes.exact(w_T_b), w_T_b)]
    assert any("latitude and longitude" in text for text in told) == (not used.all())


@pytest.mark.parametrize(
    ("assumed", "std_m", "up_m"), [(True, 0.025, 0.2), (True, 10.0, 0.0), (False, 0.025, 0.0)]
)
def test_the_height_of_an_untold_antenna_is_uncertain_where_fixes_are_exact(assumed, std_m, up_m):
    none = np.zeros(1, dtype=bool)
    fixes = Fixes(
        np.zeros(1), np.zeros((1, 3)), (std_m, std_m, std_m), True, ("0",), none, antenna_assumed=assumed
    )
    assert fixes.antenna_up_std_m == up_m
    assert replace(fixes, antenna_std_m=0.5).antenna_up_std_m == 0.5
