"""A flight over terraces: the sonar hears another height of ground on each."""

from __future__ import annotations

import pytest

from slam.evaluation import evaluate
from slam.mapping.pipeline import optimize
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_ranges_are_those_of_the_terrace_below(seed: int) -> None:
    """Taken for noise, such ranges had put keyframes 0.22 m off."""
    flight = simulate(load_recipe("terraces"), seed=seed)
    estimate = optimize(flight)
    found = evaluate(estimate, flight)
    assert estimate.status == "ok"
    assert found.ate_m is not None
    assert found.ate_m.rmse < 0.005
    assert found.nees is not None
    assert found.nees.pose.lower95 < found.nees.pose.mean < found.nees.pose.upper95
