"""Readings of an IMU in the refinement: across a gap without pictures, and what damages them."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X as POSE

from backend.bundle.factors import LOG_SCALE, WORLD_SIZE
from backend.bundle.inertial.graph import InertialPart
from backend.bundle.inertial_noise import estimate_inertial_noise
from backend.bundle.refinement import refine
from backend.bundle.world import WorldTransform
from backend.errors import BackendError
from backend.measurements import InertialReadings
from backend.quantiles import chi_square_limit
from tests.backend.bundle.inertial.made_inertial import InertialScene, MadeInertial, altered, make
from tests.backend.made_floor import CAMERA, NADIR, nees


@pytest.fixture(scope="module")
def made() -> MadeInertial:
    return make(InertialScene(), 0)


def damage_of(made: MadeInertial, readings: InertialReadings) -> str:
    try:
        found = refine(altered(made, readings), made.start)
    except BackendError as error:
        return str(error)
    part = found.optimum.problem.inertial
    return "all cut" if part is None else part.damage(found.optimum.values, found.noise.inertial)


@pytest.mark.slow
def test_poses_behind_a_gap_are_as_far_off_as_their_covariances_say():
    found = []
    for seed in range(6):
        made = make(InertialScene(), seed)
        bundle = refine(made.measurements, made.start)
        found.append(nees(bundle.w_T_b, made.w_T_b, bundle.covariances)[-1])
    assert chi_square_limit(1 - 1e-3, 36) < sum(found) < chi_square_limit(1e-3, 36)


def test_readings_connect_both_sides_of_a_gap(made):
    bundle = refine(made.measurements, made.start)
    part = bundle.optimum.problem.inertial
    assert part is not None
    assert part.damage(bundle.optimum.values, bundle.noise.inertial) == ""
    assert not part.cut
    assert nees(bundle.w_T_b, made.w_T_b, bundle.covariances)[-1] < chi_square_limit(1e-4, 6)
    # Noise of the stated size is left as it is.
    assert bundle.noise.inertial.gyro < 1.3
    assert bundle.noise.inertial.accel < 1.3


def test_the_noise_of_the_readings_is_that_of_their_own_factors(made):
    """A factor of anything else changes nothing, wherever it stands in the graph."""
    optimum = refine(made.measurements, made.start).optimum
    before, kept = estimate_inertial_noise(optimum)
    first = optimum.values.atPose3(POSE(0))
    off = first.compose(gtsam.Pose3(gtsam.Rot3(), gtsam.Point3(100.0, 0.0, 0.0)))
    loose = gtsam.noiseModel.Isotropic.Sigma(6, 1e3)
    optimum.cost.pose_side.add("gauge", gtsam.PriorFactorPose3(POSE(0), off, loose))
    after, same = estimate_inertial_noise(optimum)
    np.testing.assert_allclose(after, before, rtol=0.05)
    np.testing.assert_array_equal(same, kept)


def test_readings_connect_both_sides_of_a_gap_without_pictures_between_keyframes(made):
    """At a few pictures a second each is a keyframe."""
    bundle = refine(replace(made.measurements, frames=()), made.start)
    assert bundle.optimum.problem.inertial is not None
    assert nees(bundle.w_T_b, made.w_T_b, bundle.covariances)[-1] < chi_square_limit(1e-4, 6)


def test_pictures_between_keyframes_change_nothing_without_an_imu():
    made = make(InertialScene(gap_s=None, seconds=3.0), 0)
    alone = replace(made.measurements, inertial=None)
    with_frames, without = refine(alone, made.start), refine(replace(alone, frames=()), made.start)
    assert (with_frames.w_T_b == without.w_T_b).all()


@pytest.mark.slow
@pytest.mark.parametrize("unit", [180 / np.pi, -1.0])
def test_a_gyro_in_another_unit_or_sign_is_damaged(made, unit):
    readings = made.measurements.inertial.readings
    assert damage_of(made, replace(readings, gyro_rad_s=unit * readings.gyro_rad_s))


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1 / 9.80665, -1.0])
def test_an_accelerometer_in_another_unit_or_sign_is_damaged(made, unit):
    readings = made.measurements.inertial.readings
    assert damage_of(made, replace(readings, accel_m_s2=unit * readings.accel_m_s2))


def test_readings_that_another_delay_reaches_get_no_variables_of_their_own():
    """By the first delay the readings begin after the first picture, and by the new one before it."""
    made = make(InertialScene(gap_s=None, seconds=2.0), 0)
    height_m, world = 1.2, np.zeros(WORLD_SIZE)
    world[LOG_SCALE] = np.log(height_m)
    f_T_c = made.start @ NADIR
    f_T_c[:, :3, 3] /= height_m
    poses, transform = gtsam.Values(), WorldTransform(world, NADIR)
    for k, one in enumerate(f_T_c):
        poses.insert(POSE(k), gtsam.Pose3(one))
    part = InertialPart.of(made.measurements, CAMERA, poses, transform)
    assert part is not None
    values = part.start(poses, transform)
    shorter = replace(part, intervals=part.intervals[1:])
    again = shorter.reintegrated(values, np.ones(len(shorter.intervals), bool))
    assert again is not None
    assert [one.i for one in again.intervals] == [one.i for one in part.intervals[1:]]
    assert {one.i for one in again.intervals} <= set(again.by_gain)
