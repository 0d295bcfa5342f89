"""Motion of a camera over a plane, from projections a moment apart."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from backend.bundle.floor_speed import camera_motion

XY = np.array([[-0.6, -0.4], [0.6, -0.4], [0.6, 0.4], [-0.6, 0.4]])


def cameras(rng: np.random.Generator, n: int) -> np.ndarray:
    """Down-looking poses (n, 4, 4) over the floor, tilted by up to 20 degrees."""
    f_T_c = np.tile(np.eye(4), (n, 1, 1))
    down = Rotation.from_euler("x", 180, degrees=True)
    f_T_c[:, :3, :3] = (Rotation.from_rotvec(rng.normal(0, 0.15, (n, 3))) * down).as_matrix()
    f_T_c[:, :3, 3] = np.column_stack([rng.normal(0, 1, (n, 2)), rng.uniform(0.8, 1.3, n)])
    return f_T_c


def moved(pose: np.ndarray, v: np.ndarray, turn: np.ndarray, by_s: float) -> np.ndarray:
    out = pose.copy()
    out[:3, :3] = Rotation.from_rotvec(by_s * turn).as_matrix() @ pose[:3, :3]
    out[:3, 3] += by_s * v
    return out


def seen(pose: np.ndarray, point: np.ndarray) -> np.ndarray:
    c_p = (point - pose[:3, 3]) @ pose[:3, :3]
    return c_p[:, :2] / c_p[:, 2:]


def speeds(f_T_c: np.ndarray, v: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """By differences of the projections of what is seen in the directions ``XY``."""
    out = []
    for pose, velocity, rate in zip(f_T_c, v, turn, strict=True):
        ray = np.column_stack([XY, np.ones(4)]) @ pose[:3, :3].T
        point = pose[:3, 3] - ray * (pose[2, 3] / ray[:, 2:])
        ends = [seen(moved(pose, velocity, rate, by_s), point) for by_s in (-1e-5, 1e-5)]
        out.append((ends[1] - ends[0]) / 2e-5)
    return np.array(out)


def test_velocity_and_turn_follow_from_how_the_floor_moves_through_the_picture():
    rng = np.random.default_rng(1)
    f_T_c, v, turn = cameras(rng, 6), rng.normal(0, 1, (6, 3)), rng.normal(0, 0.5, (6, 3))
    speed = speeds(f_T_c, v, turn)
    speed[4, 2, 0] = np.nan
    found_v, found_turn = camera_motion(f_T_c, XY, speed)
    known = [0, 1, 2, 3, 5]
    np.testing.assert_allclose(found_v[known], v[known], atol=1e-6)
    np.testing.assert_allclose(found_turn[known], turn[known], atol=1e-6)
    assert np.isnan(found_v[4]).all()


def test_a_narrow_picture_hardly_tells_a_turn_from_a_velocity_and_gives_small_ones_of_both():
    rng = np.random.default_rng(2)
    speed = np.repeat(rng.normal(0, 1, (3, 1, 2)), 4, axis=1) + rng.normal(0, 0.01, (3, 4, 2))
    found_v, found_turn = camera_motion(cameras(rng, 3), 1e-3 * XY, speed)
    assert 0 < np.abs(found_v).max() < 3 * np.abs(speed).max()
    assert 0 < np.abs(found_turn).max() < 3 * np.abs(speed).max()
