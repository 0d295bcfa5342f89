"""Reported motion in the refinement: across a gap, without a height sensor, and with large errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.accuracy.information_shares import information_shares
from backend.bundle.accuracy.systematic_errors import error_test
from backend.bundle.accuracy.systematic_terms import LENS_KINDS
from backend.bundle.refinement import Bundle, refine
from backend.bundle.reported.factor import BIAS, GAINS, REPORTED
from backend.quantiles import chi_square_limit
from tests.backend.bundle.inertial.made_inertial import InertialScene, MadeInertial
from tests.backend.bundle.reported.made_reported import Errors, make_reported
from tests.backend.made_floor import aligned, nees

SCENE = InertialScene(seconds=12.0, gap_s=(5.0, 7.0))
WHOLE = InertialScene(seconds=6.0, gap_s=None)


def drawn(seed: int) -> Errors:
    """Errors by the assumptions on usual vehicles."""
    rng = np.random.default_rng([seed, 9])
    gains, bias = 1 + 0.1 * rng.normal(size=2), 0.06 * rng.normal(size=2)
    return Errors((gains[0], gains[1]), (bias[0], bias[1]), 0.02 * float(rng.normal()))


def refined(made: MadeInertial, **changes) -> Bundle:
    return refine(replace(made.measurements, **changes), made.start)


def damage(bundle: Bundle) -> str:
    assert bundle.optimum.problem.reported is not None
    return bundle.reported_damage


@pytest.mark.slow
def test_poses_behind_a_gap_are_as_far_off_as_their_covariances_say():
    seeds, found = range(10), []
    for seed in seeds:
        made = make_reported(SCENE, seed, drawn(seed))
        bundle = refined(made)
        found.append(nees(bundle.w_T_b, made.w_T_b, bundle.covariances)[-1])
    assert chi_square_limit(1 - 1e-3, 60) < sum(found) < chi_square_limit(1e-3, 60)


@pytest.mark.parametrize("tells_turns", [True, False])
def test_reported_motion_is_no_position(tells_turns):
    """An offset of positions is an error that a flight without positions cannot have."""
    made = make_reported(WHOLE, 0, Errors())
    reported = made.measurements.reported
    assert reported is not None
    assert not made.measurements.positions
    bundle = refined(made, reported=replace(reported, tells_turns=tells_turns))
    tested = error_test(bundle.optimum, bundle.covariances)
    assert tested is not None
    assert set(tested.detectable) == set(LENS_KINDS)


@pytest.mark.slow
def test_without_a_height_sensor_the_velocity_tells_the_scale_as_well_as_stated():
    squares = []
    for seed in range(10):
        made = make_reported(WHOLE, seed, drawn(seed))
        bundle = refined(made, ranges=())
        assert bundle.scale_std is not None
        assert bundle.scale_std < 0.12
        hat = aligned(bundle.w_T_b, made.w_T_b)
        lengths = [np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0)) for poses in (hat, made.w_T_b)]
        squares.append((np.log(lengths[0] / lengths[1]) / bundle.scale_std) ** 2)
        assert information_shares(bundle.optimum)["scale"]["velocity"] > 0.9
    assert sum(squares) < chi_square_limit(1e-3, 10)


@pytest.mark.slow
def test_gain_and_offset_are_found_and_do_not_move_the_map():
    errors = Errors(gains=(1.2, 1.2), bias_m_s=(0.3, 0.0))
    made = make_reported(SCENE, 0, errors)
    bundle, plain = refined(made), refined(make_reported(SCENE, 0))
    assert damage(bundle) == ""
    constants = bundle.optimum.values.atVector(REPORTED)
    std = bundle.optimum.standard_deviations(REPORTED)
    for which, true in ((GAINS, errors.gains), (BIAS, errors.bias_m_s)):
        assert (np.abs(constants[which] - true) < 4 * std[which]).all()
    off, off_plain = (
        np.linalg.norm(found.w_T_b[-1, :3, 3] - made.w_T_b[-1, :3, 3]) for found in (bundle, plain)
    )
    assert off < 1.1 * off_plain + 0.02


@pytest.mark.slow
@pytest.mark.parametrize("unit", [-1.0, 3.28, 0.0])
def test_a_velocity_in_another_unit_or_sign_or_stuck_is_damaged(unit):
    made = make_reported(SCENE, 0)
    motion = made.measurements.reported
    assert motion is not None
    assert damage(refined(made, reported=replace(motion, v_m_s=unit * motion.v_m_s)))


@pytest.mark.slow
@pytest.mark.parametrize("unit", [-1.0, 0.0])
def test_without_a_height_sensor_a_velocity_of_wrong_sign_or_stuck_is_damaged(unit):
    made = make_reported(WHOLE, 0)
    motion = made.measurements.reported
    assert motion is not None
    assert damage(refined(made, ranges=(), reported=replace(motion, v_m_s=unit * motion.v_m_s)))


@pytest.mark.slow
def test_where_ranges_tell_the_scale_a_velocity_does_not():
    """A gain of 1.2 moves no pose by a fifth of its error."""
    scene = InertialScene(seconds=3.6, gap_s=None)
    made, wrong = (refined(make_reported(scene, 0, Errors((gain, gain)))) for gain in (1.0, 1.2))
    error_m = np.sqrt(np.trace(made.covariances[1:, 3:, 3:], axis1=1, axis2=2))
    moved_m = np.linalg.norm((wrong.w_T_b - made.w_T_b)[1:, :3, 3], axis=1)
    assert (moved_m < 0.2 * error_m).all()
    gains = [bundle.optimum.values.atVector(REPORTED)[GAINS] for bundle in (made, wrong)]
    np.testing.assert_allclose(gains[1] / gains[0], 1.2, atol=0.02)
