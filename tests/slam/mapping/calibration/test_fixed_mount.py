"""A mount that is held, and a floor that counts as level: how uncertain they are, and what that makes of the
poses."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend import se3
from backend.inertial_scale.scale import UNKNOWN_SLOPE, FloorSlope
from backend.measurements import GRAVITY_M_S2
from slam import optimize
from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.mapping.calibration.attitude_floor_tilt import AttitudeFloorTilt
from slam.mapping.calibration.fixed_mount import (
    fixed_mount_covariance,
    level_floor_covariance,
    level_floor_displacements,
    mount_displacements,
)
from slam.mapping.calibration.inertial_scale import AccelerometerScale
from tests.slam.mapping.calibration.test_attitude_floor_tilt import askew
from tests.slam.small_flight import flown


def leaning(forward_rad: float, left_rad: float) -> AttitudeFloorTilt:
    lean = np.array([forward_rad, left_rad])
    return AttitudeFloorTilt(lean, lean, 1e-4, 1e-4, 1e-3)


def test_the_mount_has_its_share_of_the_lean() -> None:
    """On average over pairs of equal normal errors, and where all of the lean is the mount's."""
    rng = np.random.default_rng(0)
    mount, zero = rng.normal(0, 0.03, (2, 20_000, 2))
    lean = mount + zero
    told = np.array([fixed_mount_covariance(leaning(y, -x), None) for x, y in lean])
    assert np.mean(np.linalg.trace(told)) == pytest.approx(np.mean((mount**2).sum(axis=1)), rel=0.03)
    error = np.array([0.03, -0.04])
    told_of_it = fixed_mount_covariance(leaning(error[1], -error[0]), None)
    assert error @ np.linalg.solve(told_of_it, error) == pytest.approx(8 / 3, rel=1e-3)


def test_three_errors_share_a_lean() -> None:
    """Mount and slope together err as much as if their shares were independent."""
    rng = np.random.default_rng(0)
    mount, slope, zero = rng.normal(0, 0.03, (3, 20_000, 2))
    lean = mount + slope + zero
    told = np.array([fixed_mount_covariance(leaning(y, -x), None, causes=3) for x, y in lean])
    assert np.mean(np.linalg.trace(told)) == pytest.approx(np.mean((mount**2).sum(axis=1)), rel=0.03)
    assert np.mean(np.linalg.trace(2 * told)) == pytest.approx(
        np.mean(((mount + slope) ** 2).sum(axis=1)), rel=0.03
    )


def test_a_lean_by_chance_is_no_mount() -> None:
    noise = replace(leaning(0.01, 0.0), body_std=0.01)
    assert not fixed_mount_covariance(noise, None).any()


def test_an_exact_mount_is_believed_until_a_clear_lean_contradicts_it() -> None:
    vague, clear = leaning(3e-4, 0.0), leaning(5e-4, 0.0)
    assert fixed_mount_covariance(vague, None).any()
    assert not fixed_mount_covariance(vague, None, stated_exact=True).any()
    np.testing.assert_array_equal(
        fixed_mount_covariance(clear, None, stated_exact=True), fixed_mount_covariance(clear, None)
    )


def by_inertia(
    forward_rad: float, std_rad: float, beside_offset: FloorSlope = UNKNOWN_SLOPE
) -> AccelerometerScale:
    offset, std = (GRAVITY_M_S2 * np.array([x, 0.0, 0.0]) for x in (forward_rad, std_rad))
    found = SimpleNamespace(
        level_floor_offset_m_s2=offset,
        level_floor_offset_std_m_s2=std,
        slope_without_offset=FloorSlope((forward_rad, 0.0), std_rad),
        slope=beside_offset,
    )
    return cast("AccelerometerScale", SimpleNamespace(found=found))


def test_a_vague_accelerometer_limits_a_clear_lean_of_the_attitude_by_its_noise_alone() -> None:
    clear = leaning(0.05, 0.0)
    alone, vague = (fixed_mount_covariance(clear, each) for each in (None, by_inertia(0.0, 0.02)))
    assert 0.1 * alone[1, 1] < vague[1, 1] < 0.5 * alone[1, 1]
    sharp = fixed_mount_covariance(clear, by_inertia(1e-4, 1e-4))
    assert sharp[1, 1] < 1e-3 * alone[1, 1]
    both = fixed_mount_covariance(clear, by_inertia(0.05, 1e-4), stated_exact=True)
    assert both[1, 1] == pytest.approx(alone[1, 1], rel=1e-3)
    assert not fixed_mount_covariance(clear, by_inertia(0.0, 0.02), stated_exact=True).any()


