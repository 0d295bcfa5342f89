"""Parts of a flight put together: numbered by size, each refined by itself."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from backend.bundle.lens import LensEstimate
from backend.bundle.refinement import Bundle
from backend.measurements import BarometerHeight, Position
from frontend.camera import Camera
from frontend.features import Features
from frontend.points import Points
from frontend.registration import Registration
from frontend.store import FeatureStore
from slam.core.progress import silent
from slam.mapping.calibration.lens import calibrated
from slam.mapping.front_end import Observations
from slam.mapping.lift_edges import lift_edges
from slam.mapping.map import Map
from slam.mapping.part_measurements import refine_part
from slam.mapping.refine import refine_map
from slam.mapping.setup import Setup
from slam.mapping.solve_pose_graph import solve_pose_graph
from tests.slam.mapping.exact_flight import registration, seen, setup_of, truth
from tests.slam.mapping.made_map import made_map

PARTS = [(0, 1), (1, 2), (3, 4), (4, 5), (5, 6), (6, 7), (3, 5), (8, 9), (9, 10), (10, 11)]
"""Three keyframes, five, four."""


def observations(w_T_b: np.ndarray, registrations: tuple[Registration, ...]) -> Observations:
    store = FeatureStore()
    for pose in w_T_b:
        pixel = seen(pose)[1]
        store.append(Features(Points.alike(pixel), np.zeros((len(pixel), 4), np.float32)))
    n = len(w_T_b)
    return Observations(store, np.arange(n), 3.0 * np.arange(n), (None,) * n, registrations, (), n, Counter())


def refined(setup: Setup, w_T_b: np.ndarray, rejected: tuple[tuple[int, int], ...] = ()) -> Map:
    """All parts, with some of the graph's edges rejected."""
    registrations = tuple(registration(w_T_b, *pair) for pair in PARTS)
    edges = lift_edges(registrations, setup)
    solution = solve_pose_graph(edges, setup)
    kept = np.array([pair not in rejected for pair in PARTS])
    solved = replace(
        made_map(solution.w_T_b, solution.component),
        observations=observations(w_T_b, registrations),
        edges=edges,
        graph=replace(solution, edge_kept=kept),
    )
    return refine_map(solved, setup, silent)


def test_the_largest_part_comes_first_and_each_is_right_by_itself():
    w_T_b = truth()
    found = refined(setup_of(w_T_b), w_T_b)
    assert found.component.tolist() == [2, 2, 2, 0, 0, 0, 0, 0, 1, 1, 1, 1]
    assert np.isfinite(found.covariances).all()
    for part in range(3):
        own = found.component == part
        distances = [
            np.linalg.norm(poses[own, None, :3, 3] - poses[None, own, :3, 3], axis=-1)
            for poses in (found.w_T_b, w_T_b)
        ]
        assert distances[0] == pytest.approx(distances[1], abs=0.01)
        assert found.w_T_b[own, 2, 3] == pytest.approx(w_T_b[own, 2, 3], abs=0.01)


def test_a_barometer_of_the_wrong_sign_beside_gps_is_left_out_with_a_remark():
    w_T_b = truth()
    setup = setup_of(w_T_b, sonar=False)
    positions = tuple(Position(k, w_T_b[k, :3, 3], np.full(3, 0.02)) for k in range(len(w_T_b)))
    without = replace(setup, readings=replace(setup.readings, positions=positions))

    def found_with(sign: float) -> Map:
        heights = [BarometerHeight(k, 500.0 + sign * z, 0.05) for k, z in enumerate(w_T_b[:, 2, 3])]
        readings = replace(without.readings, heights=tuple(heights))
        return refined(replace(without, readings=readings), w_T_b)

    right, wrong = found_with(1.0), found_with(-1.0)
    assert (right.remarks, right.bundle.uses_barometer) == ((), True)
    assert not wrong.bundle.uses_barometer
    assert "barometer0 is left out of the map: it falls where the camera climbs" in str(wrong.remarks[0])
    own = right.component == 0
    np.testing.assert_allclose(wrong.w_T_b[own], refined(without, w_T_b).w_T_b[own], atol=1e-9)


