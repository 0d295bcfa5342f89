"""Loops that are false by construction, and the chance that they show."""

from __future__ import annotations

import numpy as np
import pytest

from backend.pose_graph.from_measurements import from_measurements
from backend.pose_graph.selection.null_loops import NullLoops, estimate_pass_probability
from tests.backend.synthetic import flight


def test_no_decoy_joins_the_places_of_a_loop():
    problem, _ = from_measurements(flight(0, n=80, loops=20).measurements, None)
    loops = np.flatnonzero(~problem.trusted)
    loops = loops[np.unique(problem.i[loops], return_index=True)[1]]
    place = np.arange(len(loops)) // 2
    made = NullLoops.of(problem, loops, place).problem
    assert len(made.i) > 100
    a, b = (np.searchsorted(problem.i[loops], end) for end in (made.i, made.j - 40))
    np.testing.assert_array_equal(problem.i[loops[a]], made.i)
    np.testing.assert_array_equal(problem.j[loops[b]], made.j)
    assert (place[a] != place[b]).all()
    np.testing.assert_array_equal(made.ij_T, NullLoops.of(problem, loops, place).problem.ij_T)


@pytest.mark.parametrize(("offset", "slope"), [(0.0, 1.0), (2.0, 0.5), (0.0, 0.2)])
def test_the_chance_that_decoys_show_is_found(offset: float, slope: float):
    """Decoys whose prediction is sharp by a known chance, agreeing as often as a known line says."""
    rng = np.random.default_rng(1)
    told = rng.uniform(-8, 0, 5000)
    agrees = rng.uniform(size=5000) < np.exp(np.minimum(offset + slope * told, 0))
    found = estimate_pass_probability(told, agrees)
    for at in (-6.0, -4.0, -2.0):
        truth = min(offset + slope * at, 0.0)
        assert found.of(np.array([at]))[0] == pytest.approx(max(truth, at), abs=0.35)


def test_without_decoys_a_loop_may_lie_anywhere():
    chance = estimate_pass_probability(np.zeros(0), np.zeros(0, dtype=bool))
    np.testing.assert_array_equal(chance.of(np.array([-9.0, -1.0])), [-9.0, -1.0])
