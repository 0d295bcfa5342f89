"""Parts of a chain without ranges, scaled to metres by the heights that the filter tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend.ekf.inputs import VisualStep
from backend.ekf.results import States
from backend.pose_graph.heights import HeightEstimate
from slam.evaluation import evaluate
from slam.mapping.inertial.bridges import heights_by_accelerometer
from slam.mapping.inertial.metres import in_metres
from slam.mapping.map import Map
from slam.mapping.pipeline import optimize
from tests.benchmarks.instrument_flights import KINDS, flown
from tests.slam.mapping.made_map import CAMERA, made_map

RATIO = np.array([2.0, 2.0, 2.0, 0.5, 0.5, 0.5])


LEVER_M = np.array([0.1, 0.0, -0.15])


def in_heights(b_p_c_m: np.ndarray = np.zeros(3)) -> Map:
    """Two parts of three poses. The camera is one unit high, and moves by one."""
    w_T_b = np.tile(np.eye(4), (6, 1, 1))
    w_T_b[:, :3, :3] = Rotation.from_euler("z", [[0.0], [1.0], [2.0]] * 2).as_matrix()
    w_T_b[:, 0, 3], w_T_b[:, 2, 3] = [0, 1, 2, 0, 1, 2], 1.0
    w_T_b[:, :3, 3] -= w_T_b[:, :3, :3] @ b_p_c_m
    chain = made_map(w_T_b, np.array([0, 0, 0, 1, 1, 1]))
    b_T_c = CAMERA.b_T_c.copy()
    b_T_c[:3, 3] = b_p_c_m
    covariances = np.tile(0.01**2 * np.eye(6), (6, 1, 1))
    return replace(chain, metric=False, camera=replace(CAMERA, b_T_c=b_T_c), covariances=covariances)


def heights(height_m: np.ndarray, log_std: float) -> HeightEstimate:
    return HeightEstimate(height_m, np.full(6, log_std), np.isfinite(height_m))


def test_each_part_gets_its_own_heights_and_the_error_of_its_scale():
    height_m = RATIO.copy()
    height_m[0] = np.nan  # before the readings begin
    found = in_metres(in_heights(), heights(height_m, 0.03), 0.04)
    assert found.w_T_b[:, 0, 3] == pytest.approx([0, 2, 4, 0, 0.5, 1])
    assert found.height_m == pytest.approx(RATIO)
    assert found.metric
    std = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))
    assert std[:, 0] == pytest.approx(0.01)
    # 5 % of the way from the part's first pose, which 3 and 4 % make, besides a hundredth of a height.
    way = np.sqrt((std[:, 3:5] ** 2).sum(axis=1) - 2 * (0.01 * RATIO) ** 2)
    assert way == pytest.approx(0.05 * RATIO * [0, 1, 2, 0, 1, 2], abs=1e-9)


def test_a_part_without_a_known_height_stays_as_it_is():
    chain = in_heights()
    found = in_metres(chain, heights(np.where(RATIO < 1, np.nan, RATIO), 0.0), 0.0)
    assert found.w_T_b[3:] == pytest.approx(chain.w_T_b[3:])
    assert found.covariances[3:] == pytest.approx(chain.covariances[3:])
    assert found.w_T_b[:3, 0, 3] == pytest.approx([0, 2, 4])


def test_a_camera_below_the_body_moves_as_far_as_the_heights_say():
    chain = in_heights(LEVER_M)
    camera_m = 10.0
    found = in_metres(chain, heights(np.full(6, camera_m - LEVER_M[2]), 0.0), 0.0)
    b_T_c = np.eye(4)
    b_T_c[:3, 3] = LEVER_M
    w_T_c = found.w_T_b @ b_T_c
    assert w_T_c[:, 2, 3] == pytest.approx(camera_m)
    assert w_T_c[:, 0, 3] == pytest.approx(10 * np.array([0, 1, 2, 0, 1, 2]))


@pytest.mark.parametrize("lever_m", [0.0, 0.15])
def test_the_path_is_compared_with_steps_of_the_camera_where_it_is_on_the_body(lever_m):
    """The steps are exact to a thousandth. Body heights in their place would be off by a sixth."""
    b_T_c, n = np.eye(4), 5
    b_T_c[2, 3] = -lever_m
    w_T_c = np.tile(np.eye(4), (n, 1, 1))
    w_T_c[:, 0, 3], w_T_c[:, 2, 3] = 0.3 * np.arange(n), 0.8
    w_T_c[:, :3, :3] = Rotation.from_euler("z", 0.2 * np.arange(n)[:, None]).as_matrix()
    seen = np.linalg.inv(w_T_c[:-1]) @ w_T_c[1:]
    seen[:, :3, 3] /= 0.8
    steps = tuple(VisualStep(k, k + 1, seen[k], 1e-6 * np.eye(6)) for k in range(n - 1))
    w_T_b = w_T_c @ np.linalg.inv(b_T_c)
    clone_T_b = np.concatenate([np.eye(4)[None], np.linalg.inv(w_T_b[:-1]) @ w_T_b[1:]])
    sixes, twelves = np.zeros((n, 6, 6)), np.tile(1e-4 * np.eye(12), (n, 1, 1))
    states = States(
        w_T_b=w_T_b, covariances=sixes, w_v_m_s=np.zeros((n, 3)), w_a_m_s2=np.zeros((n, 3)), errors={},
        errors_std={}, motion_covariances=twelves, clone_T_b=clone_T_b, clone_T_b_covariances=sixes,
        fixed_clone_covariances=sixes,
    )  # fmt: skip
    found = heights_by_accelerometer(states, steps, (0.0, 0.0, -lever_m))
    assert found is not None
    assert found.height_m == pytest.approx(0.8 + lever_m)
    off = tuple(replace(step, i_T_j=step.i_T_j + 0.1 * np.eye(4, k=3)) for step in steps)
    assert heights_by_accelerometer(states, off, (0.0, 0.0, -lever_m)) is None


@pytest.mark.slow
def test_without_ranges_a_look_alike_behind_a_gap_does_not_join_the_halves():
    """The floor repeats after 3.2 m; joined there, the map was 4 m off, and its covariances a centimetre."""
    flight = replace(flown(KINDS["gap of 5 s"], 1), sonar=None)
    estimate = optimize(flight)
    found = evaluate(estimate, flight)
    assert set(estimate.component.tolist()) == {0, 1}
    assert found.ate_m.max < 0.1
    assert found.loops.false_kept == 0
    assert found.nees.pose.mean < 12
