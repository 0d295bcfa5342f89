"""The reference at the keyframes' times: interpolated where it may be, counted where it may not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin, geodetic_from_enu
from slam.core.messages import about
from slam.core.streams import Frames, Gps, Truth
from slam.evaluation import evaluate
from slam.evaluation.association import associate
from slam.evaluation.coarse_truth import BETWEEN_ROWS
from slam.report.tables.evaluation import accuracy_tables, evaluated
from tests.slam.evaluation.scene import disturbed, estimate_of, flight_of, smooth_poses

ORIGIN = GeoOrigin(48.1, 11.5, 520.0)


def turning(times_s):
    """Constant velocity and constant rate of turn: what interpolation must reproduce exactly."""
    w_T_b = np.tile(np.eye(4), (len(times_s), 1, 1))
    w_T_b[:, :3, :3] = Rotation.from_rotvec(np.outer(times_s, [0.1, -0.2, 0.4])).as_matrix()
    w_T_b[:, :3, 3] = np.outer(times_s, [1.0, 2.0, -0.1])
    return w_T_b


def test_uniform_motion_is_interpolated_exactly():
    times_s = np.arange(0, 10, 0.19)
    keyframes_s = np.arange(40) * 0.25
    flight = flight_of(turning(times_s), truth=Truth(times_s, turning(times_s)))
    found = associate(estimate_of(turning(keyframes_s)), flight)
    assert len(found.keyframe) == 40
    np.testing.assert_allclose(found.w_T_b, turning(keyframes_s), atol=1e-12)


def test_what_the_truth_does_not_cover_is_counted():
    times_s = np.concatenate([np.arange(2.0, 4.0, 0.01), np.arange(6.0, 8.0, 0.01)])
    flight = flight_of(turning(times_s), truth=Truth(times_s, turning(times_s)))
    estimate = estimate_of(turning(np.arange(40) * 0.25))
    found = associate(estimate, flight)
    inside = (estimate.stamps_s >= 2) & (estimate.stamps_s < 8)
    gap = (estimate.stamps_s > 3.995) & (estimate.stamps_s < 6)
    np.testing.assert_array_equal(found.keyframe, np.flatnonzero(inside & ~gap))
    assert found.left_out == {"outside the truth's time range": 16, "in a gap of the truth": 8}


def test_slow_truth_is_still_interpolated_but_not_over_three_intervals():
    times_s = np.array([0, 0.5, 1.0, 1.5, 2.0, 2.5, 4.1, 4.6])
    flight = flight_of(turning(times_s), truth=Truth(times_s, turning(times_s)))
    found = associate(estimate_of(turning(np.arange(18) * 0.25)), flight)
    assert found.left_out == {"in a gap of the truth": 6}


def swaying(times_s):
    """A motion that bends: 0.3 m and 0.2 rad to and fro, once in two seconds."""
    w_T_b = np.tile(np.eye(4), (len(times_s), 1, 1))
    sway = np.sin(np.pi * times_s)
    w_T_b[:, :3, :3] = Rotation.from_rotvec(np.outer(sway, [0.2, 0.0, 0.0])).as_matrix()
    w_T_b[:, :3, 3] = np.outer(sway, [0.3, 0.0, 0.0])
    return w_T_b


@pytest.mark.parametrize("every_s", [0.01, 0.2])
def test_what_interpolation_misses_is_known(every_s):
    times_s = np.arange(0, 10.1, every_s)
    keyframes_s = np.arange(40) * 0.23
    truth = Truth(times_s, swaying(times_s))
    found = associate(
        estimate_of(swaying(keyframes_s), stamps_s=keyframes_s), flight_of(truth.w_T_b, truth=truth)
    )
    off = np.linalg.inv(found.w_T_b) @ swaying(keyframes_s)
    missed = np.column_stack(
        [
            np.linalg.norm(Rotation.from_matrix(off[:, :3, :3]).as_rotvec(), axis=1),
            np.linalg.norm(off[:, :3, 3], axis=1),
        ]
    )
    assert (missed <= 1.1 * found.between_rows + 1e-9).all()
    assert found.between_rows.sum() < 2.5 * missed.sum() + 1e-6


def test_a_coarse_truth_is_not_taken_for_wrong_covariances():
    """It has the estimate's errors at its rows and its own between them."""
    rng = np.random.default_rng(5)
    keyframes_s = np.arange(60) * 0.25
    errors = np.zeros((60, 6))
    errors[1:] = rng.normal(0, [1e-3] * 3 + [2e-3] * 3, (59, 6))
    poses = swaying(keyframes_s) @ RigidTransform.from_exp_coords(-errors).as_matrix()
    estimate = estimate_of(poses, stamps_s=keyframes_s)
    estimate = replace(estimate, covariances=np.tile(np.diag([1e-6] * 3 + [4e-6] * 3), (60, 1, 1)))
    found = {}
    for every_s in (0.01, 0.2):
        times_s = np.arange(0, 15.1, every_s)
        truth = Truth(times_s, swaying(times_s))
        found[every_s] = evaluate(estimate, flight_of(truth.w_T_b, truth=truth))
    fine, coarse = found[0.01], found[0.2]
    assert fine.too_coarse == 0
    assert 4.5 < fine.nees.pose.mean < 7.5
    # One in four lies on a row, and the others have the truth's error alone.
    assert 40 <= coarse.left_out[BETWEEN_ROWS] <= 45
    assert 3.5 < coarse.nees.pose.mean < 8.5
    assert coarse.associated == 60 - coarse.left_out[BETWEEN_ROWS]
    assert coarse.ate_aligned_m.rmse == pytest.approx(fine.ate_aligned_m.rmse, rel=0.2)


