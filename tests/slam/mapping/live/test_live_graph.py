"""Registrations that become edges in any order of arrival, and readings of an IMU where there are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend import se3
from backend.measurements import Inertial, InertialNoise, InertialReadings, SlantRange
from backend.pose_graph.incremental.estimation import Incremental
from frontend.registration import Registration
from slam.mapping.config import PipelineConfig
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.live.graph import LiveGraph
from slam.mapping.live.loop_candidates import near
from tests.backend.made_motion import fly
from tests.slam.small_flight import flown

STEP_M = 0.2


@pytest.fixture(scope="module")
def camera():
    return flown(0).camera


def pose(k: int) -> np.ndarray:
    w_T_b = np.eye(4)
    w_T_b[:3, 3] = k * STEP_M, 0.0, 1.0
    return w_T_b


def registration(camera, i: int, j: int, pose=pose) -> Registration:
    a, b = (camera.floor_H_image(pose(k)) for k in (i, j))
    i_H_j = np.linalg.inv(a) @ b
    matches = np.zeros((0, 2), dtype=np.int64)
    return Registration(i, j, None, matches, i_H_j / i_H_j[2, 2], 0.01 * np.eye(8), 0.1, 0.5)


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


def gap_flown(camera, has_range: bool = True, lag_s: float = 0.0, stated: float = 1.0):
    """Return the live graph and the true poses of a flight that sees nothing for 1.5 s.

    Readings end ``lag_s`` before each picture. As from a camera that starts with the IMU, there are none
    before the first. The stated noise of the accelerometer is ``stated`` times the true one.
    """
    rng = np.random.default_rng(1)
    flight, imu_s, noise = fly(rng), np.arange(-0.1, 10.0, 0.005), InertialNoise()
    white = [std / np.sqrt(0.005) for std in (noise.gyro_density, noise.accel_density)]
    gyro, accel = (
        true + rng.normal(0, std, true.shape)
        for true, std in zip((flight.body_rate(imu_s), flight.force(imu_s)), white, strict=True)
    )
    stated_noise = replace(noise, accel_density=stated * noise.accel_density)
    stamps_s = np.concatenate([np.arange(0.0, 6.0, 0.3), np.arange(7.5, 9.0, 0.3)])
    truth, angles, slant = flight.w_T_b(stamps_s), flight.angles.at(stamps_s), flight.slant(stamps_s)
    graph = LiveGraph(camera, PipelineConfig())
    for k, now_s in enumerate(stamps_s.tolist()):
        ranges = (SlantRange(0, float(slant[k]), 0.005),) if has_range else ()
        level = angles[k : k + 1, :2]
        here = KeyframeReadings(np.array([now_s]), (), ranges, (), (), 0.0, 0.0, level, level * 0 + 3e-3)
        read = (imu_s > graph.newest_s - 0.02) & (imu_s < now_s + 0.02 - lag_s)
        inertial = Inertial(InertialReadings(imu_s[read], gyro[read], accel[read]), noise)
        linked = k > 0 and now_s - stamps_s[k - 1] < 1.0
        found = [registration(camera, k - 1, k, truth.__getitem__)] if linked else []
        graph.add(here, found, replace(inertial, noise=stated_noise) if k else None)
    return graph, truth


def test_readings_of_an_imu_join_the_keyframes_behind_a_gap(camera):
    graph, truth = gap_flown(camera)
    off_m = _off_m(graph.poses(), truth)
    assert graph.bridged == 1
    assert off_m[:20].max() < 0.05
    # Over 1.5 s the noise of the accelerometer alone is 5 cm, and the velocity before adds to it.
    assert off_m[20:].max() < 0.25


def test_vibration_is_found_whatever_noise_is_stated(camera, monkeypatch):
    stds_m = []
    for stated in (0.1, 1.0):
        solver = Incremental()
        monkeypatch.setattr("slam.mapping.live.graph.Incremental", lambda solver=solver: solver)
        gap_flown(camera, stated=stated)
        stds_m.append(np.sqrt(np.trace(solver.bridges()[0].covariance[3:, 3:])))
    assert 0.8 < stds_m[0] / stds_m[1] < 1.25


@pytest.mark.parametrize("missing", [{"has_range": False}, {"lag_s": 0.1}])
def test_without_metres_or_readings_up_to_the_picture_the_gap_stays(camera, missing):
    graph, _ = gap_flown(camera, **missing)
    assert graph.bridged == 0
    assert np.isfinite(graph.poses()[:20]).all()
    assert np.isnan(graph.poses()[20:]).all()


def _off_m(w_T_b: np.ndarray, truth: np.ndarray) -> np.ndarray:
    moved = [se3.inverse(T[:1]) @ T for T in (w_T_b, truth)]
    return np.linalg.norm((moved[0] - moved[1])[:, :3, 3], axis=1)


def test_places_beyond_reach_and_unknown_ones_are_not_near():
    w_p_b = np.array([[0.0, 0, 0], [np.nan] * 3, [1.0, 0, 0], [0.5, 0, 9.0]])
    among = np.array([3, 4, 7, 8])
    assert near(w_p_b, np.zeros(3), 0.6, among, 3) == [3, 8]
    assert near(w_p_b, np.zeros(3), 2.0, among, 2) == [3, 8]
