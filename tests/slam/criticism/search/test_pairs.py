"""Pairs as hypotheses: two terms that hide each other, and two that a third looks like."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.search.effects import effects_for
from slam.criticism.search.expansion import expand
from slam.criticism.search.fitting import fit_nuisances
from slam.criticism.search.search import search, with_term_replaced
from slam.criticism.search.thresholds import load_thresholds
from slam.criticism.verdict.posterior import likelier_pairs, posterior_of
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from tests.slam.criticism.judged_flights import NOMINAL, SLOWER, judged

CLIMBS = ["brisk climb steps at full stick", "up to 2 m, hover, and back", "climb and descend by 0.6 m"]
BOTH = ["climb_asymmetry", "sonar_temperature"]
LIMITS = load_thresholds()


def climbing(vehicle, seeds=(3, 4)):
    return judged(simulate_flight(vehicle, stick_for(CLIMBS), seed) for seed in seeds)


@pytest.fixture(scope="module")
def expansion():
    records = climbing(SLOWER, [3])
    return expand(records, NOMINAL, fit_nuisances(records, NOMINAL))


FEW = (*BOTH, "sonar_lag", "gyro_scale")


@pytest.fixture(scope="module")
def small_expansion():
    """The same for a part of the catalogue, and with parameters that are not fitted."""

    def few(*arguments):
        return [effect for effect in effects_for(*arguments) if effect.name in FEW]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("slam.criticism.search.expansion.effects_for", few)
        patch.setattr("slam.criticism.search.expansion.residual_patterns", lambda _: [])
        return expand(climbing(SLOWER, [3]), NOMINAL, NOMINAL)


def effects_of(expansion, names):
    return [next(e for e in expansion.effects if e.name == name) for name in names]


def carrying(expansion, names, deviations):
    """The look at flights without noise in which terms have sizes, in standard deviations with all free."""
    terms = effects_of(expansion, names)
    columns = [c for e in terms for c in e.columns]
    _, covariance = expansion.maximise(terms).of(columns)
    step = np.zeros(len(expansion.score))
    step[expansion.index(columns)] = deviations * np.sqrt(np.diag(covariance))
    score = np.zeros_like(expansion.fisher.score)
    score[0] = expansion.information @ step
    return replace(expansion, fisher=replace(expansion.fisher, score=score)), covariance


def names_of(two):
    return sorted(e.name for e in two)


def test_of_few_terms_those_that_hide_each_other_are_a_pair_and_one_is_none(small_expansion):
    look = small_expansion
    nothing, covariance = carrying(look, BOTH, np.zeros(2))
    hidden, _ = carrying(look, BOTH, np.array([6.5, np.sign(covariance[0, 1]) * 4.5]))
    alone = [hidden.score_tests([], [e])[0] for e in effects_of(look, BOTH)]
    assert names_of(hidden.masked_pair(LIMITS, alone)) == BOTH
    assert nothing.masked_pair(LIMITS) is None
    one, _ = carrying(look, BOTH[:1], np.array([5.0]))
    alone = one.score_tests([], effects_of(look, BOTH[:1]))
    assert alone[0].z == pytest.approx(5.0, abs=0.3)
    assert one.masked_pair(LIMITS, alone) is None


@pytest.mark.slow
def test_two_terms_that_hide_each_other_are_found_together(expansion):
    _, covariance = carrying(expansion, BOTH, np.zeros(2))
    sign = np.sign(covariance[0, 1])
    hidden, _ = carrying(expansion, BOTH, np.array([6.5, sign * 4.5]))
    alone = [hidden.score_tests([], [e])[0] for e in effects_of(expansion, BOTH)]
    assert max(s.z for s in alone) < 0.9 * 6.5
    assert min(s.z for s in alone) < LIMITS.effects
    assert hidden.mask_each_other(effects_of(expansion, BOTH), LIMITS)
    assert names_of(hidden.masked_pair(LIMITS, alone)) == BOTH
    # The same sizes the other way round help each other: no pair is needed to see them.
    plain, _ = carrying(expansion, BOTH, np.array([6.5, -sign * 4.5]))
    assert not plain.mask_each_other(effects_of(expansion, BOTH), LIMITS)


@pytest.mark.slow
def test_one_term_or_none_is_no_pair(expansion):
    nothing, _ = carrying(expansion, BOTH, np.zeros(2))
    assert nothing.masked_pair(LIMITS) is None
    for name in ("climb_asymmetry", "sonar_lag", "gyro_scale"):
        one, _ = carrying(expansion, [name], np.array([5.0]))
        alone = one.score_tests([], [e for e in one.effects if e.name == name])
        assert alone[0].z == pytest.approx(5.0, abs=0.3)
        assert one.masked_pair(LIMITS, alone) is None


@pytest.mark.slow
def test_two_terms_that_explain_more_than_what_looks_like_both_take_its_place():
    vehicle = SLOWER.with_term("climb_asymmetry", eps=0.04).with_term("sonar_temperature", rise=-30.0)
    records = climbing(vehicle)
    found = search(records, NOMINAL, LIMITS)
    assert [e.name for e in found.chosen] == ["sonar_scale"]
    pairs = likelier_pairs(found, found.chosen[0])
    assert names_of(pairs[0]) == BOTH
    better = with_term_replaced(found, found.chosen[0], pairs)
    assert names_of(better.chosen) == BOTH
    probability = posterior_of(better).probability
    assert min(probability[name] for name in BOTH) > 0.95
    assert probability["sonar_scale"] < 0.01
    # And back: what explains less does not.
    scale = next(e for e in better.last.effects if e.name == "sonar_scale")
    kept = with_term_replaced(better, better.chosen[0], [(scale,)])
    assert names_of(kept.chosen) == BOTH
