"""What tells the slope of the ground: heights of positions, and of control points."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from slam.mapping.warnings.slope_by_attitude import _std_by_positions

ACROSS = np.array([0.6, 0.8])


def bundle(positions: list[float], control: list[float]) -> SimpleNamespace:
    """Places along the unit vector: positions with a noise of 2 m, and control points with one of 0.1 m."""
    placed = [
        SimpleNamespace(w_p_antenna_m=np.array([*(a * ACROSS), 9.0]), std_m=np.ones(3)) for a in positions
    ]
    known = [SimpleNamespace(w_p_m=np.array([*(a * ACROSS), 5.0]), std_m=np.full(3, 0.05)) for a in control]
    measured = SimpleNamespace(positions=placed, control=known)
    noise = SimpleNamespace(position_m=np.array([1.0, 1.0, 2.0]), control=2.0)
    return SimpleNamespace(
        optimum=SimpleNamespace(problem=SimpleNamespace(measurements=measured)), noise=noise
    )


def test_control_points_tell_the_slope_as_positions_do():
    by_fixes = 2.0 / np.sqrt(2 * 30.0**2)
    by_points = 0.1 / np.sqrt(2 * 20.0**2)
    assert _std_by_positions(bundle([-30.0, 30.0], []), ACROSS) == pytest.approx(by_fixes)
    assert _std_by_positions(bundle([], [80.0, 120.0]), ACROSS) == pytest.approx(by_points)
    both = (by_fixes**-2 + by_points**-2) ** -0.5
    assert _std_by_positions(bundle([-30.0, 30.0], [80.0, 120.0]), ACROSS) == pytest.approx(both)
    assert _std_by_positions(bundle([5.0], []), ACROSS) == np.inf
