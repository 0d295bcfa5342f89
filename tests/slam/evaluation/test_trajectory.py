"""Trajectory errors against evo, and the properties that any alignment has."""

from __future__ import annotations

import numpy as np
import pytest
from evo.core.metrics import APE, RPE, PoseRelation, Unit, id_pairs_from_delta
from evo.core.trajectory import PoseTrajectory3D
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.evaluation import evaluate
from slam.evaluation.trajectory import path_length, relative_error, relative_errors, umeyama
from tests.slam.evaluation.scene import disturbed, estimate_of, flight_of, smooth_poses, yaw_shift

STD = np.array([0.02, 0.02, 0.05, 0.05, 0.03, 0.02])
seeds = st.integers(0, 2**32 - 1)


def evo_trajectory(w_T_b, step_s=0.25):
    return PoseTrajectory3D(poses_se3=list(w_T_b), timestamps=np.arange(len(w_T_b)) * step_s)


def pair(seed, count=60):
    rng = np.random.default_rng(seed)
    truth = smooth_poses(rng, count)
    return truth, disturbed(rng, truth, STD)


def evo_ape(truth, estimated, align=False, scale=False):
    reference, trajectory = evo_trajectory(truth), evo_trajectory(estimated)
    factor = trajectory.align(reference, correct_scale=scale)[2] if align else 1.0
    ape = APE(PoseRelation.translation_part)
    ape.process_data((reference, trajectory))
    return ape.get_all_statistics(), factor


@pytest.mark.parametrize("seed", range(5))
def test_ate_agrees_with_evo(seed):
    truth, estimated = pair(seed)
    # The first pose at its true position and yaw: then the gauge leaves the estimate where it is.
    estimated = np.concatenate([truth[:1], estimated[1:]])
    estimated[:, :3, 3] *= 1.0 + 0.03 * seed
    estimated[:, :3, 3] += truth[0, :3, 3] - estimated[0, :3, 3]
    found = evaluate(estimate_of(estimated), flight_of(truth))
    with_scale, factor = evo_ape(truth, estimated, align=True, scale=True)
    for ours, theirs in (
        (found.ate_m, evo_ape(truth, estimated)[0]),
        (found.ate_aligned_m, evo_ape(truth, estimated, align=True)[0]),
        (found.ate_sim3_m, with_scale),
    ):
        assert ours.rmse == pytest.approx(theirs["rmse"], rel=1e-9)
        assert ours.max == pytest.approx(theirs["max"], rel=1e-9)
    assert found.scale == pytest.approx(factor, rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("delta", "unit"), [(1, Unit.frames), (7, Unit.frames), (1.0, Unit.meters), (3.0, Unit.meters)]
)
def test_relative_error_agrees_with_evo(seed, delta, unit):
    truth, estimated = pair(seed)
    data = (evo_trajectory(truth), evo_trajectory(estimated))
    pairs = np.array(id_pairs_from_delta(data[0].poses_se3, delta, unit, rel_tol=0.5, all_pairs=True))
    ours = relative_error("step", pairs, path_length(truth[:, :3, 3]), estimated, truth)
    for spread, relation in (
        (ours.translation_m, PoseRelation.translation_part),
        (ours.rotation_deg, PoseRelation.rotation_angle_deg),
    ):
        rpe = RPE(relation, delta, unit, rel_delta_tol=0.5, all_pairs=True, pairs_from_reference=True)
        rpe.process_data(data)
        theirs = rpe.get_all_statistics()
        assert spread.rmse == pytest.approx(theirs["rmse"], rel=1e-9)
        assert spread.max == pytest.approx(theirs["max"], rel=1e-9)


def test_the_keyframe_step_is_evos_one_frame_step():
    truth, estimated = pair(11)
    found = evaluate(estimate_of(estimated), flight_of(truth))
    rpe = RPE(PoseRelation.translation_part, 1, Unit.frames)
    rpe.process_data((evo_trajectory(truth), evo_trajectory(estimated)))
    by_step = {error.step: error for error in found.rpe}
    assert by_step["1 keyframe"].pairs == 59
    assert by_step["1 keyframe"].translation_m.rmse == pytest.approx(
        rpe.get_all_statistics()["rmse"], rel=1e-9
    )


