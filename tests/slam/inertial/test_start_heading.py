"""Heading at the start by positions and accelerometer alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from slam.core.flight import Flight
from slam.core.streams import Gps, Imu
from slam.inertial.filter_input import Adjustments, filter_input
from slam.inertial.instruments import InertialTrust
from slam.inertial.navigate import _unobserved
from slam.inertial.start_heading import find_start_heading

M_PER_DEG = 111_195.0


def flown(heading_rad, amplitude_m):
    """15 s with a nose at one heading, swaying along and across it, with IMU and GPS; no attitude."""
    rng = np.random.default_rng(0)
    fine_s, t, fix_s = np.arange(-0.5, 15.5, 0.02), np.arange(0, 15, 0.01), np.arange(0, 15, 0.5)
    grown = amplitude_m * np.clip(fine_s / 5, 0, 1) ** 2 * (3 - 2 * np.clip(fine_s / 5, 0, 1))
    path = CubicSpline(
        fine_s, np.column_stack([grown * np.sin(fine_s), grown * np.sin(0.7 * fine_s)] + [0 * fine_s])
    )
    up = path(fine_s, 2) + [0, 0, 9.80665]
    up /= np.linalg.norm(up, axis=1)[:, None]
    nose = np.tile([np.cos(heading_rad), np.sin(heading_rad), 0.0], (len(up), 1))
    left = np.cross(up, nose)
    left /= np.linalg.norm(left, axis=1)[:, None]
    R = np.stack([np.cross(left, up), left, up], axis=-1)
    turn = RotationSpline(fine_s, Rotation.from_matrix(R))
    force = turn(t).inv().apply(path(t, 2) + [0, 0, 9.80665])
    imu = Imu(
        t, turn(t, 1) + rng.normal(0, 0.005, (1500, 3)), force + rng.normal(0, 0.1, (1500, 3)), 5e-4, 0.01
    )
    east, north, _ = (path(fix_s) + rng.normal(0, 0.3, (30, 3))).T
    latitude = 47 + north / M_PER_DEG
    longitude = 8 + east / M_PER_DEG / np.cos(np.radians(47))
    return Flight("f", imu=imu, gps=Gps(fix_s, latitude, longitude, np.full(30, 400.0), (0.5, 0.5, 1.0)))


@pytest.mark.parametrize("heading_deg", [100, pytest.param(180, marks=pytest.mark.slow)])
def test_heading_is_the_most_likely_of_those_tried(heading_deg):
    found = find_start_heading(flown(np.radians(heading_deg), 10.0), InertialTrust(), 120.0)
    assert found.is_known
    off = np.degrees(np.angle(np.exp(1j * (found.yaw_rad - np.radians(heading_deg)))))
    assert abs(off) < 10


def test_heading_of_a_vehicle_that_hovers_is_told_as_unknown():
    flight = flown(1.0, 0.0)
    found = find_start_heading(flight, InertialTrust(), 120.0)
    assert not found.is_known
    inputs = filter_input(flight, InertialTrust(), Adjustments(heading=found))
    assert inputs.start.yaw_std_rad == pytest.approx(np.pi / np.sqrt(3))
    assert any("heading is unknown" in str(line) for line in _unobserved(inputs, 1.0))


def test_heading_is_not_searched_where_a_yaw_or_no_position_is_measured():
    flight = flown(0.0, 0.0)
    assert find_start_heading(Flight("f", imu=flight.imu), InertialTrust(), 120.0) is None
