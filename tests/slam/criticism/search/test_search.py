"""Which of what stands out the search takes."""

from __future__ import annotations

from slam.criticism.search.effects import Effect, relaxations
from slam.criticism.search.search import Standing

BRAKE = Effect("active_braking", relaxes=("k_b",))
BIAS = Effect("gyro_bias", relaxes=("x", "y", "z"))


def test_a_term_that_says_why_goes_before_a_constant_out_of_its_range_that_explains_little_more():
    drag = next(e for e in relaxations() if e.name.startswith("vehicle.drag"))
    loose = Standing(drag, 30.0, 7.7)
    assert Standing(BRAKE, 28.0, 7.5).worth > loose.worth > Standing(BRAKE, 20.0, 6.3).worth


def test_each_number_costs():
    assert (
        Standing(BIAS, 22.0, 6.0).worth < Standing(BRAKE, 20.0, 6.3).worth < Standing(BIAS, 26.0, 6.6).worth
    )
