"""Held-out gains: no reading counts on one side alone."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from slam.criticism.kalman.filter import IGNORED, USED
from slam.criticism.kalman.innovations import FilterPass, whole
from slam.criticism.search.effects import effects_for
from slam.criticism.search.expansion import expand
from slam.criticism.search.information import FisherInformation
from slam.criticism.search.search import search
from slam.criticism.search.thresholds import load_thresholds
from slam.criticism.verdict.held_out import _of_the_same_readings, held_out
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from tests.slam.criticism.judged_flights import NOMINAL, SLOWER, judged


def fisher(run, pieces, shown):
    """A look at one flight whose segments are its events in equal parts, pictures last."""
    bounds = np.linspace(0, len(run.status), pieces + 1).astype(int)
    nats = np.array([*(run.nats[a:b].sum() for a, b in pairwise(bounds)), shown])
    nothing = np.zeros((pieces + 1, 0))
    return FisherInformation((), np.zeros(pieces + 1, dtype=int), nothing, nothing, nats, (run,))


def test_a_reading_that_one_parameter_set_ignores_counts_in_neither():
    rng = np.random.default_rng(0)
    white, log_variance = rng.normal(size=(60, 6)), rng.normal(-5.0, 1.0, (60, 6))
    status = np.full((60, 6), USED)
    fewer = status.copy()
    fewer[10:20, 3:] = IGNORED
    missing = np.where(fewer == USED, white, np.nan), np.where(fewer == USED, log_variance, np.nan)
    states, record = np.zeros((60, 11)), SimpleNamespace(matches=True)
    every, part = (
        FilterPass(record, *of, states) for of in ((white, log_variance, status), (*missing, fewer))
    )
    one, other = _of_the_same_readings(fisher(every, 3, 7.0), fisher(part, 3, 5.0))
    np.testing.assert_allclose(one[:3], other[:3])
    assert (one[3], other[3]) == (7.0, 5.0)


PLANS = (["climb and descend by 0.6 m"], ["touch the floor, stand for 3 s and rise again"],
         ["reversing forward at 0.2"])  # fmt: skip


def flown(plans):
    vehicle = SLOWER.with_term("sonar_bias", b=-0.04)
    return judged(simulate_flight(vehicle, stick_for(plan), 60 + k) for k, plan in enumerate(plans))


@pytest.fixture(scope="module")
def short_sonar():
    """Flights of which one shows what is wrong, on the floor."""
    records = flown(PLANS)
    return records, search(records, NOMINAL, load_thresholds())


def one_more(base, last):
    """A reading of the first flight that only the parameters with the term use, with a large residual."""
    nats = base.log_likelihood.copy(), last.log_likelihood.copy()
    nats[1][0] += 30.0
    return nats


def test_one_of_two_flights_whose_parameter_sets_use_different_readings_is_filtered_anew(monkeypatch):
    """Of the whole catalogue one term is looked at, about parameters without it."""
    module = "slam.criticism.search.expansion"
    monkeypatch.setattr(
        f"{module}.effects_for", lambda *a: [e for e in effects_for(*a) if e.name == "sonar_bias"]
    )
    monkeypatch.setattr(f"{module}.residual_patterns", lambda _: [])
    records = flown(PLANS[:2])
    look = expand(records, NOMINAL, NOMINAL)
    (term,) = (e for e in look.effects if e.name == "sonar_bias")
    found = SimpleNamespace(first=look, last=look, chosen=(term,), records=tuple(records))
    by_parabola = held_out(found)
    monkeypatch.setattr("slam.criticism.verdict.held_out._of_the_same_readings", one_more)
    anew = held_out(found)
    assert anew.nats[1] == by_parabola.nats[1]
    runs = [whole(records[0], parameters[0]) for parameters in (anew.before, anew.after)]
    assert anew.nats[0] == pytest.approx(runs[1].log_likelihood - runs[0].log_likelihood, abs=1e-6)


@pytest.mark.slow
def test_what_one_flight_alone_shows_is_confirmed(short_sonar):
    _, found = short_sonar
    assert [e.name for e in found.chosen] == ["sonar_bias"]
    gain = held_out(found)
    assert gain.by == "flight"
    assert gain.total > 5.0
    assert np.abs(gain.nats[[0, 2]]).max() < 5.0


@pytest.mark.slow
def test_flights_whose_parameter_sets_use_different_readings_are_filtered_anew(short_sonar, monkeypatch):
    records, found = short_sonar
    by_parabola = held_out(found)
    monkeypatch.setattr("slam.criticism.verdict.held_out._of_the_same_readings", one_more)
    anew = held_out(found)
    np.testing.assert_array_equal(anew.nats[1:], by_parabola.nats[1:])
    runs = [whole(records[0], parameters[0]) for parameters in (anew.before, anew.after)]
    assert anew.nats[0] == pytest.approx(runs[1].log_likelihood - runs[0].log_likelihood, abs=1e-6)
    # All of them are judged by both here, so that the parabola tells the same to the curvature.
    assert anew.nats[0] == pytest.approx(by_parabola.nats[0], abs=1.5)