@pytest.mark.parametrize("every", [1, 4, 10, 30])
@pytest.mark.parametrize("std", [1e-3, 1e-2])
def test_the_errors_of_few_rows_are_those_of_the_map(every: int, std: float):
    """The truth has every n-th keyframe's pose, and the map its own noise alone."""
    rng = np.random.default_rng(1)
    true = smooth_poses(np.random.default_rng(1), 119)
    estimate = estimate_of(
        disturbed(rng, true, np.full(6, std)), covariances=np.tile(np.eye(6) * std**2, (119, 1, 1))
    )
    rows = np.arange(0, 119, every)
    found = evaluate(estimate, flight_of(true, truth=Truth(rows * 0.25, true[rows])))
    assert found.associated >= len(rows)
    # The alignment of the first pose turns the others by its own error.
    assert found.ate_m.rmse < 10 * std
    assert found.ate_aligned_m.rmse < 3 * std or np.isnan(found.ate_aligned_m.rmse)
    assert np.isnan(found.scale) or found.scale == pytest.approx(1.0, abs=3 * std)


def bumpy(rng, true, every):
    """A map that states 1 cm, right at every n-th keyframe and 1 m too high between these."""
    high = true.copy()
    high[:, 2, 3] += np.sin(np.pi * np.arange(len(true)) / every) ** 2
    covariances = np.tile(np.eye(6) * 1e-4, (len(true), 1, 1))
    return estimate_of(disturbed(rng, high, np.full(6, 1e-2)), covariances=covariances)


def test_a_map_that_is_wrong_between_rows_does_not_hide_its_errors():
    """It is overconfident, over a path that the rows of the truth follow."""
    true, rows = smooth_poses(np.random.default_rng(1), 119), np.arange(0, 119, 8)
    estimate = bumpy(np.random.default_rng(1), true, 8)
    found = evaluate(estimate, flight_of(true, truth=Truth(rows * 0.25, true[rows])))
    assert BETWEEN_ROWS not in found.left_out
    assert found.ate_m.rmse > 0.5
    few = found.too_few_rows
    assert few is not None
    assert few.at_rows == 15
    assert 1.0 < few.off_line_m < 1.2
    assert few.ate_at_rows_m.rmse < 0.03
    assert "too coarse to tell whether the map is wrong" in evaluated(found).words
    rows_of_table = dict(accuracy_tables(found)[-1].rows)
    assert rows_of_table["is the stated uncertainty right?"].startswith("not known")
    assert found.to_json()["too_few_truth_rows"]["at_rows"] == 15


def test_noise_at_the_rows_too_is_that_of_the_map():
    true, rows = smooth_poses(np.random.default_rng(1), 119), np.arange(0, 119, 8)
    estimate = estimate_of(
        disturbed(np.random.default_rng(1), true, np.full(6, 0.3)),
        covariances=np.tile(np.eye(6) * 1e-4, (119, 1, 1)),
    )
    found = evaluate(estimate, flight_of(true, truth=Truth(rows * 0.25, true[rows])))
    assert BETWEEN_ROWS not in found.left_out
    assert found.too_few_rows is None
    assert found.ate_m.rmse > 0.3


