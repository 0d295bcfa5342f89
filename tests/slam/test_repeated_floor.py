"""The same tile all over the floor: what overlaps may still be registered by the wrong copy of it."""

from __future__ import annotations

import pytest

from slam.evaluation import evaluate
from slam.pipeline import optimize
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
