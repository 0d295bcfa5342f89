"""From exact homographies and readings to edges, a pose graph and a refinement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend.bundle.refinement import Bundle
from backend.errors import BackendError
from backend.measurements import FloorTracks, RelativePose
from frontend.points import Points
from frontend.tracks import join_tracks
from slam.core.streams import Truth
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.lift_edges import Edges, lift_edges
from slam.mapping.part_measurements import refine_part
from slam.mapping.search_radius import KnownPoses, implausible_edges
from slam.mapping.setup import Setup
from slam.mapping.solve_pose_graph import graph_measurements, solve_pose_graph
from tests.slam.mapping.exact_flight import (
    CAMERA,
    CONFIG,
    angles_of,
    flight,
    registration,
    seen,
    setup_of,
    truth,
)
from tests.slam.small_flight import ORIGIN, gps_of

PAIRS = [(k, k + 1) for k in range(11)] + [(0, 11), (1, 10), (2, 9)]


def edges_of(setup: Setup, w_T_b: np.ndarray, pairs: list[tuple[int, int]] = PAIRS) -> Edges:
    return lift_edges([registration(w_T_b, i, j, camera=setup.camera) for i, j in pairs], setup)


def assert_relative(edge: RelativePose, w_T_b: np.ndarray, scale: float = 1.0) -> None:
    expected = np.linalg.inv(w_T_b[edge.i]) @ w_T_b[edge.j]
    expected[:3, 3] *= scale
    assert edge.i_T_j == pytest.approx(expected, abs=2e-3)


def test_exact_homographies_become_metric_edges():
    w_T_b = truth()
    edges = edges_of(setup_of(w_T_b), w_T_b)
    assert [(e.i, e.j) for e in edges.relative_poses] == PAIRS
    for edge in edges.relative_poses:
        assert_relative(edge, w_T_b)
        assert (np.linalg.eigvalsh(edge.covariance) > 0).all()
    assert edges.heights.metric.all()
    assert edges.heights.height_m == pytest.approx(w_T_b[:, 2, 3], rel=2e-3)


def test_apart_in_time_is_a_loop():
    edges = edges_of(setup_of(truth()), truth())
    apart = {(e.i, e.j): 3.0 * (e.j - e.i) >= CONFIG.loops.min_separation_s for e in edges.relative_poses}
    assert {
        pair: kind == "loop" for pair, kind in zip(apart, (e.kind for e in edges.relative_poses), strict=True)
    } == apart
    assert sum(apart.values()) == 3


def test_a_slant_range_of_a_leaning_drone_is_not_its_height():
    """Leaning by half a radian the ray is a seventh longer than the height."""
    w_T_b = truth()
    lean = Rotation.from_euler("ZYX", np.column_stack([np.zeros(12), np.full(12, 0.35), np.full(12, -0.35)]))
    w_T_b[:, :3, :3] = lean.as_matrix()
    edges = edges_of(setup_of(w_T_b), w_T_b)
    assert w_T_b[:, 2, 2].max() < 0.9
    assert edges.heights.height_m == pytest.approx(w_T_b[:, 2, 3], rel=2e-3)


def test_without_sonar_lengths_are_in_mean_heights():
    w_T_b = truth()
    edges = edges_of(setup_of(w_T_b, sonar=False), w_T_b)
    mean_height = np.exp(np.log(w_T_b[:, 2, 3]).mean())
    assert not edges.heights.metric.any()
    assert edges.heights.height_m == pytest.approx(w_T_b[:, 2, 3] / mean_height, rel=2e-3)
    for edge in edges.relative_poses:
        assert_relative(edge, w_T_b, 1 / mean_height)


def test_homographies_that_no_pose_explains_are_left_out():
    w_T_b = truth()
    good = [registration(w_T_b, *pair) for pair in PAIRS]
    mad = replace(registration(w_T_b, 3, 7), i_H_j=np.array([[1.0, 0, 0], [0, 1, 0], [np.nan, 0, 1]]))
    edges = lift_edges([*good, mad], setup_of(w_T_b))
    assert [(r.i, r.j) for r in edges.registrations] == PAIRS
    assert len(edges.relative_poses) == len(PAIRS)


def test_messages_of_the_pose_graph_name_photographs():
    w_T_b = truth()
    setup = setup_of(w_T_b)
    names = tuple(f"P{k}.jpg" for k in range(len(w_T_b)))
    setup = replace(setup, readings=replace(setup.readings, names=names))
    assert graph_measurements(edges_of(setup, w_T_b), setup)[0].names == names


def test_the_pose_graph_gives_back_the_way():
    w_T_b = truth()
    setup = setup_of(w_T_b)
    solution = solve_pose_graph(edges_of(setup, w_T_b), setup)
    turn = np.eye(4)
    turn[:2, :2] = (w_T_b[0] @ np.linalg.inv(solution.w_T_b[0]))[:2, :2]
    found = turn @ solution.w_T_b
    found[:, :2, 3] -= found[0, :2, 3]
    assert found == pytest.approx(w_T_b, abs=5e-3)
    assert solution.edge_kept.all()


def implausible(known, edges):
    return implausible_edges(edges.at_heights(known.height_m), known, CONFIG.loops)


def test_a_false_loop_is_refused_and_named():
    w_T_b = truth()
    setup, elsewhere = setup_of(w_T_b), w_T_b.copy()
    elsewhere[8, 0, 3] -= 1.5
    false = replace(registration(elsewhere, 3, 8), matches=np.empty((0, 2), np.int64))
    edges = lift_edges([*(registration(w_T_b, *pair) for pair in PAIRS), false], setup)
    without = solve_pose_graph(edges_of(setup, w_T_b, PAIRS[:11]), setup, covariances=True)
    known = KnownPoses(without.w_T_b, without.covariances, without.component, edges.heights.height_m)
    refused = implausible(known, edges)
    assert list(refused) == [(3, 8)]
    assert "1.5" in refused[3, 8].figures
    larger = replace(
        known,
        w_T_b=known.w_T_b.copy(),
        covariances=100.0 * np.asarray(known.covariances),
        height_m=10 * known.height_m,
    )
    larger.w_T_b[:, :3, 3] *= 10
    assert list(implausible(larger, edges)) == [(3, 8)]
    solution = solve_pose_graph(edges, setup)
    assert solution.edge_kept.tolist() == [True] * len(PAIRS) + [False]


def test_nothing_to_join_is_a_graph_without_poses():
    setup = setup_of(truth())
    edges = lift_edges([], setup)
    assert edges.relative_poses == ()
    solution = solve_pose_graph(edges, setup)
    assert (solution.component == -1).all()
    assert np.isnan(solution.w_T_b).all()


def test_edges_at_other_heights_are_the_same_edges_in_other_metres():
    w_T_b = truth()
    edges = edges_of(setup_of(w_T_b), w_T_b)
    for edge, tall in zip(edges.relative_poses, edges.at_heights(3 * edges.heights.height_m), strict=True):
        assert tall.i_T_j[:3, 3] == pytest.approx(3 * edge.i_T_j[:3, 3])
        assert tall.i_T_j[:3, :3] == pytest.approx(edge.i_T_j[:3, :3])
        assert np.sqrt(np.diag(tall.covariance)) == pytest.approx(
            np.sqrt(np.diag(edge.covariance)) * [1, 1, 1, 3, 3, 3]
        )
        assert tall.covariance[0, 4] == pytest.approx(3 * edge.covariance[0, 4])


def test_without_ranges_edges_at_known_heights_are_those_with_ranges():
    """The camera is far from the body's origin, and its place is in metres where heights are not yet."""
    b_T_c = CAMERA.b_T_c.copy()
    b_T_c[:3, 3] = 0.3, 0.1, -0.4
    camera = replace(CAMERA, b_T_c=b_T_c)
    w_T_b = truth()
    w_T_b[:, 2, 3] += 0.4
    registrations = [registration(w_T_b, *pair, camera=camera) for pair in PAIRS]
    ranged, free = (
        lift_edges(registrations, replace(setup_of(w_T_b, sonar=sonar), camera=camera))
        for sonar in (True, False)
    )
    assert not free.heights.metric.any()
    for edge, known in zip(ranged.relative_poses, free.at_heights(ranged.heights.height_m), strict=True):
        assert known.i_T_j == pytest.approx(edge.i_T_j, abs=1e-6)


