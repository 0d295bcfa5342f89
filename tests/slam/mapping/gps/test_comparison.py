"""Fixes that a refined map does not use are compared with what it knows of their places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.mapping.calibration.antenna import NOMINAL_ANTENNA_STD_M
from slam.mapping.gps.comparison import FixComparison
from slam.mapping.gps.fixes import Fixes

COUNT = 14
LAST = np.arange(COUNT) == COUNT - 1
POSE_STD_M = 0.05
STAMPS_S = np.arange(float(COUNT))
COVARIANCES = np.tile(np.diag([0.0, 0, 0, *(POSE_STD_M,) * 3]) ** 2, (COUNT, 1, 1))


def line_and_back() -> np.ndarray:
    """Poses (14, 4, 4) along a line, and the last one on the way back."""
    w_T_b = np.tile(np.eye(4), (COUNT, 1, 1))
    w_T_b[:, 0, 3] = 3.0 * STAMPS_S
    w_T_b[-1, :3, :3] = Rotation.from_euler("z", np.pi).as_matrix()
    return w_T_b


def compared(off_m: np.ndarray, antenna_m: np.ndarray) -> FixComparison:
    """Fixes (14,) that lie ``off_m`` (14, 3) beside an antenna at its told place."""
    w_T_b, std_m = line_and_back(), (0.01, 0.01, 0.02)
    w_p_b_m = w_T_b[:, :3, 3] + w_T_b[:, :3, :3] @ antenna_m + off_m
    names, none = tuple(f"fix {k}" for k in range(COUNT)), np.zeros(COUNT, bool)
    return FixComparison(Fixes(STAMPS_S, w_p_b_m, std_m, True, names, none, antenna_m), STAMPS_S)


@pytest.mark.parametrize(
    ("off_m", "antenna_m", "used"), [(0.7, 0.0, True), (0.7, 0.1, False), (3.0, 0.0, False)]
)
def test_an_antenna_that_nobody_told_may_be_the_cause_at_another_heading(
    off_m: float, antenna_m: float, used: bool
) -> None:
    """An antenna 0.35 m ahead of the body's origin lies 0.7 m aside on the way back, and nowhere else."""
    noise = np.random.default_rng(0).normal(0, 0.005, (COUNT, 3))
    fixes = compared(noise + LAST[:, None] * [off_m, 0, 0], np.array([antenna_m, 0, 0]))
    w_T_b = line_and_back()
    assert not fixes.exact(w_T_b).used[-1], "taken for a fix that the map uses"
    found = fixes.exact(w_T_b, fixes.map_std_m(w_T_b, COVARIANCES, LAST))
    assert found.used[:-1].all()
    assert found.used[-1] == used


def test_the_deviation_is_the_scatter_of_drawn_maps_and_antennas() -> None:
    rng, w_T_b = np.random.default_rng(1), line_and_back()
    w_T_b[:, :3, :3] = Rotation.from_euler("zyx", rng.normal(0, 1, (COUNT, 3))).as_matrix()
    fixes = compared(np.zeros((COUNT, 3)), np.zeros(3))
    antenna = w_T_b[:, :3, :3] @ rng.normal(0, NOMINAL_ANTENNA_STD_M, (20_000, 1, 3, 1))
    moved = antenna[:, -1, :, 0] - antenna[:, :-1, :, 0].mean(axis=1)
    moved += rng.normal(0, POSE_STD_M, moved.shape)
    found = fixes.map_std_m(w_T_b, COVARIANCES, LAST)
    assert found[-1] == pytest.approx(moved.std(axis=0), rel=0.03)
    assert not found[:-1].any()
    told = FixComparison(replace(fixes.fixes, antenna_m=np.array([0.1, 0, 0])), STAMPS_S)
    assert told.map_std_m(w_T_b, COVARIANCES, LAST)[-1] == pytest.approx(POSE_STD_M)
    assert not fixes.map_std_m(w_T_b, COVARIANCES, ~LAST & LAST).any()
