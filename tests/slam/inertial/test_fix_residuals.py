"""Fixes that the other instruments contradict are in the status; fixes that err as they state are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.inertial.filter_input import filter_input
from slam.inertial.fix_residuals import fix_contradiction
from slam.inertial.instruments import InertialTrust
from slam.inertial.motion import filter_motion
from slam.inertial.navigate import navigate
from tests.slam.inertial.made_navigation import made_flight
from tests.slam.small_flight import gps_of

FIX_STD_M = 0.05


def flown(seed):
    flight = made_flight(seed)
    return replace(flight, gps=gps_of(flight, FIX_STD_M, seed))


def told(flight, rate_hz=5.0):
    trust = InertialTrust(gps_floor_m=FIX_STD_M)
    inputs = filter_input(flight, trust)
    at_s = np.arange(inputs.start_s, inputs.end_s, 1 / rate_hz)
    return fix_contradiction(inputs, filter_motion(inputs, at_s).smoothed, at_s, trust)


def late(flight):
    return replace(flight, gps=replace(flight.gps, stamps_s=flight.gps.stamps_s + 3.0))


def stuck(flight):
    gps = flight.gps
    held = np.minimum(np.arange(len(gps.stamps_s)), len(gps.stamps_s) // 2)
    return replace(
        flight,
        gps=replace(gps, latitude_deg=gps.latitude_deg[held], longitude_deg=gps.longitude_deg[held]),
    )


def mirrored(flight):
    gps = flight.gps
    return replace(flight, gps=replace(gps, longitude_deg=-gps.longitude_deg))


@pytest.mark.parametrize("seed", range(4))
def test_fixes_that_err_as_they_state_are_no_contradiction(seed):
    assert told(flown(seed)) is None


@pytest.mark.parametrize("wrong", [late, stuck, mirrored])
def test_fixes_of_another_time_or_place_are_told(wrong):
    line = told(wrong(flown(1)))
    assert "gps0 and the other instruments contradict each other" in str(line)


def test_poses_too_far_apart_show_nothing():
    assert told(late(flown(1)), rate_hz=0.3) is None


@pytest.mark.parametrize("seed", range(3))
def test_a_receiver_that_holds_a_place_for_a_while_moves_no_track(seed):
    flight = flown(seed)
    gps = flight.gps
    count = len(gps.stamps_s)
    held = np.arange(count)
    held[count // 3 : 2 * count // 3] = count // 3
    wrong = replace(
        gps, latitude_deg=gps.latitude_deg[held], longitude_deg=gps.longitude_deg[held],
    )  # fmt: skip
    trust = InertialTrust(gps_floor_m=FIX_STD_M)
    found, healthy = (navigate(replace(flight, gps=each), trust).estimate for each in (wrong, gps))
    assert any("repeat the place before" in str(line) for line in found.warnings)
    apart_m = np.linalg.norm((found.w_T_b - healthy.w_T_b)[:, :2, 3], axis=1)
    std_m = np.sqrt(np.trace(found.covariances[:, 3:5, 3:5], axis1=1, axis2=2))
    assert np.sqrt(np.mean((apart_m / std_m) ** 2)) < 1.5
