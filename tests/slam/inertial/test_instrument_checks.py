"""Instruments that no comparison may pass in silence, in the status of the whole check."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.inertial.instrument_checks import checked
from slam.inertial.instruments import InertialTrust
from tests.slam.inertial.made_navigation import made_flight, without

TURNED = {
    "upside down": np.array([1.0, -1.0, -1.0]),
    "on its side": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}


def turned(imu, turn):
    matrix = np.diag(turn) if turn.ndim == 1 else turn
    return replace(imu, gyro_rad_s=imu.gyro_rad_s @ matrix.T, accel_m_s2=imu.accel_m_s2 @ matrix.T), matrix


@pytest.mark.parametrize("turn", TURNED.values(), ids=TURNED)
def test_a_mount_of_the_imu_that_nobody_states_is_in_the_status(turn):
    flight = without(made_flight(0), "attitude")
    imu, matrix = turned(flight.imu, turn)
    _, reasons = checked(replace(flight, imu=imu), InertialTrust())
    assert any("imu0" in str(line) and "gravity" in str(line) for line in reasons)
    b_T_s = np.eye(4)
    b_T_s[:3, :3] = matrix.T
    _, reasons = checked(replace(flight, imu=replace(imu, b_T_s=b_T_s)), InertialTrust())
    assert reasons == []
