"""A gyro in another unit, and quaternions in another order, are refused with what to do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend.measurements import GRAVITY_M_S2
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.streams import Imu, Truth
from slam.io.flight_folder import read_flight, write_flight
from slam.io.gravity_checks import check_gyro_by_gravity, check_quaternion_order
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe

PATH = Path("imu0/data.csv")


@pytest.fixture(scope="module", params=["square", pytest.param("pulses_010", marks=pytest.mark.slow)])
def flight(request: pytest.FixtureRequest) -> Flight:
    return simulate(replace(load_recipe(request.param), camera=None), seed=2)


def test_a_healthy_flight_is_read_unchanged(flight: Flight, tmp_path: Path):
    write_flight(flight, tmp_path / "flight")
    found = read_flight(tmp_path / "flight")
    assert np.array_equal(found.imu.gyro_rad_s, flight.imu.gyro_rad_s)
    assert np.array_equal(found.imu.accel_m_s2, flight.imu.accel_m_s2)
    np.testing.assert_allclose(found.truth.w_T_b, flight.truth.w_T_b, rtol=0, atol=1e-12)
    assert not [line for line in found.warnings if "imu0" in line or "groundtruth" in line]


def test_a_gyro_in_degrees_is_refused_without_an_attitude(flight: Flight):
    degrees = replace(flight.imu, gyro_rad_s=np.degrees(flight.imu.gyro_rad_s))
    with pytest.raises(InputError, match=r"but gravity is 9\.8.*in deg/s\?"):
        check_gyro_by_gravity(degrees, PATH)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_gyro_in_degrees_is_refused_in_a_quiet_hover(seed: int):
    """Nothing but the small corrections of the hover turns gravity away."""
    imu = simulate(replace(load_recipe("hover"), camera=None), seed).imu
    check_gyro_by_gravity(imu, PATH)
    with pytest.raises(InputError, match=r"in deg/s\?"):
        check_gyro_by_gravity(replace(imu, gyro_rad_s=np.degrees(imu.gyro_rad_s)), PATH)


@pytest.mark.parametrize("gain", [0.96, pytest.param(1.0, marks=pytest.mark.slow), 1.04])
@pytest.mark.parametrize("bank_deg", [15.0, pytest.param(35.0, marks=pytest.mark.slow), 50.0])
def test_a_banked_turn_of_a_healthy_vehicle_is_read_unchanged(bank_deg: float, gain: float, tmp_path: Path):
    """The vehicle circles at 8 m/s: it presses with more than gravity, always along its own vertical."""
    stamps_s, bank_rad = np.arange(0, 60, 0.01), np.radians(bank_deg)
    turn = GRAVITY_M_S2 * np.tan(bank_rad) / 8.0 * np.array([0, np.sin(bank_rad), np.cos(bank_rad)])
    force = gain * np.array([0, 0, GRAVITY_M_S2 / np.cos(bank_rad)])
    shape = (len(stamps_s), 1)
    imu = Imu(stamps_s, np.tile(turn, shape), np.tile(force, shape), 1e-3, 1e-2)
    write_flight(Flight("turn", imu=imu), tmp_path / "turn")
    found = read_flight(tmp_path / "turn")
    assert np.array_equal(found.imu.gyro_rad_s, imu.gyro_rad_s)
    assert not [line for line in found.warnings if "imu0" in line and "gravity" in line]


def in_another_order(truth: Truth) -> Truth:
    """Return a truth whose quaternions were written as x y z w and read as w x y z."""
    mixed = truth.w_T_b.copy()
    as_written = Rotation.from_matrix(mixed[:, :3, :3]).as_quat(scalar_first=False)
    mixed[:, :3, :3] = Rotation.from_quat(as_written, scalar_first=True).as_matrix()
    return replace(truth, w_T_b=mixed)


def refusal_of(truth: Truth, imu: Imu) -> str:
    """Return why the order of the quaternions is refused; empty where it is not."""
    try:
        check_quaternion_order(truth, imu, PATH)
    except InputError as refused:
        return str(refused)
    return ""


@pytest.mark.parametrize("yaw_rad", [0.0, 2.5])
def test_quaternions_in_another_order_are_refused(flight: Flight, yaw_rad: float):
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", yaw_rad).as_matrix()
    truth = replace(flight.truth, w_T_b=turn @ flight.truth.w_T_b)
    assert not refusal_of(truth, flight.imu)
    assert "write quaternions as w x y z (are they x y z w?)" in refusal_of(
        in_another_order(truth), flight.imu
    )


@pytest.mark.parametrize("sign", [1, -1])
def test_the_sign_of_gravity_is_no_fault_of_the_truth(sign: int):
    """The vehicle mostly pitches: quaternions in the other order explain the turns about that axis too."""
    stamps_s = np.arange(0, 10, 0.02)
    w_R_b = Rotation.from_euler("YX", np.outer(np.sin(stamps_s), [0.2, 0.1]))
    w_T_b = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    w_T_b[:, :3, :3] = w_R_b.as_matrix()
    force = w_R_b.inv().apply([0, 0, sign * GRAVITY_M_S2])
    gyro = np.append((w_R_b[:-1].inv() * w_R_b[1:]).as_rotvec() / 0.02, [[0, 0, 0]], axis=0)
    truth, imu = Truth(stamps_s, w_T_b), Imu(stamps_s, gyro, force, 1e-3, 1e-2)
    assert not refusal_of(truth, imu)
    assert refusal_of(in_another_order(truth), imu)


def test_tilted_gravity_shows_signs_of_the_gyro():
    """The vehicle rolls by a radian to both sides: with the sign turned, gravity leans by twice as much."""
    flight = simulate(replace(load_recipe("hover"), camera=None), seed=2)
    stamps_s = flight.imu.stamps_s
    roll_rad = np.sin(2 * np.pi * 0.2 * stamps_s)
    force = 9.81 * np.column_stack([np.zeros_like(roll_rad), np.sin(roll_rad), np.cos(roll_rad)])
    gyro = np.column_stack([np.gradient(roll_rad, stamps_s), np.zeros((len(roll_rad), 2))])
    rolling = replace(flight.imu, gyro_rad_s=gyro, accel_m_s2=force)
    check_gyro_by_gravity(rolling, PATH)
    with pytest.raises(InputError, match="turn its signs"):
        check_gyro_by_gravity(replace(rolling, gyro_rad_s=-gyro), PATH)


def test_the_reader_refuses_both(tmp_path: Path):
    flight = simulate(replace(load_recipe("square"), camera=None), seed=2)
    degrees = replace(flight.imu, gyro_rad_s=np.degrees(flight.imu.gyro_rad_s))
    write_flight(replace(flight, imu=degrees, attitude=None), tmp_path / "degrees")
    with pytest.raises(InputError, match="convert it to rad/s"):
        read_flight(tmp_path / "degrees")
