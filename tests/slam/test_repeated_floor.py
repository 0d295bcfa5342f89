"""The same tile all over the floor: what overlaps may still be registered by the wrong copy of it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from slam.evaluation import evaluate
from slam.mapping.pipeline import optimize
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe
from tests.benchmarks.aliased import repeated


@pytest.mark.slow
def test_a_view_as_wide_as_the_tile_is_not_torn() -> None:
    """From 1.2 m a picture shows a piece and half of its copy; pairs that overlap matched the copies."""
    flight = repeated(4, corners=7, rate_hz=4.0)
    estimate = optimize(flight)
    evaluation = evaluate(estimate, flight)
    assert evaluation.loops is not None
    assert evaluation.ate_m is not None
    assert evaluation.loops.false_kept == 0
    assert evaluation.loops.recall > 0.9
    assert evaluation.ate_m.rmse < 0.01
    assert any("implausible" in loop.reason for loop in estimate.loops)


@pytest.mark.slow
@pytest.mark.parametrize(("tile_m", "least_recall"), [(0.9, 0.8), (0.5, 0.4)])
def test_a_pattern_smaller_than_the_picture_is_not_slipped_on(tile_m: float, least_recall: float) -> None:
    """The view is 1 m wide: the motion so far says which of the copies it is."""
    eight = load_recipe("figure_eight")
    assert eight.camera is not None
    world = replace(eight.world, repeat=True, mark_diameter_m=0.0, tile_m=tile_m)
    flight = simulate(replace(eight, world=world, camera=replace(eight.camera, rate_hz=7.5)), 0)
    estimate = optimize(flight)
    evaluation = evaluate(estimate, flight)
    assert evaluation.loops is not None
    assert evaluation.ate_m is not None
    assert evaluation.loops.false_kept == 0
    assert evaluation.loops.recall > least_recall
    assert evaluation.ate_m.rmse < 0.01
