"""Live positions compared with the final map."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from slam.evaluation.live_error import live_error


def poses(n: int = 8) -> np.ndarray:
    w_T_b = np.tile(np.eye(4), (n, 1, 1))
    w_T_b[:, :3, 3] = np.random.default_rng(3).normal(size=(n, 3))
    return w_T_b


def turned(w_T_b: np.ndarray) -> np.ndarray:
    """The same map in another unit of length, turned and shifted."""
    moved = w_T_b.copy()
    moved[:, :3, 3] = 0.4 * w_T_b[:, :3, 3] @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]).T + [
        5.0,
        2.0,
        1.0,
    ]
    return moved


def test_another_gauge_is_no_error():
    final = SimpleNamespace(frame_index=np.arange(8), w_T_b=poses())
    assert live_error(np.arange(8), turned(poses()), final) < 1e-12


def test_noise_is_measured_on_the_shared_and_placed_keyframes():
    final = SimpleNamespace(frame_index=np.arange(3000), w_T_b=poses(3000))
    live = poses(3000)
    live[:, 0, 3] += np.random.default_rng(0).normal(0, 0.1, 3000)
    live[::7] = np.nan
    frames = np.where(np.arange(3000) % 5 == 0, 9999, np.arange(3000))
    assert live_error(frames, live, final) == pytest.approx(0.1, rel=0.05)


def test_two_keyframes_are_no_comparison():
    final = SimpleNamespace(frame_index=np.arange(2), w_T_b=poses(2))
    assert np.isnan(live_error(np.arange(2), poses(2), final))
