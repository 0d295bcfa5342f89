"""Where attitudes are very uncertain, another start may lead to a lower minimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend import se3
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.lower_minimum import lower_minimum
from backend.pose_graph.solve import solve_pose_graph
from tests.backend.synthetic import graph

COUNT = 50


def uncertain(seed: int) -> PoseGraph:
    """A spatial spiral whose edges have deviations from millimetres to metres, in mixed directions."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 4 * np.pi, COUNT)
    w_T = se3.exp(np.column_stack([0.1 * np.sin(3 * t), 0.1 * np.cos(2 * t), t, np.zeros((COUNT, 3))]))
    w_T[:, :3, 3] = np.column_stack([10 * np.sin(t), 5 * np.sin(2 * t), t / 6])
    steps = np.column_stack([np.arange(COUNT - 1), np.arange(1, COUNT)])
    first = rng.permutation(COUNT // 2)[:12]
    i, j = np.concatenate([steps, np.column_stack([first, first + COUNT // 2])]).T
    axes = np.linalg.qr(rng.normal(size=(len(i), 6, 6)))[0]
    std = 4 * 10 ** rng.uniform(-2.5, 0, (len(i), 6))
    noise = np.einsum("mab,mb->ma", axes, std * rng.normal(size=(len(i), 6)))
    information = axes @ (std[:, :, None] ** -2 * np.swapaxes(axes, 1, 2))
    return PoseGraph(
        dimension=3,
        ids=np.arange(COUNT),
        poses=w_T @ se3.exp(rng.normal(size=(COUNT, 6)) * 2),
        i=i,
        j=j,
        ij_T=se3.inverse(w_T[i]) @ w_T[j] @ se3.exp(noise),
        information=(information + np.swapaxes(information, 1, 2)) / 2,
        fixed=np.zeros(COUNT, dtype=bool),
    )


@pytest.mark.parametrize("seed", [2, 10])
def test_a_lower_minimum_is_found_and_is_one(seed: int) -> None:
    made = uncertain(seed)
    first = solve_pose_graph(made, covariances=False)
    lower = lower_minimum(made, first)
    assert lower is not None
    again = solve_pose_graph(replace(made, poses=lower), covariances=False)
    assert again.error < 0.6 * first.error
    np.testing.assert_allclose(again.w_T_b[1:, :3, 3], lower[1:, :3, 3], atol=0.05)


def test_the_lowest_minimum_has_no_lower_one() -> None:
    made = graph(4, 3)
    assert lower_minimum(made, solve_pose_graph(made, covariances=False)) is None