def test_a_lean_forward_is_a_rotation_about_left() -> None:
    told = fixed_mount_covariance(leaning(0.05, 0.0), None)
    assert told[1, 1] == pytest.approx(3 * told[0, 0])
    assert 2 * np.sqrt(told[1, 1]) > 0.05
    assert not fixed_mount_covariance(None, None).any()


def test_the_body_turns_about_the_camera() -> None:
    b_T_c = np.eye(4)
    b_T_c[:3, 3] = 0.1, -0.2, 0.3
    turned = b_T_c.copy()
    step = np.array([2e-6, -1e-6, 0.0])
    turned[:3, :3] = Rotation.from_rotvec(step).as_matrix() @ b_T_c[:3, :3]
    error = se3.log((b_T_c @ se3.inverse(turned))[None])[0]
    told = mount_displacements(b_T_c, np.outer(step[:2], step[:2]))
    assert told @ told.T == pytest.approx(np.outer(error, error), abs=1e-16)


def test_a_lean_that_does_not_turn_with_the_body_may_be_a_slope() -> None:
    lean, inertial = leaning(0.02, 0.0), by_inertia(0.02, 1e-4)
    alone = level_floor_covariance(lean, None)
    np.testing.assert_array_equal(alone, fixed_mount_covariance(lean, None))
    assert not level_floor_covariance(replace(lean, world_std=1e-2), None).any()
    assert level_floor_covariance(lean, by_inertia(1e-4, 1e-4))[1, 1] < 1e-3 * alone[1, 1]
    for tilt in (lean, None):
        assert level_floor_covariance(tilt, inertial)[1, 1] == pytest.approx(alone[1, 1], rel=1e-3)
    turning = by_inertia(0.02, 1e-4, beside_offset=FloorSlope((1e-4, 0.0), 1e-4))
    assert level_floor_covariance(None, turning)[1, 1] < 1e-3 * alone[1, 1]
    assert not level_floor_covariance(None, None).any()


def test_the_poses_turn_about_the_first_of_their_part() -> None:
    rng = np.random.default_rng(0)
    poses = se3.exp(rng.normal(0, 1, (6, 6)))
    poses[1] = np.nan
    component = np.array([0, 0, 1, 0, 1, 0])
    slope = np.array([2e-6, -1e-6, 0.0])
    told = level_floor_displacements(poses, component, np.outer(slope[:2], slope[:2]))
    world = np.eye(4)
    world[:3, :3] = Rotation.from_rotvec(slope).as_matrix()
    for k in (0, 2, 3, 4, 5):
        first, turned = poses[2 * component[k], :3, 3], world @ poses[k]
        turned[:3, 3] += first - world[:3, :3] @ first
        error = se3.log((se3.inverse(poses[k]) @ turned)[None])[0]
        assert told[k] @ told[k].T == pytest.approx(np.outer(error, error), abs=1e-16)
    assert not told[1].any()


def without_attitude(flight: Flight) -> Flight:
    return replace(flight, attitude=None)


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("without", [False, True])
def test_a_mount_three_degrees_off_is_within_what_is_told(axis: int, without: bool) -> None:
    """37 000 without it. Under one heading nothing tells a mount from ground that slopes."""
    flight = askew(flown(2), np.radians(3.0) * np.eye(3)[axis, :2])
    flight = without_attitude(flight) if without else flight
    found = evaluate(optimize(flight), flight)
    assert found.nees.pose.mean < 2 * 6
    assert found.ate_m.rmse < 0.003


@pytest.mark.slow
def test_a_mount_that_is_right_costs_nothing() -> None:
    told = optimize(flown(2)).covariances
    assert np.degrees(np.sqrt(told[:, :2, :2].max())) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("heading", ["fixed", "along_path"])
@pytest.mark.parametrize("without", [False, True])
def test_a_slope_below_what_is_reported_is_within_what_is_told(heading: str, without: bool) -> None:
    """3470 without it, but with attitude and many headings."""
    slope = {"floor_slope": {"x": 0.02, "y": -0.02}}
    flight = flown(2, maneuver={"heading": heading}, terms=slope)
    flight = without_attitude(flight) if without else flight
    estimate = optimize(flight)
    assert estimate.status == "ok"
    assert evaluate(estimate, flight).nees.pose.mean < 2 * 6
