"""Flights whose height sensor is not as exact as is stated: its zero is found where the height changes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.mapping.pipeline import optimize
from tests.slam.small_flight import flown

LOW_M, HIGH_M = 0.6, 1.0
ZERO_M = 0.06
UP_AND_DOWN = [
    [0.3, 0.3, LOW_M],
    [1.5, 0.3, HIGH_M],
    [1.5, 0.7, LOW_M],
    [0.3, 0.7, HIGH_M],
    [0.3, 0.3, LOW_M],
    [1.5, 0.3, HIGH_M],
]
HILL = {"hills": [{"center_m": [0.9, 0.5], "radius_m": 0.45, "height_m": 0.12}]}
STEPS = {"boxes": [{"center_m": at_m, "size_m": [0.45, 0.45, 0.03]} for at_m in ([0.3, 0.3], [1.5, 0.7])]}
"""Steps under the low points of the way: the sensor hears them where the flight is low, as it does a zero."""


def reading(flight: Flight, zero_m: float) -> Flight:
    """The flight with another zero of its height sensor, which the files state as exact."""
    assert flight.sonar is not None
    assert flight.sonar.datum_std_m == 0
    return replace(flight, sonar=replace(flight.sonar, range_m=flight.sonar.range_m + zero_m))


@pytest.mark.slow
@pytest.mark.parametrize("zero_m", [ZERO_M, -ZERO_M])
def test_two_heights_contradict_a_wrong_zero(zero_m: float) -> None:
    flight = reading(flown(maneuver={"way_points": UP_AND_DOWN}), zero_m)
    estimate = optimize(flight)
    found, result = estimate.range_errors, evaluate(estimate, flight)
    assert found is not None
    assert abs(found.zero_m - zero_m) < 3 * found.zero_std_m < 0.03
    assert estimate.status.startswith("sonar0: this flight contradicts what is stated of the height sensor")
    assert "its zero is" in estimate.status
    assert "its gain is" not in estimate.status
    assert "its gain and" in estimate.accuracy_basis
    assert "its zero" not in estimate.accuracy_basis
    assert estimate.scale_std is not None
    assert abs(result.scale - 1) < 3 * estimate.scale_std < 0.03
    assert result.nees is not None
    assert result.nees.pose.mean < result.nees.pose.upper95


@pytest.mark.slow
@pytest.mark.parametrize("world", [{}, HILL])
def test_a_height_sensor_that_is_exact_as_stated_stays(world: dict[str, object]) -> None:
    estimate = optimize(flown(maneuver={"way_points": UP_AND_DOWN}, world=world))
    assert estimate.range_errors is not None
    assert estimate.range_errors.zero_prior_std_m == 0
    assert "sonar0" not in estimate.status


@pytest.mark.slow
def test_steps_below_the_low_points_of_a_way_are_no_zero() -> None:
    higher = [[x, y, z + 0.1] for x, y, z in UP_AND_DOWN]
    estimate = optimize(flown(43, maneuver={"way_points": higher}, world=STEPS))
    assert estimate.range_errors is not None
    assert estimate.range_errors.zero_prior_std_m == 0
    assert estimate.status == "ok"


@pytest.mark.slow
def test_at_one_height_a_wrong_zero_is_named_as_taken_as_exact() -> None:
    """Lengths by the accelerometer agree with the wrong ones by chance; those of seed 0 contradict them."""
    estimate = optimize(reading(flown(1), ZERO_M))
    assert estimate.status == "ok"
    assert "its gain, its zero" in estimate.accuracy_basis
    assert "taken as exact" in estimate.accuracy_basis
