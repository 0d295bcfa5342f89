"""Registrations that become edges in any order of arrival."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.registration import Registration
from slam.mapping.config import PipelineConfig
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.live.graph import LiveGraph
from slam.mapping.live.loop_candidates import near
from tests.slam.small_flight import flown

STEP_M = 0.2


@pytest.fixture(scope="module")
def camera():
    return flown(0).camera


def pose(k: int) -> np.ndarray:
    w_T_b = np.eye(4)
    w_T_b[:3, 3] = k * STEP_M, 0.0, 1.0
    return w_T_b


def registration(camera, i: int, j: int) -> Registration:
    a, b = (camera.floor_H_image(pose(k)) for k in (i, j))
    i_H_j = np.linalg.inv(a) @ b
    matches = np.zeros((0, 2), dtype=np.int64)
    return Registration(i, j, "", matches, i_H_j / i_H_j[2, 2], 0.01 * np.eye(8), 0.1, 0.5)


def readings(k: int) -> KeyframeReadings:
    level = np.zeros((1, 2))
    return KeyframeReadings(np.array([5.0 * k]), (), (), (), (), 0.0, 0.0, level, level + 0.01)


def test_keyframes_without_a_link_wait_for_a_loop(camera):
    graph = LiveGraph(camera, PipelineConfig())
    graph.add(readings(0), [])
    graph.add(readings(1), [registration(camera, 0, 1)])
    graph.add(readings(2), [])  # tracking started anew
    graph.add(readings(3), [registration(camera, 2, 3)])
    assert np.isnan(graph.poses()[2:]).all()
    assert np.isfinite(graph.poses()[:2]).all()
    graph.add(readings(4), [registration(camera, 1, 4), registration(camera, 3, 4)])
    expected = [pose(k)[:3, 3] for k in range(5)]
    np.testing.assert_allclose(graph.poses()[:, :3, 3], expected, atol=1e-3)
    assert graph.loops == 1  # 15 s lie between keyframes 1 and 4
    assert graph.rejected == 0
    # Keyframes 2 and 3 are placed after 4, but keep their numbers.
    links = {(link.i, link.j): (link.kind, link.is_kept) for link in graph.links()}
    assert links == {
        (0, 1): ("odometry", True),
        (1, 4): ("loop", True),
        (3, 4): ("odometry", True),
        (2, 3): ("odometry", True),
    }


def test_a_loop_between_placed_keyframes_corrects_the_chain(camera):
    graph = LiveGraph(camera, PipelineConfig())
    graph.add(readings(0), [])
    for k in range(1, 5):
        graph.add(
            readings(k), [registration(camera, k - 1, k), *([registration(camera, 0, 4)] if k == 4 else [])]
        )
    assert graph.loops == 1
    np.testing.assert_allclose(graph.pose(4)[:3, 3], pose(4)[:3, 3], atol=1e-3)


def test_places_beyond_reach_and_unknown_ones_are_not_near():
    w_p_b = np.array([[0.0, 0, 0], [np.nan] * 3, [1.0, 0, 0], [0.5, 0, 9.0]])
    among = np.array([3, 4, 7, 8])
    assert near(w_p_b, np.zeros(3), 0.6, among, 3) == [3, 8]
    assert near(w_p_b, np.zeros(3), 2.0, among, 2) == [3, 8]
