"""How probable a chosen term is beside its alternatives."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slam.criticism.search.effects import Effect
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict import posterior
from slam.criticism.verdict.posterior import (
    Place,
    Posterior,
    likelier_term,
    likeliest,
    posterior_of,
    probabilities,
)


def names_of(posterior: Posterior) -> tuple[tuple[str, ...], ...]:
    return tuple(place.names for place in posterior.places)


@pytest.mark.parametrize("sets", [9, 18, 38])
def test_a_term_of_every_set_has_probability_one(sets: int):
    found = probabilities([(-0.1 * k, frozenset(["quadratic_drag", str(k)])) for k in range(sets)])
    assert 1.0 - 1e-12 < found["quadratic_drag"] <= 1.0


def test_what_is_likelier_in_place_of_a_chosen_term_is_found():
    lag = Effect("attitude_lag", relaxes=("vehicle.attitude_time_s",))
    found = SimpleNamespace(chosen=(lag,))
    place = Place(("attitude_lag", "control_latency"), 0.0, "control_latency")

    def by(lag_p: float, latency_p: float):
        return likelier_term(
            found, Posterior({"attitude_lag": lag_p, "control_latency": latency_p}, (place,))
        )

    assert by(0.001, 0.999) == (lag, "control_latency")
    assert by(0.6, 0.4) is None


def test_every_term_that_seems_less_probable_than_another_is_compared_with_it_once(monkeypatch):
    """One comparison in vain must not leave the next chosen term beside a more probable alternative."""
    brake = Effect("active_braking", relaxes=("k_b",))
    lag = Effect("attitude_lag", relaxes=("vehicle.attitude_time_s",))
    found = SimpleNamespace(chosen=(brake, lag), last=SimpleNamespace(effects=()))
    places = Place((brake.name, "asymmetric_drag"), 0.0, ""), Place((lag.name, "control_latency"), 0.0, "")
    known = Posterior({n: float(n == p.names[1]) for p in places for n in p.names}, places)
    compared = []

    def in_vain(found, place, candidates):
        compared.append(place.name)
        return found

    monkeypatch.setattr(posterior, "with_term_replaced", in_vain)
    monkeypatch.setattr(posterior, "posterior_of", lambda _: known)
    monkeypatch.setattr(posterior, "likelier_pairs", lambda *_: [])
    assert likeliest(found, known) is found
    assert compared == ["active_braking", "attitude_lag"]


def searched(nats, chosen, covariance=None, **more):
    """The result of a search whose sets of effects explain these ``nats``."""
    covariance = np.eye(2) if covariance is None else covariance

    table = {frozenset(effects): value for effects, value in nats.items()}

    def maximise(effects):
        return SimpleNamespace(nats=table[frozenset(effects)])

    def standing(rest, tried):
        return [
            SimpleNamespace(effect=e, nats=maximise([*rest, e]).nats - maximise(rest).nats) for e in tried
        ]

    expansion = SimpleNamespace(
        effects=tuple(e for effects in nats if len(effects) == 1 for e in effects),
        patterns=(),
        score_tests=standing,
        own=lambda effect: effect,
        fisher=SimpleNamespace(log_likelihood=np.zeros(1)),
        maximise=maximise,
        nats=lambda effects, _: maximise(effects).nats,
        clustered=False,
        correlation=lambda one, other, beside: float(covariance[0, 1]),
    )
    return SearchResult(model=None, first=expansion, last=expansion, chosen=chosen, **more)


def test_a_fit_of_a_rival_takes_precedence_over_an_expansion():
    rise, scale = Effect("sonar_temperature", relaxes=("a",)), Effect("sonar_scale", relaxes=("b",))
    nats = {(): 0.0, (rise,): 50.0, (scale,): 51.4, (rise, scale): 51.5}
    found = searched(nats, (rise,))
    assert posterior_of(found).probability["sonar_temperature"] < 0.25
    refitted = replace(found, leads={(rise.label, scale.label): 0.0})
    assert posterior_of(refitted).probability["sonar_temperature"] == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("lead", [0.5, 3.9, 4.1, 9.9])
def test_no_alternative_stands_beside_a_probability_of_one(lead):
    wind, cant = Effect("steady_wind", relaxes=("a",)), Effect("canted_thrust", relaxes=("b",))
    nats = {(): 0.0, (wind,): 50.0, (cant,): 50.0 - lead, (wind, cant): 50.5}
    posterior = posterior_of(searched(nats, (wind,), np.array([[1.0, 0.99], [0.99, 1.0]])))
    assert names_of(posterior) == (("steady_wind", "canted_thrust"),)
    assert [place.lead_nats for place in posterior.places] == [pytest.approx(lead)]
    assert 0.5 < posterior.probability["steady_wind"] < 0.985
    # A lead that the forms of the equations cannot explain is evidence.
    apart = posterior_of(searched(nats, (wind,)))
    assert apart.probability["steady_wind"] > posterior.probability["steady_wind"]


def test_a_term_that_contradicts_itself_is_no_alternative():
    wind, cant = Effect("steady_wind", relaxes=("a",)), Effect("canted_thrust", relaxes=("b",))
    nats = {(): 0.0, (wind,): 50.0, (cant,): 80.0, (wind, cant): 80.5}
    found = searched(nats, (wind,), np.array([[1.0, 0.99], [0.99, 1.0]]))
    assert posterior_of(found).probability["steady_wind"] < 0.01
    refuting = posterior_of(found, {"canted_thrust"})
    assert refuting.probability["steady_wind"] > 0.99
    assert names_of(refuting) == (("steady_wind",),)


def test_a_limit_and_a_curve_that_fit_alike_are_a_set_for_an_out_of_model_vehicle_too():
    limit = Effect("tilt_limit", parameters=("limit",), relaxes=("a",))
    curve = Effect("command_nonlinearity", relaxes=("b",))
    found = searched(
        {(): 0.0, (limit,): 50.0, (curve,): 49.0}, (limit,), rivals={"tilt_limit": ("command_nonlinearity",)}
    )
    found = replace(found, model=SimpleNamespace(out_of_model=True))
    posterior = posterior_of(found)
    assert names_of(posterior) == (("tilt_limit", "command_nonlinearity"),)
    assert posterior.probability["tilt_limit"] == posterior.probability["command_nonlinearity"] <= 0.5


@pytest.mark.parametrize("lead", [0.0, 30.0])
def test_what_fitted_as_well_when_a_term_was_chosen_shares_its_probability(lead):
    """A curve is chosen, and an expansion about it says little of a limit."""
    curve, limit = Effect("command_nonlinearity", relaxes=("b",)), Effect("tilt_limit", relaxes=("a",))
    nats = {(): 0.0, (curve,): 900.0, (limit,): 900.0 - lead, (curve, limit): 900.5}
    posterior = posterior_of(searched(nats, (curve,), rivals={"command_nonlinearity": ("tilt_limit",)}))
    assert names_of(posterior) == (("command_nonlinearity", "tilt_limit"),)
    assert posterior.probability["tilt_limit"] == pytest.approx(posterior.probability["command_nonlinearity"])
    assert posterior.probability["tilt_limit"] == pytest.approx(0.5, abs=0.01)


def test_what_explains_nothing_is_no_alternative_to_a_term_that_rollouts_chose():
    lag, slope = Effect("attitude_lag", relaxes=("a",)), Effect("floor_slope", relaxes=("b",))
    nats = {(): 0.0, (lag,): 0.1, (slope,): 0.0, (lag, slope): 0.1}
    assert names_of(posterior_of(searched(nats, (lag,)))) == (("attitude_lag",),)


def test_an_alternative_counts_where_it_explains_most():
    lag, brake = Effect("attitude_lag", relaxes=("a",)), Effect("active_braking", relaxes=("b",))
    late = Effect("control_latency", relaxes=("c",))
    nats = {(): 0.0, (lag,): 400.0, (brake,): 300.0, (late,): 405.0, (lag, brake): 700.0}
    nats |= {(brake, late): 720.0, (lag, late): 701.0, (lag, brake, late): 720.0}
    posterior = posterior_of(searched(nats, (lag, brake)))
    assert names_of(posterior) == (("attitude_lag", "control_latency"), ("active_braking",))
