"""Heading by coarse positions: as uncertain as they leave it, however many other readings there are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from slam.core.rotations import roll_pitch_yaw_of
from slam.inertial.filter_input import Adjustments, filter_input
from slam.inertial.instruments import InertialTrust
from slam.inertial.motion import filter_motion
from slam.inertial.start_heading import find_start_heading
from tests.slam.inertial.made_navigation import made_flight
from tests.slam.small_flight import gps_of

FIX_STD_M = 0.5


def heading_at_the_end(flight):
    """Error of the heading at the end, and its standard deviation; None where it is told as unknown."""
    trust = InertialTrust()
    heading = find_start_heading(flight, trust, 20.0)
    if heading is not None and not heading.is_known:
        return None
    inputs = filter_input(flight, trust, Adjustments(heading=heading))
    at_s = np.array([inputs.start_s, 19.0])
    states = filter_motion(inputs, at_s).smoothed
    true = roll_pitch_yaw_of(flight.truth.w_T_b[1900][None, :3, :3])[0, 2]
    error = np.angle(np.exp(1j * (roll_pitch_yaw_of(states.w_T_b[1:, :3, :3])[0, 2] - true)))
    return float(error), float(np.sqrt(states.covariances[1, 2, 2]))


def flown(seed):
    flight = made_flight(seed)
    return replace(flight, gps=gps_of(flight, FIX_STD_M, seed))


def test_more_readings_of_the_imu_do_not_tell_the_heading():
    """Each reading had added information, so that five times as many halved the standard deviation."""
    flight = replace(flown(0), attitude=None)
    imu = flight.imu
    fewer = replace(
        imu,
        stamps_s=imu.stamps_s[::5],
        gyro_rad_s=imu.gyro_rad_s[::5],
        accel_m_s2=imu.accel_m_s2[::5],
    )
    (_, std), (_, std_of_fewer) = heading_at_the_end(flight), heading_at_the_end(replace(flight, imu=fewer))
    assert std == pytest.approx(std_of_fewer, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("without", [(), ("attitude",), ("velocity",)])
def test_the_heading_errs_as_its_standard_deviation_tells(without):
    whitened = []
    for seed in range(10):
        flight = flown(seed)
        # The yaw that a vehicle reports has any zero, of which the filter assumes 0.3 rad.
        zero_rad = np.random.default_rng(seed).normal(0, 0.3)
        angles = flight.attitude.roll_pitch_yaw_rad + [0.0, 0.0, zero_rad]
        flight = replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles))
        found = heading_at_the_end(replace(flight, **dict.fromkeys(without)))
        whitened += [] if found is None else [found[0] / found[1]]
    assert len(whitened) > 4
    # The fixes count with errors that last 5 s, and these are independent: errors are smaller than told.
    assert np.sum(np.square(whitened)) < chi2.ppf(0.999, len(whitened))
