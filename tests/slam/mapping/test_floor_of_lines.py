"""A floor that has nothing but lines: a map whose covariances and status say what it rests on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation.association import poses_at
from slam.evaluation.nees import nees
from slam.evaluation.trajectory import gauge
from slam.mapping.pipeline import optimize
from slam.simulation import load_recipe, simulate


@pytest.fixture(scope="module")
def mapped() -> tuple[Flight, Estimate]:
    recipe = load_recipe("court_eight")
    short = replace(recipe, maneuver=replace(recipe.maneuver, way_points=("A", "B", "C")))
    flight = simulate(short, 5)
    return flight, optimize(flight)


@pytest.mark.slow
def test_all_keyframes_are_placed_within_their_covariances(mapped):
    flight, estimate = mapped
    assert (estimate.component == 0).mean() > 0.95
    known = estimate.component == 0
    true = poses_at(flight.truth, estimate.stamps_s)[known]
    found, covariances = estimate.w_T_b[known], estimate.covariances[known]
    off = found[:, :3, 3] - found[0, :3, 3] - (true[:, :3, 3] - true[0, :3, 3])
    assert np.linalg.norm(off, axis=1).mean() < 0.15
    consistency = nees((gauge(found[0], true[0]) @ found)[1:], true[1:], covariances[1:])
    assert consistency is not None
    assert 0.5 < consistency.position.mean < 10.0


@pytest.mark.slow
def test_the_status_says_that_lines_do_not_show_motion_along_themselves(mapped):
    _, estimate = mapped
    assert (
        "show lines but few features, and only the instruments measure motion along them" in estimate.status
    )
