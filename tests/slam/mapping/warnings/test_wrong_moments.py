"""Pictures of other moments than their stamps say are named; noise, gains, biases and delays are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.core.flight import Flight
from slam.mapping.warnings.contradictions import contradictions
from slam.mapping.warnings.motions import KeyframeSteps, StepMotion
from slam.mapping.warnings.wrong_moments import GATE_SIGMAS, WrongMoments, deviations, motion_warnings
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe

STEP_S = 0.3


@pytest.fixture(scope="module")
def flight() -> Flight:
    return simulate(replace(load_recipe("figure_eight_heights"), camera=None), seed=4)


def told(flight: Flight, order: np.ndarray | None = None, late_s: float = 0.0) -> list[str]:
    """Lines about the true way as a map, its poses in some order."""
    assert flight.truth is not None
    stamps_s = np.arange(1.0, flight.truth.stamps_s[-1] - 1.0, STEP_S)
    poses = flight.truth.w_T_b[np.searchsorted(flight.truth.stamps_s, stamps_s + late_s)]
    if order is not None:
        poses[: len(order)] = poses[order]
    found = WrongMoments.of(KeyframeSteps.of(flight, stamps_s, poses, True))
    return list(map(str, found.lines(_names(stamps_s))))


def test_a_healthy_flight_has_no_wrong_moment(flight: Flight):
    assert told(flight) == []


def test_pictures_in_another_order_for_a_while_are_named(flight: Flight):
    order = np.arange(60)
    order[20:32] = np.random.default_rng(0).permutation(order[20:32])
    (line,) = told(flight, order)
    first, last = (int(part.split("_")[1].split(" ")[0]) for part in line.split(" the map")[0].split(" to "))
    assert 18 <= first <= 22
    assert 29 <= last <= 33
    assert "in another order" in line


def test_neither_noise_nor_gain_bias_or_delay_is_a_wrong_moment(flight: Flight):
    rng = np.random.default_rng(1)
    imu, flow, attitude = flight.imu, flight.velocity, flight.attitude
    worn = replace(
        flight,
        imu=replace(imu, gyro_rad_s=1.05 * imu.gyro_rad_s + [0.05, -0.02, 0.03]),
        velocity=replace(flow, v_m_s=0.75 * flow.v_m_s + 0.05 * rng.standard_t(3, flow.v_m_s.shape)),
        attitude=replace(attitude, roll_pitch_yaw_rad=attitude.roll_pitch_yaw_rad + [0.03, -0.02, 0.5]),
    )
    assert told(worn, late_s=0.04) == []


@pytest.mark.parametrize("odd", [[0], [60], [60, 61], [20, 90]])
def test_keyframes_at_another_height_are_named(flight: Flight, odd: list[int]):
    """Pictures of another zoom put the vehicle a third higher, in which no instrument follows."""
    stamps_s, poses = _way(flight)
    poses[odd, 2, 3] *= 4 / 3
    found = WrongMoments.of(KeyframeSteps.of(flight, stamps_s, poses, True))
    lines = list(map(str, found.lines(_names(stamps_s))))
    assert len(lines) == (1 if odd != [20, 90] else 2)
    assert all(f"from picture_{max(k - 1, 0)} to" in line for k, line in zip(odd, lines, strict=False))
    assert all("than imu0 and sonar0: " in line and "of another camera or zoom" in line for line in lines)
    assert contradictions(found.others) == []


def test_a_false_match_that_only_the_gyro_contradicts_is_named_and_not_the_gyro(flight: Flight):
    """Over a floor that looks the same from the other side, the map turns half way round in one step."""
    stamps_s, poses = _way(flight)
    poses[60:, :3, :3] = Rotation.from_euler("z", np.pi).as_matrix() @ poses[60:, :3, :3]
    by_gyro = replace(flight, attitude=None, velocity=None, sonar=None)
    steps = KeyframeSteps.of(by_gyro, stamps_s, poses, True)
    names = _names(stamps_s)
    (line,) = map(str, motion_warnings(steps, names))
    assert line.startswith("cam0: from picture_59 to picture_60 the map moves otherwise than imu0")
    assert line.count("imu0") == 2
    mirrored = replace(by_gyro.imu, gyro_rad_s=-by_gyro.imu.gyro_rad_s)
    wrong = KeyframeSteps.of(replace(by_gyro, imu=mirrored), stamps_s, _way(flight)[1], True)
    (line,) = map(str, motion_warnings(wrong, names))
    assert line.startswith("imu0 (gyro): opposite in sign")


def test_what_stands_on_the_floor_is_no_wrong_moment(flight: Flight):
    """Ranges step where the vehicle does not."""
    over = (flight.sonar.stamps_s % 5.0) < 1.0
    boxes = replace(flight, sonar=replace(flight.sonar, range_m=flight.sonar.range_m - 0.3 * over))
    assert told(boxes) == []


def test_one_instrument_alone_is_not_believed(flight: Flight):
    gyro = flight.imu.gyro_rad_s.copy()
    at = np.searchsorted(flight.imu.stamps_s, [8.0, 9.0])
    gyro[at[0] : at[1]] += 1.0
    broken = replace(flight, imu=replace(flight.imu, gyro_rad_s=gyro))
    steps = KeyframeSteps.of(broken, *_way(broken), True)
    assert deviations(steps.motions[0]).max() > GATE_SIGMAS
    assert told(broken) == []


def test_a_step_that_lasts_longer_may_be_off_by_more() -> None:
    """Most steps of a start from the ground are short; an error of the velocity lasts."""
    rng = np.random.default_rng(0)
    lasts_s = np.array([0.1] * 20 + [1.2] * 2)
    made = rng.normal(0, 0.01, (22, 2))
    slow = made + rng.normal(0, 0.01, (22, 2)) * lasts_s[:, None]
    motion = StepMotion("velocity0", slow, made, lasts_s, is_way=True)
    assert deviations(motion).max() < GATE_SIGMAS
    # The error of a step of usual length is judged as before.
    wrong = replace(motion, read=slow + np.eye(22, 2) * 0.1)
    assert deviations(wrong)[0] > GATE_SIGMAS


def _names(stamps_s: np.ndarray) -> list[str]:
    return [f"picture_{k}" for k in range(len(stamps_s))]


def _way(flight: Flight) -> tuple[np.ndarray, np.ndarray]:
    stamps_s = np.arange(1.0, flight.truth.stamps_s[-1] - 1.0, STEP_S)
    return stamps_s, flight.truth.w_T_b[np.searchsorted(flight.truth.stamps_s, stamps_s)]