def test_floor_points_of_all_parts_lie_where_the_keyframes_see_them():
    """Each projects into its keyframe onto one of the features there, and lies on the floor."""
    w_T_b = truth()
    setup = setup_of(w_T_b)
    found = refined(setup, w_T_b)
    points, camera = found.floor_points, found.camera
    assert set(points.keyframe) == {0, 1, 3, 4, 5, 6, 8, 9, 10}, "the last of each part sees none first"
    assert (points.views >= 2).all()
    assert points.std_m.shape == points.b_p_m.shape
    assert (points.std_m > 0).all()
    assert points.on_map(found.w_T_b)[:, 2] == pytest.approx(found.floor_z_m, abs=0.01)
    c_T_b = np.linalg.inv(camera.b_T_c)
    ray = points.b_p_m @ c_T_b[:3, :3].T + c_T_b[:3, 3]
    pixel = ray[:, :2] / ray[:, 2:] * camera.focal_px + camera.center_px
    for k in (0, 5, 9):
        features = seen(w_T_b[k])[1]
        off = np.linalg.norm(pixel[points.keyframe == k][:, None] - features[None], axis=-1)
        assert off.min(axis=1).max() < 1.0


def test_a_refinement_that_did_not_converge_is_a_warning_of_its_part(monkeypatch: pytest.MonkeyPatch):
    w_T_b = truth()
    assert not refined(setup_of(w_T_b), w_T_b).warnings

    def stopped(*given: object, **named: object) -> Bundle:
        return replace(refine_part(*given, **named), not_converged="30 iterations done")

    monkeypatch.setattr("slam.mapping.metric_refinement.refine_part", stopped)
    warnings = [*map(str, refined(setup_of(w_T_b), w_T_b).warnings)]
    assert [line.split(":")[0] for line in warnings] == [
        f"the refinement of {count} keyframes did not converge (30 iterations done)" for count in (5, 4, 3)
    ]
    instruments = setup_of(w_T_b).readings
    assert instruments.ranges
    assert not instruments.positions
    assert all("height sensor" in line and "GPS" not in line for line in warnings)


def test_a_part_whose_edges_were_all_rejected_leaves_no_empty_number():
    w_T_b = truth()
    found = refined(setup_of(w_T_b), w_T_b, rejected=((3, 4), (4, 5), (5, 6), (6, 7), (3, 5)))
    assert found.component.tolist() == [1, 1, 1, -1, -1, -1, -1, -1, 0, 0, 0, 0]
    assert np.isnan(found.w_T_b[3:8]).all()
    assert np.isnan(found.covariances[3:8]).all()
    assert found.bundle is not None


def test_a_part_that_cannot_be_refined_keeps_its_place_and_says_so():
    """Too few points in common: the pose graph's answer, without a covariance."""
    w_T_b = truth()
    setup = setup_of(w_T_b)
    registrations = tuple(registration(w_T_b, *pair) for pair in PARTS)
    edges = lift_edges(registrations, setup)
    solution = solve_pose_graph(edges, setup)
    poor = tuple(replace(r, matches=r.matches[:0]) if r.i >= 8 else r for r in registrations)
    solved = replace(
        made_map(solution.w_T_b, solution.component),
        observations=observations(w_T_b, poor),
        edges=replace(edges, registrations=poor),
        graph=solution,
    )
    found = refine_map(solved, setup, silent)
    assert (found.component >= 0).all()
    assert np.isfinite(found.w_T_b).all()
    assert np.isnan(found.covariances[8:]).all()
    assert np.isfinite(found.covariances[:8]).all()
    assert any("4 keyframes could not be refined" in warning.text for warning in found.warnings)


def test_the_camera_of_the_map_has_the_lens_that_was_estimated() -> None:
    declared = Camera((200.0, 200.0), (87.5, 71.5), (176, 144), (-0.3, 0.1, 0.004, -0.003))
    numbers = np.array([210.0, 209.0, 90.0, 70.0, -0.2, 0.05, 0.001, 0.002, 0.03])
    lens = LensEstimate("brown", numbers, np.ones(9), np.ones(9))
    found = calibrated(declared, SimpleNamespace(b_T_c=declared.b_T_c, lens=lens))  # type: ignore[arg-type]
    assert (*found.focal_px, *found.center_px, *found.distortion) == tuple(numbers.tolist())
    held = calibrated(declared, SimpleNamespace(b_T_c=declared.b_T_c, lens=None))  # type: ignore[arg-type]
    assert held.distortion == declared.distortion
