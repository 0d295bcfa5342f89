"""A canted thrust axis and a steady wind: one set at one heading, each by name at several."""

from __future__ import annotations

import numpy as np
import pytest

from slam.criticism import criticise
from slam.simulation.healthy.flights import at_lower_rates, draw_vehicle, simulate_flight
from slam.simulation.healthy.manoeuvres import MANOEUVRES, stick_for
from slam.simulation.model import load_model

STRAIGHT = (
    ["three speeds forward: 0.1, 0.2, 0.4"],
    ["steps of 0.25 to 0.10 and 0.25 to -0.15", "climb and descend by 0.6 m"],
    ["three speeds to the side: 0.1, 0.2, 0.4"],
)
HEADINGS_RAD = (0.4, 1.9, -2.2)
CAUSES = {
    "canted_thrust": {"ahead": 0.02, "left": -0.01},
    "steady_wind": {"x": 0.35, "y": -0.17},
}
"""About as strong: a drag of 0.56 1/s in that wind is 0.02 g."""


def judged(name, headings_rad):
    """The verdict on three flights without turns, which start at these headings."""
    nominal = at_lower_rates(load_model("nominal"))
    vehicle = draw_vehicle(nominal, np.random.default_rng(5)).with_term(name, **CAUSES[name])
    return criticise(
        simulate_flight(vehicle, stick_for(plan), 500 + k, maker=nominal, heading_rad=heading_rad)
        for k, (plan, heading_rad) in enumerate(zip(STRAIGHT, headings_rad, strict=True))
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", CAUSES)
def test_at_one_heading_both_are_the_set_and_a_turn_is_the_next_flight(name):
    found = judged(name, (0.4, 0.4, 0.4))
    assert found.verdict == "ambiguous", found.sentence
    assert set(found.equivalence_set) == set(CAUSES)
    assert all(found.probability_of(n) < 0.95 for n in CAUSES)
    advised = next(motion for motion in MANOEUVRES if f"'{motion}'" in found.next_flight)
    turn_rad = sum(abs(yaw) * span_s for span_s, *_, yaw in MANOEUVRES[advised])
    assert turn_rad > 0.5
    assert "once" in found.next_flight


@pytest.mark.slow
@pytest.mark.parametrize("name", CAUSES)
def test_at_several_headings_each_is_named_alone_with_its_size(name):
    found = judged(name, HEADINGS_RAD)
    assert found.verdict == "named", found.sentence
    assert [cause.name for cause in found.causes] == [name]
    for key, value in CAUSES[name].items():
        assert found.causes[0].parameters[key].value == pytest.approx(
            value, abs=0.1 * max(CAUSES[name].values())
        )
