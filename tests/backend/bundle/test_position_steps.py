"""Steps in measured positions that are more exact than the pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.position_steps import PositionStep, position_step
from backend.bundle.refinement import refine
from backend.sparse_cholesky import Cholesky
from tests.backend.bundle.made_scenes import HELD_BY_POSITIONS, SURVEY
from tests.backend.made_floor import Scene, make


def found_step(
    scene: Scene, step_m: tuple[float, float, float], seed: int, first: int = 8
) -> PositionStep | None:
    """The step that is found where positions lie ``step_m`` aside from keyframe ``first`` on."""
    made = make(scene, seed)
    moved = tuple(
        replace(p, w_p_antenna_m=p.w_p_antenna_m + np.array(step_m) * (p.k >= first))
        for p in made.measurements.positions
    )
    measurements = replace(made.measurements, positions=moved)
    return position_step(refine(measurements, made.start, made.floor_z_m).optimum)


@pytest.mark.parametrize("step_m", [(1.0, 0.0, 0.0), (0.0, 0.0, 4.0)])
def test_positions_that_a_map_follows_show_a_step_by_its_score(step_m: tuple[float, float, float]) -> None:
    found = found_step(HELD_BY_POSITIONS, step_m, 1)
    assert found is not None
    assert abs(found.keyframe - 8) <= 1
    assert (np.abs(found.shift_m - step_m) < 3 * found.std_m).all()


@pytest.mark.parametrize("seed", range(3))
def test_positions_without_a_step_show_none(seed: int) -> None:
    assert found_step(HELD_BY_POSITIONS, (0.0, 0.0, 0.0), seed) is None


def test_the_residuals_of_coarse_positions_show_it_and_no_score_is_needed() -> None:
    assert found_step(SURVEY, (4.0, 0.0, 0.0), 0) is None


def test_steps_of_a_large_map_are_solved_for_a_few_at_a_time_and_are_the_same(monkeypatch) -> None:
    at_once = found_step(HELD_BY_POSITIONS, (1.0, 0.0, 0.0), 1)
    columns, solve = [], Cholesky.solve

    def counted(self: Cholesky, right: np.ndarray) -> np.ndarray:
        columns.append(right.shape[1])
        return solve(self, right)

    monkeypatch.setattr("backend.bundle.reduced_system.MOST_NUMBERS", 800)
    made = make(HELD_BY_POSITIONS, 1)
    moved = tuple(
        replace(p, w_p_antenna_m=p.w_p_antenna_m + np.array([1.0, 0.0, 0.0]) * (p.k >= 8))
        for p in made.measurements.positions
    )
    optimum = refine(replace(made.measurements, positions=moved), made.start, made.floor_z_m).optimum
    monkeypatch.setattr(Cholesky, "solve", counted)
    few = position_step(optimum)
    assert len(columns) > 1
    assert max(columns) * optimum.structure.elimination.size <= 800
    assert few is not None
    assert at_once is not None
    assert few.keyframe == at_once.keyframe
    np.testing.assert_allclose(few.shift_m, at_once.shift_m, rtol=1e-9)
    np.testing.assert_allclose(few.std_m, at_once.std_m, rtol=1e-9)
