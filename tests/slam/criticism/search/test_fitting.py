"""What is fitted with the nuisances, and what keeps the size that all of the flights gave it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.record import record_of
from slam.criticism.search.effects import effects_for, relaxed_nuisances
from slam.criticism.search.fitting import FIRST_S, LONG_S, fit_nuisances
from slam.criticism.search.information import fisher_information
from slam.simulation.dynamics import ROTOR_RADIUS
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model


def test_a_term_that_the_first_parts_do_not_show_keeps_its_size():
    """A cushion of air under flights that land only later: what little they say of it is chance."""
    vehicle = at_lower_rates(load_model("nominal"))
    model = filter_parameters_of(vehicle)
    record = record_of(simulate_flight(vehicle, stick_for(["climb and descend by 0.6 m"]), 3, maker=vehicle))
    dynamics = model.dynamics.copy()
    dynamics[ROTOR_RADIUS] = 0.04
    start = replace(model, dynamics=dynamics)
    cushion = next(e for e in effects_for([record], model) if e.name == "ground_effect")
    found = fit_nuisances([record], model, start, [cushion])
    assert found.dynamics[ROTOR_RADIUS] == 0.04
    assert (found.hold != start.hold).any()
    # A nuisance out of its range is a term too, and no such one.
    drag = next(e for e in relaxed_nuisances() if e.name.startswith("vehicle.drag"))
    apart = fit_nuisances([record], model, start, [cushion, drag])
    assert apart.dynamics != pytest.approx(found.dynamics, rel=1e-4)
    assert apart.dynamics[ROTOR_RADIUS] == 0.04


def test_noise_of_long_flights_is_fitted_to_all_of_them(monkeypatch):
    """Known no better than a minute tells it, it leaves a shape in ten."""
    vehicle = at_lower_rates(load_model("nominal"))
    model = filter_parameters_of(vehicle)
    record = record_of(simulate_flight(vehicle, stick_for(["climb and descend by 0.6 m"]), 3, maker=vehicle))
    seconds = []

    def fisher(records, *rest):
        seconds.append(sum(r.duration_s for r in records))
        return fisher_information(records[:1], *rest)

    monkeypatch.setattr("slam.criticism.search.fitting.fisher_information", fisher)
    many = round(LONG_S / record.duration_s) + 1
    fit_nuisances([record] * many, model)
    fit_nuisances([record] * (many - 2), model)
    assert seconds[0] == pytest.approx(FIRST_S, rel=0.1)
    assert seconds[1] == pytest.approx(many * record.duration_s)
    assert seconds[2:] == pytest.approx([FIRST_S] * 2, rel=0.1)
