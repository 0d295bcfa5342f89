import re
from dataclasses import replace

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.simulation import dynamics
from slam.simulation.model import Model, load_model, model_from, save_model, shipped_models
from slam.simulation.terms import CATALOGUE

MOTION_OUTSIDE = {"control_latency", "flow_scale", "gusts"}
"""Motion terms that act on the command's clock, on an instrument and as noise: not inside the equations."""


def test_the_nominal_file_is_the_default():
    assert "nominal" in shipped_models()
    assert load_model("nominal") == Model()


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_a_model_with_any_term_comes_back_from_its_file(name, tmp_path):
    term = CATALOGUE[name]
    model = Model().with_term(name, **{p.name: p.low for p in term.parameters})
    model = model.with_std(name, **{p.name: 0.25 for p in term.parameters})
    save_model(model, tmp_path / "m.toml")
    back = load_model(tmp_path / "m.toml")
    assert back == model
    assert back.holds(name)
    assert not Model().holds(name)


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_a_term_is_well_declared(name):
    term = CATALOGUE[name]
    assert term.name == name
    assert re.fullmatch(r"[a-z_]+", name)
    assert set(term.confounders) <= set(CATALOGUE) - {name}
    assert term.equation
    for p in term.parameters:
        assert p.least <= p.low <= p.high <= p.most
        assert p.least <= p.neutral <= p.most
        assert p.unit in {"s", "m", "rad", "1", "1/s", "1/m", "1/s^2", "m/s", "m/s^2", "rad/s", "K", "ppm"}


@pytest.mark.parametrize(
    "name", sorted(n for n, t in CATALOGUE.items() if t.family == "motion" and n not in MOTION_OUTSIDE)
)
def test_a_motion_term_is_in_the_equations_and_its_neutral_value_is_nothing(name):
    plain = Model()
    neutral = plain.with_term(name, **CATALOGUE[name].neutral)
    assert np.array_equal(neutral.parameters(), plain.parameters())
    for p in CATALOGUE[name].parameters:
        there = plain.with_term(name, **{p.name: p.high})
        changed = np.flatnonzero(there.parameters() != plain.parameters())
        assert [dynamics.PARAMETERS[k] for k in changed] == [p.slot or f"{name}.{p.name}"]


def test_every_slot_of_the_equations_belongs_to_the_vehicle_or_to_a_term():
    slots = {p.slot or f"{t.name}.{p.name}" for t in CATALOGUE.values() for p in t.parameters}
    for name in dynamics.PARAMETERS:
        assert name.startswith("vehicle.") or name in slots


@pytest.mark.parametrize(
    ("mapping", "said"),
    [
        ({"terms": {"quadratic_drg": {"c": 0.1}}}, "did you mean 'terms.quadratic_drag'"),
        ({"terms": {"quadratic_drag": {"d": 0.1}}}, "unknown key 'terms.quadratic_drag.d'; the term has: c"),
        ({"terms": {"control_latency": {"T": 80.0}}}, "terms.control_latency.T: give 0 to 2 s, got 80"),
        ({"terms": {"quadratic_drag": {"c": float("nan")}}}, "quadratic_drag"),
        ({"terms": {"quadratic_drag": {"c": "much"}}}, "terms.quadratic_drag.c"),
        ({"vehicle": {"drag": 0.5}}, "did you mean 'vehicle.drag_1_s'"),
        ({"vehicle": {"max_tilt_rad": 30}}, "vehicle.max_tilt_rad"),
        ({"velocity": {"rate_hz": 0}}, "velocity.rate_hz: should be greater than 0"),
        ({"sonar": {"min_range_m": 3.0, "max_range_m": 2.0}}, "min_range_m must be below"),
        ({"name": "a/b"}, "name"),
        ({"std": {"sonar_scal": {"eps": 0.1}}}, "did you mean 'std.sonar_scale'"),
        ({"std": {"sonar_scale": {"b": 0.1}}}, "unknown key 'std.sonar_scale.b'; the term has: eps"),
        ({"std": {"sonar_scale": {"eps": 0.0}}}, "std.sonar_scale.eps: should be greater than 0"),
    ],
)
def test_a_bad_model_is_refused_in_one_line(mapping, said):
    with pytest.raises(InputError) as caught:
        model_from(mapping, "m.toml")
    assert said in str(caught.value)
    assert str(caught.value).startswith("m.toml: ")
    assert "\n" not in str(caught.value)


def test_a_model_that_is_not_there_is_refused_in_one_line(tmp_path):
    with pytest.raises(InputError, match="did you mean 'nominal'"):
        load_model("nomnal")
    with pytest.raises(InputError, match="does not exist"):
        load_model(tmp_path / "gone.toml")


def test_a_term_set_in_python_is_checked():
    with pytest.raises(InputError, match="give 0 to 5 1/m"):
        Model().with_term("quadratic_drag", c=-1.0)
    assert (
        replace(Model(), name="other").with_term("quadratic_drag", c=0.1).value("quadratic_drag", "c") == 0.1
    )