def test_tilts_that_were_found_replace_the_stated_ones():
    w_T_b = truth()
    told = setup_of(w_T_b, attitude=False)
    covariances = np.tile(np.diag([1e-6, 4e-6, 1, 1, 1, 1.0]), (12, 1, 1))
    covariances[4] = np.nan
    known = told.with_tilts(w_T_b, covariances).readings
    rest = np.arange(12) != 4
    assert known.roll_pitch_rad[rest] == pytest.approx(angles_of(w_T_b)[rest, :2], abs=1e-9)
    floor = CONFIG.trust.attitude_floor_rad
    assert known.roll_pitch_std_rad[0] == pytest.approx([np.hypot(1e-3, floor), np.hypot(2e-3, floor)])
    assert known.roll_pitch_rad[4] == pytest.approx([0, 0])
    assert known.roll_pitch_std_rad[4] == pytest.approx([CONFIG.trust.level_std_rad] * 2)
    assert (told.readings.roll_pitch_rad == 0).all()


def test_sensors_are_read_at_the_keyframes():
    w_T_b = truth()
    stamps_s = 3.0 * np.arange(12)
    made = replace(flight(w_T_b), truth=None)
    made.attitude.roll_pitch_yaw_rad[15:18] = np.nan  # keyframe 5
    made.sonar.range_m[21:24] = np.nan  # keyframe 7
    readings = KeyframeReadings.at(made, stamps_s, ORIGIN, CONFIG)
    assert [a.k for a in readings.attitudes] == [k for k in range(12) if k != 5]
    assert [r.k for r in readings.ranges] == [k for k in range(12) if k != 7]
    assert readings.positions == ()
    assert readings.range_gain_std == 0.02
    assert readings.roll_pitch_rad[5] == pytest.approx([0, 0])
    assert readings.roll_pitch_std_rad[5] == pytest.approx([CONFIG.trust.level_std_rad] * 2)
    assert readings.roll_pitch_rad[6] == pytest.approx(angles_of(w_T_b)[6, :2])