@settings(max_examples=25, deadline=None)
@given(seed=seeds, turn_rad=st.floats(-3, 3), shift=st.floats(-100, 100))
def test_ate_does_not_feel_the_gauge(seed, turn_rad, shift):
    truth, estimated = pair(seed)
    moved = yaw_shift(turn_rad, np.array([shift, -2 * shift, 0.3 * shift])) @ estimated
    here, there = (evaluate(estimate_of(poses), flight_of(truth)) for poses in (estimated, moved))
    assert there.ate_m.rmse == pytest.approx(here.ate_m.rmse, rel=1e-9)
    assert there.ate_sim3_m.max == pytest.approx(here.ate_sim3_m.max, rel=1e-8)
    assert there.nees.pose.mean == pytest.approx(here.nees.pose.mean, rel=1e-8)
    assert [e.translation_m.rmse for e in there.rpe] == pytest.approx(
        [e.translation_m.rmse for e in here.rpe], rel=1e-8
    )


def test_ate_feels_a_tilt_of_the_world():
    """Only yaw is free: an estimate on a slope is wrong, and aligned it is not."""
    truth, _ = pair(3)
    slope = np.eye(4)
    slope[:3, :3] = [[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]]
    found = evaluate(estimate_of(slope @ truth), flight_of(truth))
    assert found.ate_m.rmse > 0.05
    assert found.ate_aligned_m.rmse < 1e-9


@settings(max_examples=25, deadline=None)
@given(seed=seeds, growth=st.floats(0.5, 2.0))
def test_no_alignment_adds_error_and_the_scale_is_found(seed, growth):
    truth, estimated = pair(seed)
    estimated[:, :3, 3] *= growth
    found = evaluate(estimate_of(estimated), flight_of(truth))
    assert found.ate_aligned_m.rmse <= found.ate_m.rmse * (1 + 1e-12)
    assert found.ate_sim3_m.rmse <= found.ate_aligned_m.rmse * (1 + 1e-12)
    assert found.scale == pytest.approx(1 / growth, rel=0.05)


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_umeyama_undoes_a_similarity_and_never_mirrors(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(12, 3))
    points[:, 2] *= rng.choice([0.0, 1.0])
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    R *= np.linalg.det(R)
    scale, t = rng.uniform(0.1, 10), rng.normal(size=3) * 100
    found = umeyama(points, scale * points @ R.T + t, with_scale=True)
    assert found.scale == pytest.approx(scale, rel=1e-9)
    assert np.linalg.det(found.R) == pytest.approx(1)
    np.testing.assert_allclose(found.apply(points), scale * points @ R.T + t, atol=1e-9)
    mirrored = umeyama(points, points * [1, 1, -1], with_scale=False)
    assert np.linalg.det(mirrored.R) == pytest.approx(1)


def test_a_step_in_seconds_or_metres_is_about_that_long():
    stamps_s = np.concatenate([np.arange(8) * 0.3, [10.0, 10.3]])
    poses = np.tile(np.eye(4), (10, 1, 1))
    poses[:, 0, 3] = np.arange(10) * 0.4
    wrong = poses.copy()
    wrong[:, 0, 3] *= 1.1
    found = {e.step: e for e in relative_errors(stamps_s, np.arange(10), wrong, poses)}
    assert (
        found["1 s"].pairs == 4
    )  # 4 x 0.3 s is the first step of 1 s or more; across the 7.9 s pause none is
    assert found["1 s"].translation_m.max == pytest.approx(0.16)
    assert found["1 m"].translation_m.rmse == pytest.approx(0.12)
    assert found["1 m"].translation_percent == pytest.approx(10.0)
    assert "2 m" not in found


def test_a_missing_keyframe_is_no_step_of_one():
    truth, estimated = pair(4, count=10)
    estimated[5] = np.nan
    found = evaluate(estimate_of(estimated), flight_of(truth))
    assert {e.step: e.pairs for e in found.rpe}["1 keyframe"] == 7
    assert found.associated == 9
    assert found.left_out == {"not placed": 1}


def test_a_single_point_and_a_resting_drone_have_no_scale():
    still = np.tile(np.eye(4), (5, 1, 1))
    moving = still.copy()
    moving[:, 0, 3] = np.arange(5)
    for estimated, truth in ((still, moving), (moving[:1], moving)):
        record = evaluate(estimate_of(estimated), flight_of(truth)).to_json()
        assert record["ate_sim3_m"] == {"rmse": None, "max": None, "scale": None}
        # A rigid motion makes a single point fit anyhow.
        assert (record["ate_aligned_m"]["rmse"] is None) == (len(estimated) == 1)
