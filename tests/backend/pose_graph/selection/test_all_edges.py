"""Graphs without a false loop lose no loop, however their noise was stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend import se3
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.solve import solve_pose_graph
from backend.quantiles import chi_square_quantile

COUNT, LANE = 48, 8
LOOPS = 12


def true_poses() -> np.ndarray:
    """Poses (n, 4, 4) along lanes of 8 m, 1 m apart, flown there and back."""
    row, column = np.divmod(np.arange(COUNT), LANE)
    back = row % 2 == 1
    x = np.where(back, LANE - 1 - column, column)
    return se3.from_planar(np.column_stack([x, row, np.where(back, np.pi, 0.0)]).astype(float))


def lanes(std: np.ndarray, stated: float, seed: int) -> PoseGraph:
    """True loops between neighbouring lanes; the noise is ``std`` (3,), and ``stated`` times it is stated."""
    rng, w_T = np.random.default_rng(seed), true_poses()
    apart = np.linalg.norm(w_T[:, None, :3, 3] - w_T[:, :3, 3], axis=2)
    pairs = np.argwhere(np.triu(apart < 1.5, 3))
    pairs = pairs[rng.permutation(len(pairs))[:LOOPS]]
    i, j = np.concatenate([np.column_stack([np.arange(COUNT - 1), np.arange(1, COUNT)]), pairs]).T
    noise = se3.from_planar(rng.normal(size=(len(i), 3)) * std)
    return PoseGraph(
        dimension=2,
        ids=np.arange(COUNT),
        poses=np.full((COUNT, 4, 4), np.nan),
        i=i,
        j=j,
        ij_T=se3.inverse(w_T[i]) @ w_T[j] @ noise,
        information=np.tile(np.diag((stated * std) ** -2.0), (len(i), 1, 1)),
        fixed=np.zeros(COUNT, dtype=bool),
    )


@pytest.mark.parametrize("seed", [0, 4, 6])
def test_large_noise_that_is_stated_loses_no_loop_where_all_edges_agree(seed: int) -> None:
    """Turns of 0.5 rad an edge: to first order their sum predicts no loop."""
    graph = lanes(np.full(3, 0.5), 1.0, seed)
    solution = solve_pose_graph(graph, covariances=False)
    assert 2 * solution.error < chi_square_quantile(0.999, 3 * LOOPS)
    assert solution.edge_kept.all()
    assert solution.status == "ok"


@pytest.mark.parametrize("factor", [5.0, 10.0, 100.0])
def test_deviations_stated_too_small_are_told_by_their_factor(factor: float) -> None:
    graph = lanes(np.array([0.05, 0.05, 0.01]), 1 / factor, 0)
    solution = solve_pose_graph(graph, covariances=False)
    assert solution.edge_kept.all()
    told = solution.status.split("take deviations ")[1].split()[0]
    assert float(told) == pytest.approx(factor, rel=0.3)
    right = solve_pose_graph(lanes(np.array([0.05, 0.05, 0.01]), 1.0, 0), covariances=False)
    np.testing.assert_allclose(solution.w_T_b, right.w_T_b, atol=1e-3)


def test_a_false_loop_beside_deviations_stated_too_small_is_still_rejected() -> None:
    graph = lanes(np.array([0.05, 0.05, 0.01]), 1.0, 0)
    ij_T = graph.ij_T.copy()
    ij_T[-1] = ij_T[-1] @ se3.from_planar(np.array([[3.0, 2.0, 1.0]]))[0]
    solution = solve_pose_graph(replace(graph, ij_T=ij_T), covariances=False)
    assert np.flatnonzero(~solution.edge_kept).tolist() == [len(ij_T) - 1]


@pytest.mark.parametrize(("std", "seed"), [(0.1, 2), (0.15, 1)])
def test_a_map_that_false_loops_pull_together_does_not_explain_them(std: float, seed: int) -> None:
    """In a map a tenth as large as the true one, a false loop anywhere would often agree by chance."""
    made, count = lanes(np.array([std, std, std / 5]), 1.0, seed), 30
    rng = np.random.default_rng(seed)
    i = rng.integers(0, COUNT - 10, count)
    j = i + rng.integers(8, COUNT - i - 1)
    wrong = replace(
        made,
        i=np.append(made.i, i),
        j=np.append(made.j, j),
        ij_T=np.concatenate([made.ij_T, made.ij_T[rng.integers(COUNT - 1, len(made.i), count)]]),
        information=np.concatenate([made.information, made.information[:count]]),
    )
    assert solve_pose_graph(wrong, covariances=False).edge_kept[-count:].sum() <= 1


@pytest.mark.parametrize("loops", [1, 2, 3])
def test_a_row_of_false_loops_is_no_common_factor(loops: int) -> None:
    """They agree with each other, and alone contradict odometry, which takes the error in many shares."""
    made = lanes(np.array([0.05, 0.05, 0.01]), 1.0, 0)
    steps = np.flatnonzero(np.abs(made.i - made.j) == 1)
    i, w_T = np.arange(loops) + 4, true_poses()
    off = se3.from_planar(np.array([[4.0, 2.0, 0.5]]))[0]
    graph = replace(
        made,
        i=np.append(made.i[steps], i),
        j=np.append(made.j[steps], i + 30),
        ij_T=np.concatenate([made.ij_T[steps], se3.inverse(w_T[i]) @ off @ w_T[i + 30]]),
        information=np.concatenate([made.information[steps], made.information[:loops]]),
    )
    solution = solve_pose_graph(graph, covariances=False)
    assert not solution.edge_kept[len(steps) :].any()