def refined(setup: Setup, w_T_b: np.ndarray, members: np.ndarray, start: np.ndarray) -> Bundle:
    points = [Points.alike(seen(pose, setup.camera)[1]) for pose in w_T_b]
    tracks = join_tracks(
        points,
        [registration(w_T_b, *pair, camera=setup.camera) for pair in PAIRS],
        setup.camera,
        CONFIG.tracks,
    )
    return refine_part(setup, members, start[members], 0.0, tracks)


@pytest.mark.parametrize("members", [np.arange(12), np.array([2, 3, 4, 5, 8, 9])])
def test_the_refinement_of_a_part_uses_its_own_keyframes_alone(members):
    """Other keyframes have no pose at all; numbers inside are not those outside."""
    w_T_b = truth()
    setup = setup_of(w_T_b)
    start = np.full_like(w_T_b, np.nan)
    start[members] = w_T_b[members]
    start[:, :2, 3] -= w_T_b[members[0], :2, 3]
    start[members[1:], :3, 3] += np.random.default_rng(1).normal(0, 0.01, (len(members) - 1, 3))
    bundle = refined(setup, w_T_b, members, start)
    expected = w_T_b[members].copy()
    expected[:, :2, 3] -= expected[0, :2, 3]
    assert bundle.w_T_b == pytest.approx(expected, abs=5e-3)
    assert bundle.covariances.shape == (len(members), 6, 6)


