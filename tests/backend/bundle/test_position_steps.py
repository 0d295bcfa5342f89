"""Steps in measured positions that are more exact than the pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.position_steps import PositionStep, position_step
from backend.bundle.refinement import refine
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
