"""What no term of the catalogue is: said to be unknown, with the channel and the signal that show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism import criticise
from slam.simulation.healthy.flights import at_lower_rates, draw_vehicle, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

PLANS = (
    ["tilts of 15 deg to all four sides", "three speeds forward: 0.1, 0.2, 0.4"],
    ["reversing to the side at 0.2", "up to 2 m, hover, and back", "turn by 90 deg between pulses forward"],
)
LEVER_M = np.array([0.0, 0.0, 0.1])
TURNED_RAD = 0.07
LATE_S = 2.5e-3


def off_the_centre(flight):
    """With the IMU above the centre of turning: it feels each tilt begin and end."""
    imu = flight.imu
    # The gyro's own readings serve, for their noise is far below what tilts do.
    rate = np.column_stack([np.convolve(w, np.full(3, 1 / 3), mode="same") for w in imu.gyro_rad_s.T])
    felt = np.cross(np.gradient(rate, imu.stamps_s, axis=0), LEVER_M)
    felt += np.cross(rate, np.cross(rate, LEVER_M))
    return replace(flight, imu=replace(imu, accel_m_s2=imu.accel_m_s2 + felt))


def turned_flow(flight):
    """With the flow sensor turned about the vertical."""
    c, s = np.cos(TURNED_RAD), np.sin(TURNED_RAD)
    v_m_s = flight.velocity.v_m_s @ np.array([[c, -s], [s, c]])
    return replace(flight, velocity=replace(flight.velocity, v_m_s=v_m_s))


def steered_askew(stick):
    """The autopilot's axes are not the pilot's."""
    ahead, left = stick.values[:, 0], stick.values[:, 1]
    values = stick.values.copy()
    values[:, 0], values[:, 1] = ahead - 0.1 * left, left + 0.1 * ahead
    return replace(stick, values=values)


def sinking(stick):
    """What tilts takes from the lift."""
    values = stick.values.copy()
    values[:, 2] -= 0.6 * (values[:, 0] ** 2 + values[:, 1] ** 2)
    return replace(stick, values=values)


def late_attitude(flight):
    """With an attitude that was true a moment before its stamp."""
    return replace(flight, attitude=replace(flight.attitude, stamps_s=flight.attitude.stamps_s + LATE_S))


def same(what):
    return what


@pytest.mark.parametrize(
    ("obeyed", "read", "signs"),
    [
        pytest.param(same, off_the_centre, ["accel_x ~ pitching"], marks=pytest.mark.slow),
        pytest.param(sinking, same, ["force up ~ tilt2"], marks=pytest.mark.slow),
        pytest.param(steered_askew, same, ["force roll ~ stick_ahead", "force pitch ~ stick_left"],
            marks=pytest.mark.slow),
        pytest.param(same, turned_flow, ["velocity_y ~ ahead", "velocity_x ~ left"], marks=pytest.mark.slow),
        pytest.param(same, late_attitude, ["attitude late by 2.", "attitude late by 3."],
            marks=pytest.mark.slow),
    ],
    ids=["imu off the centre", "tilts lose lift", "sticks askew", "flow turned", "attitude late"],
)  # fmt: skip
def test_it_is_unknown_and_reported_with_its_channel(obeyed, read, signs):
    nominal = at_lower_rates(load_model("nominal"))
    vehicle = draw_vehicle(nominal, np.random.default_rng(5))
    flights = []
    for k, plan in enumerate(PLANS):
        stick = stick_for(plan)
        # The log has what the pilot gave.
        command = simulate_flight(vehicle, stick, 50 + k, maker=nominal).command
        flights.append(
            read(replace(simulate_flight(vehicle, obeyed(stick), 50 + k, maker=nominal), command=command))
        )
    found = criticise(flights)
    assert found.verdict == "unknown"
    assert any(sign in found.remainder for sign in signs)
    assert all(cause.probability <= 0.5 for cause in found.causes)


@pytest.mark.slow
def test_a_slow_attitude_beside_something_unknown_is_named():
    """A lag moves the mean of the readings: unlike more noise, no unknown motion looks like it."""
    model = at_lower_rates(load_model("nominal")).with_term("attitude_lag", tau=0.16)
    model = replace(model, vehicle=replace(model.vehicle, gain=1.2 * model.vehicle.gain))
    found = criticise([simulate_flight(model, stick_for(plan), seed) for seed, plan in enumerate(PLANS)])
    (lag,) = found.causes
    assert (found.verdict, lag.name) == ("named_with_remainder", "attitude_lag")
    assert lag.probability > 0.95
    assert found.remainder == "vehicle.gain out of range"
