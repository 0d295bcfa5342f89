"""A constant error of the velocity is told by the drag in the accelerometer where no wind explains it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.flight import Flight
from slam.core.streams import Gps
from slam.inertial.drag_check import air_velocity, drag_contradiction
from slam.inertial.filter_input import filter_input
from slam.inertial.instruments import InertialTrust
from slam.inertial.navigate import navigate
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe


@pytest.fixture(scope="module")
def flight() -> Flight:
    """A flight at one heading."""
    return simulate(replace(load_recipe("square"), camera=None), seed=5)


def offset(flight: Flight, forward_m_s: float, left_m_s: float) -> Flight:
    assert flight.velocity is not None
    v_m_s = flight.velocity.v_m_s + [forward_m_s, left_m_s]
    return replace(flight, velocity=replace(flight.velocity, v_m_s=v_m_s))


def test_the_drag_vanishes_in_still_air(flight: Flight):
    air = air_velocity(flight)
    assert air is not None
    assert np.abs(air.v_m_s).max() < 0.1
    assert air.least_m_s < 0
    assert drag_contradiction(flight) is None


@pytest.mark.parametrize("recipe", ["hover", "horizontal_square", "vertical_square"])
@pytest.mark.parametrize("error", [(20.0, 0.0), (0.0, -20.0)])
def test_a_constant_error_is_told_even_if_hardly_anything_moves(recipe: str, error: tuple[float, float]):
    flight = simulate(replace(load_recipe(recipe), camera=None), seed=1)
    assert drag_contradiction(flight) is None
    air = air_velocity(offset(flight, *error))
    assert air is not None
    assert air.v_m_s == pytest.approx(error, abs=0.1)
    found = drag_contradiction(offset(flight, *error))
    assert found is not None
    assert found.is_wind_excluded
    assert "not to be trusted" in str(found.line)


def test_what_a_wind_may_be_is_a_warning_that_names_the_manoeuvre(flight: Flight):
    found = drag_contradiction(offset(flight, 5.0, 0.0))
    assert found is not None
    assert "wind blew with 5 m/s forward" in str(found.line)
    assert "a flight that turns" in str(found.line)
    assert not found.is_wind_excluded


def test_nothing_is_told_where_there_is_nothing_to_compare(flight: Flight):
    off = offset(flight, 20.0, 0.0)
    imu, velocity = off.imu, off.velocity
    assert imu is not None
    assert velocity is not None
    blind = replace(velocity, v_m_s=np.full_like(velocity.v_m_s, np.nan))
    early = velocity.stamps_s < velocity.stamps_s[0] + 3.5
    short = replace(velocity, stamps_s=velocity.stamps_s[early], v_m_s=velocity.v_m_s[early])
    for lacking in (
        replace(off, imu=None),
        replace(off, velocity=None),
        replace(off, velocity=blind),
        replace(off, velocity=short),
        replace(off, imu=replace(imu, accel_m_s2=np.full_like(imu.accel_m_s2, np.nan))),
    ):
        assert drag_contradiction(lacking) is None


def test_positions_tell_a_wind(flight: Flight):
    fix = np.zeros(2)
    gps = Gps(np.arange(2.0), fix, fix, fix, (1.0, 1.0, 1.0))
    assert drag_contradiction(replace(offset(flight, 20.0, 0.0), gps=gps)) is None


@pytest.mark.slow
@pytest.mark.parametrize(("error_m_s", "in_status"), [(0.0, False), (20.0, True)])
def test_the_status_of_an_estimate_tells_it(
    flight: Flight, error_m_s: float, in_status: bool, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("slam.inertial.navigate.identify_noise", lambda flight, *_: filter_input(flight))
    estimate = navigate(offset(flight, error_m_s, 0.0), InertialTrust(), rate_hz=2.0).estimate
    # The small turns of a hovering vehicle show so large an error too.
    assert ("velocity0 has a constant error" in estimate.status) is in_status
    assert (estimate.status == "ok") is not in_status
