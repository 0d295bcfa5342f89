"""An attitude and a gyro whose turns contradict each other are told with the likely cause."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.core.flight import Flight
from slam.inertial.attitude_check import attitude_contradictions
from slam.inertial.filter_input import filter_input
from slam.inertial.navigate import navigate
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe


@pytest.fixture(scope="module")
def flight() -> Flight:
    """A calm flight at one heading."""
    return simulate(replace(load_recipe("square"), camera=None), seed=5)


def angles(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Flight], Flight]:
    """The flight with other angles of the attitude."""

    def changed(flight: Flight) -> Flight:
        assert flight.attitude is not None
        read = change(flight.attitude.roll_pitch_yaw_rad)
        return replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=read))

    return changed


def mounted(axis: str, angle_deg: float) -> Callable[[Flight], Flight]:
    """The flight with an IMU that is turned on the vehicle, without a word of it."""
    turn = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()

    def changed(flight: Flight) -> Flight:
        assert flight.imu is not None
        gyro, accel = flight.imu.gyro_rad_s @ turn.T, flight.imu.accel_m_s2 @ turn.T
        return replace(flight, imu=replace(flight.imu, gyro_rad_s=gyro, accel_m_s2=accel))

    return changed


def gyro(factors: object) -> Callable[[Flight], Flight]:
    """The flight with other gains of the gyro."""

    def changed(flight: Flight) -> Flight:
        assert flight.imu is not None
        return replace(flight, imu=replace(flight.imu, gyro_rad_s=flight.imu.gyro_rad_s * factors))

    return changed


WRONG = {
    "yaw": (angles(lambda a: a * [1, 1, -1]), "yaw disagrees with the gyro"),
    "pitch": (angles(lambda a: a * [1, -1, 1]), "pitch disagrees with the gyro"),
    "swapped": (angles(lambda a: a[:, [1, 0, 2]]), "roll reads the pitch that the gyro gives"),
    "reversed": (angles(lambda a: a[:, ::-1]), "yaw reads the roll that the gyro gives"),
    "stuck": (angles(np.zeros_like), "attitude0 does not change its roll, pitch and yaw"),
    "stuck roll": (angles(lambda a: a * [0, 1, 1]), "attitude0 does not change its roll while"),
    "quarter turn": (mounted("z", 90), "check the axes and signs of both, and T_BS of imu0"),
    "half turn": (mounted("z", 180), "check the axes and signs of both, and T_BS of imu0"),
    "eighth turn": (mounted("z", 45), "about its z axis beside attitude0"),
    "leans": (mounted("x", -30), "about its x axis beside attitude0"),
    "gyro turned over": (gyro([1, 1, -1]), "yaw disagrees with the gyro"),
    "gyro twice": (gyro(2.0), "roll of attitude0 changes by 0.5"),
    "gyro half": (gyro(0.5), "what imu0's gyro shows"),
}


def test_a_healthy_flight_is_not_told(flight: Flight):
    assert attitude_contradictions(flight) == []
    assert attitude_contradictions(angles(lambda a: a + [0.02, -0.03, 1.5])(flight)) == []
    assert attitude_contradictions(gyro(1.2)(flight)) == []
    assert attitude_contradictions(mounted("y", 5)(flight)) == []


@pytest.mark.parametrize("kind", WRONG)
def test_contradictions_are_told_with_their_cause(flight: Flight, kind: str):
    damage, words = WRONG[kind]
    assert words in "; ".join(map(str, attitude_contradictions(damage(flight))))


def test_nothing_is_told_where_nothing_turns_or_is_compared(flight: Flight):
    assert flight.imu is not None
    assert flight.attitude is not None
    noise = 1e-2 * np.random.default_rng(0).normal(size=flight.imu.gyro_rad_s.shape)
    still = replace(flight, imu=replace(flight.imu, gyro_rad_s=noise))
    assert attitude_contradictions(angles(np.zeros_like)(still)) == []
    assert attitude_contradictions(replace(flight, imu=None)) == []
    assert attitude_contradictions(replace(flight, attitude=None)) == []


@pytest.mark.slow
def test_the_status_of_an_estimate_tells_it(flight: Flight, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("slam.inertial.navigate.identify_noise", lambda flight, *_: filter_input(flight))
    estimate = navigate(angles(lambda a: a * [1, 1, -1])(flight), rate_hz=2.0).estimate
    assert estimate.status.startswith("attitude0 and imu0: yaw disagrees with the gyro")


def stuck_later(read):
    return np.where((np.arange(len(read)) > len(read) // 3)[:, None], read[len(read) // 3], read)


@pytest.mark.parametrize("change", [np.zeros_like, stuck_later])
def test_angles_that_a_moving_vehicle_keeps_are_told_without_a_gyro(flight: Flight, change):
    assert flight.velocity is not None
    by_velocity = replace(flight, imu=None)
    assert "keeps every angle" in str(attitude_contradictions(angles(change)(by_velocity)))
    stands = replace(by_velocity, velocity=replace(flight.velocity, v_m_s=0 * flight.velocity.v_m_s))
    assert attitude_contradictions(angles(change)(stands)) == []


@pytest.mark.parametrize("missing", [(), ("imu",)])
def test_a_vehicle_that_hangs_upside_down_is_told(flight: Flight, missing):
    damaged = replace(angles(lambda a: a + [3.0, 0.0, 0.0])(flight), **dict.fromkeys(missing))
    assert "upside down" in str(attitude_contradictions(damaged))
