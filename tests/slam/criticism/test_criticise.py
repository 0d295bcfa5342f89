"""Hidden effects from the project's own simulator are found; healthy flights are left in peace."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from unittest import mock

import numpy as np
import pytest

from slam.core.progress import COMPILING
from slam.criticism import criticise
from slam.criticism.search import effects as effects_module
from slam.criticism.verdict.rollouts import covariate
from slam.simulation import simulate
from slam.simulation.healthy.flights import at_lower_rates, draw_vehicle, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model
from slam.simulation.recipe import load_recipe

PLANS = (
    ["three speeds forward: 0.1, 0.2, 0.4", "turn by 90 deg between pulses forward"],
    [
        "steps of 0.25 to 0.10 and 0.25 to -0.15",
        "climb and descend by 0.6 m",
        "three speeds to the side: 0.1, 0.2, 0.4",
    ],
    ["turn by 180 deg between pulses forward", "brisk climb steps at full stick"],
)


def with_ar1_noise(model, gyro, others):
    """With noise that resembles the sample before."""
    return replace(
        model,
        imu=replace(model.imu, gyro_noise_correlation=gyro, accel_noise_correlation=others),
        attitude=replace(model.attitude, noise_correlation=others),
        velocity=replace(model.velocity, noise_correlation=others),
        sonar=replace(model.sonar, noise_correlation=others),
    )


def case(seed, student=False, colour=(0.0, 0.0), **terms):
    """Three short flights of one drawn vehicle with terms, described as the nominal one."""
    nominal = at_lower_rates(load_model("nominal"))
    vehicle = with_ar1_noise(draw_vehicle(nominal, np.random.default_rng(seed)), *colour)
    for name, values in terms.items():
        vehicle = vehicle.with_term(name, **values)
    return [
        simulate_flight(vehicle, stick_for(plan), 100 * seed + k, maker=nominal, student=student)
        for k, plan in enumerate(PLANS)
    ]


@lru_cache
def dragging():
    """Flights, the verdict, and what its covariate was drawn of."""
    flights = case(3, quadratic_drag={"c": 0.15})
    with mock.patch("slam.criticism.verdict.commanded_flights.covariate", wraps=covariate) as drawn:
        return flights, criticise(flights), drawn.call_args.args


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "student"), [(1, False), (2, True)])
def test_a_healthy_vehicle_is_left_in_peace(seed, student):
    found = criticise(case(seed, student))
    assert found.verdict == "nothing_wrong", found.sentence
    assert found.causes == ()
    assert found.detectable["quadratic_drag"][0] < 0.15


@pytest.mark.slow
def test_correlated_noise_is_healthy_and_reported():
    found = criticise(case(4, colour=(0.5, 0.4)))
    assert found.verdict == "nothing_wrong", found.sentence
    assert found.noise_correlation["gyro"] == pytest.approx(0.5, abs=0.06)
    for name in ("accel", "attitude", "velocity", "sonar"):
        assert found.noise_correlation[name] == pytest.approx(0.4, abs=0.1), name
    assert any("gyro (0.5" in line for line in found.details)
    assert found.to_json()["noise_correlation"]["gyro"] == pytest.approx(0.5, abs=0.06)
    assert found.extended.imu.gyro_noise_correlation == found.noise_correlation["gyro"]


@pytest.mark.slow
def test_progress_names_each_stage():
    reported = []
    flights = case(1)[:2]
    criticise(flights, progress=lambda *step: reported.append(step))
    stages = [stage for stage in dict.fromkeys(step[0] for step in reported) if stage != COMPILING]
    assert stages == ["filter", "fit", "screen", "roll out"]
    for stage in stages:
        done = [step[1] for step in reported if step[0] == stage]
        assert done == sorted(done)
        assert done[0] == 0
        assert done[-1] > 0
    assert [step for step in reported if step[0] == "filter"][-1] == ("filter", 2, 2)


@pytest.mark.slow
def test_what_is_missed_follows_the_guilty_covariate_until_the_cause_is_in_the_model():
    _, found, _ = dragging()
    assert found.covariate.cause == "quadratic_drag"
    own, other = found.covariate.against
    assert other.cause == found.covariate.rival != "quadratic_drag"
    assert own.channel.startswith("velocity")

    def slope(missed):
        return float(own.explained @ missed / (own.explained @ own.explained))

    assert 0.8 < slope(own.residuals[""]) < 1.2
    assert abs(slope(own.residuals["quadratic_drag"])) < 0.2
    assert slope(own.residuals[found.covariate.rival]) > slope(own.residuals["quadratic_drag"])


@pytest.mark.slow
def test_the_rival_that_is_drawn_is_that_of_the_verdict():
    _, found, (parameters, search, cause) = dragging()
    assert found.covariate.rival == cause.rival == found.causes[0].rival
    other = "flow_scale"
    assert cause.rival != other
    drawn = covariate(parameters, search, replace(cause, rival=other))
    assert [drawn.rival, *(m.cause for m in drawn.against)] == [other, cause.name, other]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameter", "size"), [("quadratic_drag", "c", 0.15), ("control_latency", "T", 0.06)]
)
def test_a_cause_beside_correlated_noise_is_named(name, parameter, size):
    found = criticise(case(3, colour=(0.5, 0.4), **{name: {parameter: size}}))
    assert found.causes[0].name == name, found.sentence
    interval = found.causes[0].parameters[parameter]
    assert interval.low < size < interval.high
    assert found.noise_correlation["gyro"] == pytest.approx(0.5, abs=0.1)


@pytest.mark.slow
def test_quadratic_drag_is_named_with_its_size():
    _, found, _ = dragging()
    assert found.verdict == "named", found.sentence
    cause = found.causes[0]
    assert cause.name == "quadratic_drag"
    assert cause.probability > 0.95
    assert cause.parameters["c"].low < 0.15 < cause.parameters["c"].high
    assert cause.gain.ci95[0] > 0
    assert found.noise_correlation == {}
    assert found.extended.value("quadratic_drag", "c") == pytest.approx(0.15, rel=0.25)


@pytest.mark.slow
def test_the_verdict_is_json_and_the_extended_model_can_be_read(tmp_path):
    from slam.cli.criticise import write_criticism

    _, found, _ = dragging()
    write_criticism(found, tmp_path)
    verdict = json.loads((tmp_path / "verdict.json").read_text())
    assert verdict["verdict"] == "named"
    assert verdict["causes"][0]["parameters"]["c"]["unit"] == "1/m"
    assert load_model(tmp_path / "extended.toml").holds("quadratic_drag")


@pytest.mark.slow
def test_the_order_of_the_flights_says_nothing():
    flights, found, _ = dragging()
    turned = criticise(flights[::-1])
    assert turned.verdict == found.verdict
    assert [c.name for c in turned.causes] == [c.name for c in found.causes]
    assert turned.causes[0].parameters["c"].value == pytest.approx(
        found.causes[0].parameters["c"].value, rel=0.05
    )


@pytest.mark.slow
def test_where_north_is_says_nothing():
    flights, found, _ = dragging()
    turn = np.array([0.0, 0.0, 1.1])
    rotated = [
        replace(f, attitude=replace(f.attitude, roll_pitch_yaw_rad=f.attitude.roll_pitch_yaw_rad + turn))
        for f in flights
    ]
    again = criticise(rotated)
    assert again.verdict == found.verdict
    assert again.causes[0].parameters["c"].value == pytest.approx(
        found.causes[0].parameters["c"].value, rel=0.02
    )


@pytest.mark.slow
def test_an_effect_that_is_not_in_the_catalogue_is_not_misnamed(monkeypatch):
    flights, _, _ = dragging()
    others = {name: term for name, term in effects_module.CATALOGUE.items() if name != "quadratic_drag"}
    monkeypatch.setattr(effects_module, "CATALOGUE", others)
    found = criticise(flights)
    assert found.verdict != "nothing_wrong"
    assert not (found.verdict == "named" and found.causes[0].probability > 0.95), found.sentence


@pytest.mark.slow
def test_a_pilot_who_knows_the_truth_is_no_effect():
    """Way points are flown by sight of the truth: the sticks tell more than the instruments do."""
    square = replace(load_recipe("square"), camera=None)
    found = criticise([simulate(square, seed) for seed in (3, 4)])
    assert found.verdict == "nothing_wrong"
    assert any("a controller moves the turn stick" in line for line in found.dropped)
