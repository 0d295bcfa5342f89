"""The change by loop closures: a similarity is found exactly, and drift is what it leaves."""

from __future__ import annotations

import numpy as np
import pytest

from slam.report.loop_change import loop_change

TURN = np.linspace(0, 2 * np.pi, 50)
AFTER = np.column_stack([3 * np.cos(TURN), 2 * np.sin(TURN), 0.8 + 0.1 * np.cos(3 * TURN)])


def turned(points, scale, angle):
    c, s = np.cos(angle), np.sin(angle)
    return scale * points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [0.3, -0.2, 0.05]


def test_a_common_change_is_no_drift():
    found = loop_change(turned(AFTER, 0.965, 0.02), AFTER)
    assert (found.scale, found.turn_rad) == (pytest.approx(0.965), pytest.approx(0.02))
    assert found.largest_m == pytest.approx(0.0, abs=1e-9)
    assert found.shift_m == pytest.approx(np.linalg.norm((turned(AFTER, 0.965, 0.02) - AFTER).mean(axis=0)))
    assert found.share == pytest.approx(1.0)


def test_what_bends_the_path_is_left():
    bent = AFTER + np.column_stack([0 * TURN, 0.05 * np.sin(2 * TURN), 0 * TURN])
    found = loop_change(bent, AFTER)
    assert found.largest_m == pytest.approx(0.05, rel=0.1)
    assert found.share < 0.05


def test_an_unknown_path_has_no_change():
    assert loop_change(np.full_like(AFTER, np.nan), AFTER) is None
    assert loop_change(AFTER[:2], AFTER[:2]) is None
