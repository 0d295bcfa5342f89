"""The paper's numbers against each other: the figures that were found by hand, and that a change is seen."""

import math

import numpy as np
import pytest

from slam.evaluation import paper_values as paper
from slam.experiments import paper_checks
from slam.experiments.paper_checks import (
    checks,
    drag_1_s,
    free_drift_m,
    line_through_table_5,
    misfit_m_s2,
    odd_point,
)


def check(name):
    (found,) = [one for one in checks() if one.name.startswith(name)]
    return found


def test_names_are_distinguished():
    names = [one.name for one in checks()]
    assert len(set(names)) == len(names)


def test_table_2s_sides_were_divided_by_140_cm():
    assert check("table 2, D-A").recomputed == pytest.approx(19.54, abs=0.01)
    assert not check("table 2, D-A").holds
    for pair in ("A-B", "B-C", "C-D", "D-A"):
        divisor = 100 * paper.WHITE_BALANCE_M[pair] / paper.WHITE_BALANCE_PERCENT[pair]
        assert divisor == pytest.approx(1.40, abs=0.005)
    assert check("table 2, B-D").holds


def test_table_1s_simulated_diagonal_was_divided_by_a_side():
    assert not check("table 1, simulated B-D").holds
    assert 100 * paper.SQUARE_M["B-D"] / paper.SQUARE_PERCENT["B-D"] == pytest.approx(1.30, abs=0.005)
    assert check("table 1, simulated D-A").holds
    for pair, percent in paper.SQUARE_DRONE_PERCENT.items():
        side = paper.DIAGONAL_M if pair == "B-D" else paper.SIDE_M
        assert 100 * paper.SQUARE_DRONE_M[pair] / side == pytest.approx(percent, rel=0.006)


def test_equation_4_is_one_point_and_not_the_fit():
    assert line_through_table_5() == pytest.approx(0.3009, abs=1e-4)
    assert math.radians(1) / paper.P_THETA == pytest.approx(0.3062, abs=1e-4)
    assert paper.SPEED_M_S[0.25] / paper.PITCH_DEG[0.25] == pytest.approx(paper.SPEED_A_DEGREE, abs=2e-4)


def test_drag_is_linear():
    assert drag_1_s() == pytest.approx(0.566, abs=0.001)
    assert drag_1_s(0.10) == pytest.approx(0.557, abs=0.001)
    assert misfit_m_s2(1) == pytest.approx(0.065, abs=0.002)
    assert misfit_m_s2(2) / misfit_m_s2(1) == pytest.approx(2.5, abs=0.1)


def test_the_odd_point_is_suspicious_and_not_certain():
    speed, t, p = odd_point()
    assert speed == pytest.approx(0.895, abs=0.01)
    assert t == pytest.approx(-3.8, abs=0.2)
    assert 0.02 < p < 0.05
    assert 1 - (1 - p) ** 5 > 0.1


def test_a_free_hover_drifts_as_a_drawn_one():
    """Against drawn Ornstein-Uhlenbeck speeds, and the paper's drift needs a far shorter memory."""
    rng, step, tau = np.random.default_rng(0), 0.01, 0.5
    keep = math.exp(-step / tau)
    speed = np.zeros((4000, 2))
    speed[:] = math.sqrt(paper.HOVER_SPEED_VARIANCE) * rng.standard_normal(speed.shape)
    place, sums = np.zeros_like(speed), 0.0
    for _ in range(3500):
        kick = math.sqrt(paper.HOVER_SPEED_VARIANCE * (1 - keep**2)) * rng.standard_normal(speed.shape)
        after = keep * speed + kick
        place += step * (speed + after) / 2
        speed = after
        sums += np.hypot(*place.T).mean()
    mean, end = free_drift_m(tau)
    assert mean == pytest.approx(sums / 3500, rel=0.03)
    assert end == pytest.approx(np.hypot(*place.T).mean(), rel=0.03)
    assert end == pytest.approx(0.26, abs=0.01)
    assert mean > 2 * paper.HOVER_DRIFT_M


def test_the_hovers_variance_is_of_one_axis():
    assert check("variance of the hover's speed").recomputed == pytest.approx(0.00113, abs=1e-5)


def test_the_field_of_view_is_across():
    found = check("floor seen from 1 m")
    assert found.holds
    assert "140.8 px" in found.explanation
    assert "29 %" in found.explanation
    assert check("speed at half overlap and 15 Hz").holds
    assert check("speed at half overlap and 6.67 Hz").holds


def test_tilt_explains_no_large_sonar_error():
    assert check("largest scale error of a sonar").recomputed == pytest.approx(0.85, abs=0.01)


def test_a_number_that_were_another_would_be_seen(monkeypatch):
    """Mutation: each check looks at the number that it names."""
    monkeypatch.setattr(paper_checks, "SQUARE_PERCENT", {**paper.SQUARE_PERCENT, "D-A": 6.2})
    monkeypatch.setattr(paper_checks, "FLOOR_AT_1M_M", 1.5)
    monkeypatch.setattr(paper_checks, "HOVER_SPEED_VARIANCE", 0.0005)
    for name in ("table 1, simulated D-A", "floor seen from 1 m", "variance of the hover's speed"):
        assert not check(name).holds, name