def test_two_rows_of_a_truth_are_too_few_to_tell():
    true, rows = smooth_poses(np.random.default_rng(1), 119), np.array([0, 118])
    estimate = estimate_of(
        disturbed(np.random.default_rng(1), true, np.full(6, 1e-3)),
        covariances=np.tile(np.eye(6) * 1e-6, (119, 1, 1)),
    )
    found = evaluate(estimate, flight_of(true, truth=Truth(rows * 0.25, true[rows])))
    assert found.too_few_rows is not None
    assert found.too_few_rows.keyframes == 117
    assert found.too_few_rows.at_rows == 2
    assert "they are too few; give more rows of the truth" in evaluated(found).words


def test_keyframes_of_one_stamp_are_compared():
    true = smooth_poses(np.random.default_rng(1), 30)
    times_s = np.arange(30) * 0.25
    times_s[11] = times_s[10]
    true[11], rows = true[10], np.arange(0, 30, 4)
    flight = flight_of(true, truth=Truth(times_s[rows], true[rows]))
    assert len(associate(estimate_of(true, stamps_s=times_s), flight).keyframe) == 29


def test_a_noisy_map_is_compared_between_rows_too():
    """Its own error is far more than what interpolation misses."""
    rng = np.random.default_rng(2)
    true = smooth_poses(np.random.default_rng(2), 119)
    estimate = estimate_of(
        disturbed(rng, true, np.full(6, 0.3)), covariances=np.tile(np.eye(6) * 0.09, (119, 1, 1))
    )
    rows = np.arange(0, 119, 2)
    found = evaluate(estimate, flight_of(true, truth=Truth(rows * 0.25, true[rows])))
    assert found.associated >= 118


def test_other_epochs_and_truth_out_of_order_change_nothing():
    truth = smooth_poses(np.random.default_rng(0), 30)
    estimate, flight = estimate_of(truth[:, :, :]), flight_of(truth)
    order = np.random.default_rng(1).permutation(30)
    shifted = replace(
        flight,
        epoch_ns=flight.epoch_ns - 5_000_000_000,
        truth=Truth(flight.truth.stamps_s[order] + 5.0, truth[order]),
    )
    assert evaluate(estimate, shifted).ate_m.max < 1e-9
    assert evaluate(estimate, shifted).associated == 30


def test_another_clock_is_refused_with_both_time_ranges():
    truth = smooth_poses(np.random.default_rng(0), 30)
    late = replace(flight_of(truth), epoch_ns=0)
    with pytest.raises(
        InputError, match=r"30 outside the truth's time range.* 0\.000 to 7\.250 s"
    ) as refused:
        evaluate(estimate_of(truth), late)
    assert "\n" not in str(refused.value)


def test_another_flight_on_the_same_clock_is_known_by_its_pictures():
    truth = smooth_poses(np.random.default_rng(0), 30)
    estimate, flight = estimate_of(truth), flight_of(truth)
    names = (*estimate.frame_names[:1], *(f"other_{k}.png" for k in range(9)))
    some = replace(flight, frames=Frames(np.arange(10.0), names, lambda k: None))
    assert associate(estimate, some).left_out == {}, "some of its pictures may be lost"
    none = replace(flight, frames=Frames(np.arange(9.0), names[1:], lambda k: None))
    with pytest.raises(InputError, match="has none of the pictures of made, such as 000000"):
        associate(estimate, none)


def test_without_truth_and_gps_it_refuses():
    with pytest.raises(InputError, match="neither truth nor GPS"):
        evaluate(estimate_of(smooth_poses(np.random.default_rng(0), 5)), Flight(name="bare"))


def gps_flight(positions_m, stamps_s, with_altitude=True):
    latitude, longitude, altitude = geodetic_from_enu(positions_m, ORIGIN)
    altitude = altitude if with_altitude else np.full(len(altitude), np.nan)
    gps = Gps(stamps_s, latitude, longitude, altitude)
    return Flight(name="outdoors", epoch_ns=1_700_000_000_123_456_789, gps=gps)