def test_camera_and_sonar_may_sit_anywhere_on_the_body():
    """Both centimetres off the body's origin, the beam aslant, heights of 1 to 3: all are exact."""
    w_T_b = truth()
    w_T_b[:, 2, 3] *= np.linspace(0.5, 1.5, 12)
    b_T_s, b_T_c = np.eye(4), CAMERA.b_T_c.copy()
    b_T_s[:3, :3] = Rotation.from_euler("xy", [0.05, -0.08]).as_matrix()
    b_T_s[:3, 3], b_T_c[:3, 3] = (0.10, 0.0, -0.06), (-0.08, 0.03, 0.07)
    camera, stamps_s = replace(CAMERA, b_T_c=b_T_c), 3.0 * np.arange(12)
    setup = Setup(camera, KeyframeReadings.at(flight(w_T_b, b_T_s=b_T_s), stamps_s, None, CONFIG), CONFIG)
    edges = edges_of(setup, w_T_b)
    assert edges.heights.height_m == pytest.approx(w_T_b[:, 2, 3], rel=2e-3)
    for edge in edges.relative_poses:
        assert_relative(edge, w_T_b)
    expected = w_T_b.copy()
    expected[:, :2, 3] -= expected[0, :2, 3]
    start = expected.copy()
    start[:, :3, 3] *= 1.05
    bundle = refined(setup, w_T_b, np.arange(12), start)
    found = bundle.w_T_b.copy()
    found[:, :2, 3] -= found[0, :2, 3]
    assert found == pytest.approx(expected, abs=1e-3)


def test_the_lens_is_only_estimated_where_it_may_be():
    w_T_b = truth()
    made = setup_of(w_T_b)
    free = Setup(replace(CAMERA, focal_px=(253.0, 253.0), focal_std_ratio=0.02), made.readings, CONFIG)
    assert refined(made, w_T_b, np.arange(12), w_T_b).lens is None
    lens = refined(free, w_T_b, np.arange(12), w_T_b).lens
    assert lens is not None
    assert lens.calibration[0] != 253.0


def test_a_part_without_common_floor_points_is_refused():
    w_T_b = truth()
    few = FloorTracks(np.array([0, 1]), np.array([0, 0]), np.zeros((2, 2)), np.ones(2))
    with pytest.raises(BackendError, match="too few floor points"):
        refine_part(setup_of(w_T_b), np.array([0, 1]), w_T_b[:2], 0.0, few)


def placed(w_T_b: np.ndarray) -> Setup:
    """GPS alone, exact, along the way."""
    stamps_s = 3.0 * np.arange(len(w_T_b))
    made = replace(flight(w_T_b, sonar=False), truth=Truth(stamps_s, w_T_b))
    fixes = gps_of(replace(made, truth=Truth(np.repeat(stamps_s, 20), np.repeat(w_T_b, 20, axis=0))), 0.0)
    located = replace(made, gps=replace(fixes, noise_std_m=(0.01,) * 3))
    readings = KeyframeReadings.at(located, stamps_s, ORIGIN, CONFIG)
    return Setup(CAMERA, readings, CONFIG)


def test_positions_can_be_left_out():
    setup = placed(truth())
    assert len(setup.readings.positions) == 12
    assert setup.without_positions().readings.positions == ()
    assert len(setup.readings.positions) == 12


def test_positions_go_to_their_own_keyframes_of_a_part():
    w_T_b, members = truth(), np.array([2, 3, 4, 5, 8, 9])
    start = np.full_like(w_T_b, np.nan)
    start[members] = w_T_b[members]
    start[members, 0, 3] += 0.2
    bundle = refined(placed(w_T_b), w_T_b, members, start)
    assert bundle.w_T_b[:, :3, 3] == pytest.approx(w_T_b[members, :3, 3], abs=5e-3)