def test_gps_is_the_reference_without_truth_and_nothing_is_aligned():
    poses = smooth_poses(np.random.default_rng(2), 20, size_m=50.0)
    moved = poses.copy()
    moved[:, :3, 3] += [3.0, 4.0, 12.0]
    flight = gps_flight(poses[:, :3, 3], np.arange(20) * 0.25)
    found = evaluate(estimate_of(moved, origin=ORIGIN), flight)
    assert found.reference == "gps"
    assert found.ate_m.rmse == pytest.approx(13.0, rel=1e-6)
    assert found.ate_aligned_m.rmse < 1e-6
    record = found.to_json()
    assert record["loops"] is None
    assert record["rpe"] == {}
    assert record["landmarks"] == {}
    assert record["nees"]["mean"] is None


def test_a_fix_far_from_the_others_is_no_reference():
    poses = smooth_poses(np.random.default_rng(2), 20, size_m=5.0)
    fixes = poses[:, :3, 3].copy()
    fixes[7, 0] += 1e6
    found = associate(estimate_of(poses, origin=ORIGIN), gps_flight(fixes, np.arange(20) * 0.25))
    assert 7 not in found.keyframe.tolist()
    assert found.left_out == {"whose GPS fix contradicts the other fixes": 1}


def test_a_fix_whose_altitude_jumps_is_no_reference():
    poses = smooth_poses(np.random.default_rng(2), 20, size_m=5.0)
    fixes = poses[:, :3, 3].copy()
    fixes[7, 2] += 500.0
    flight = gps_flight(fixes, np.arange(20) * 0.25)
    found = associate(estimate_of(poses, origin=ORIGIN), flight)
    assert found.keyframe.tolist() == [k for k in range(20) if k != 7]
    assert found.left_out == {"whose GPS fix contradicts the other fixes": 1}
    assert evaluate(estimate_of(poses, origin=ORIGIN), flight).ate_m.rmse < 1e-6


def test_gps_without_any_complete_fix_is_refused():
    poses = smooth_poses(np.random.default_rng(2), 20, size_m=5.0)
    flight = gps_flight(np.full((20, 3), np.nan), np.arange(20) * 0.25)
    with pytest.raises(InputError, match="gps0: holds no complete fix"):
        associate(estimate_of(poses, origin=ORIGIN), flight)


def test_gps_without_altitude_is_compared_in_the_plane():
    poses = smooth_poses(np.random.default_rng(2), 20, size_m=50.0)
    moved = poses.copy()
    moved[:, :3, 3] += [3.0, 4.0, 12.0]
    flight = gps_flight(poses[:, :3, 3], np.arange(20) * 0.25, with_altitude=False)
    found = evaluate(estimate_of(moved, origin=ORIGIN), flight)
    assert found.dimensions == 2
    assert found.ate_m.rmse == pytest.approx(5.0, rel=1e-3)


def test_a_fix_counts_within_half_an_interval():
    poses = smooth_poses(np.random.default_rng(2), 20, size_m=50.0)
    fixes = np.arange(10)
    flight = gps_flight(poses[fixes, :3, 3], fixes * 1.0)
    found = associate(estimate_of(poses, step_s=0.55, origin=ORIGIN), flight)
    assert len(found.keyframe) == 18
    assert found.left_out == {"without a GPS fix at their time": 2}


def test_parts_without_a_common_origin_are_not_compared():
    truth = smooth_poses(np.random.default_rng(5), 20)
    estimated = truth.copy()
    estimated[12:, :3, 3] += 100.0
    component = np.repeat([0, 1], [12, 8])
    found = evaluate(estimate_of(estimated, component=component), flight_of(truth))
    assert found.ate_m.max < 1e-9
    assert found.left_out == {"in a part that is not connected to the largest": 8}
    on_earth = evaluate(estimate_of(estimated, component=component, origin=ORIGIN), flight_of(truth))
    assert on_earth.ate_m.max > 100


def test_a_truth_of_incomplete_rows_is_refused_with_what_was_dropped():
    flight = replace(
        flight_of(smooth_poses(np.random.default_rng(2), 5), truth=None),
        messages=(about("state_groundtruth_estimate0", "5 of 5 rows dropped: part of the pose missing"),),
    )
    with pytest.raises(InputError, match="5 of 5 rows dropped"):
        associate(estimate_of(smooth_poses(np.random.default_rng(2), 5)), flight)
