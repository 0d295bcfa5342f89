"""Matrices of the isotropic approximation, and the memory that they take."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from backend.pose_graph.synchronization import Factor, Synchronization, assembled

POSES, WIDTH = 60, 6


def blocks(i: np.ndarray, j: np.ndarray) -> tuple[Synchronization, np.ndarray, np.ndarray]:
    """A problem with edges from ``i`` (m,) to ``j``, and blocks of a positive definite matrix for it."""
    rng, edges = np.random.default_rng(0), len(i)
    none = np.empty((edges, 3))
    problem = Synchronization(POSES, i, j, np.empty((edges, 3, 3)), none, none[:, 0], none[:, 0])
    coupling = rng.normal(size=(edges, WIDTH, WIDTH))
    degree = np.bincount(np.concatenate([i, j]), minlength=POSES)
    return problem, (10.0 * degree + 1.0)[:, None, None] * np.eye(WIDTH), coupling


def some_twice() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    i, j = np.sort([rng.choice(POSES, 2, replace=False) for _ in range(200)]).T
    return np.append(i, i[:20]), np.append(j, j[:20])


def dense(problem: Synchronization, diagonal: np.ndarray, coupling: np.ndarray) -> np.ndarray:
    whole = np.zeros((POSES, WIDTH, POSES, WIDTH))
    whole[np.arange(POSES), :, np.arange(POSES)] = diagonal
    for i, j, block in zip(problem.i, problem.j, coupling, strict=True):
        whole[i, :, j] += block
        whole[j, :, i] += block.T
    return whole.reshape(POSES * WIDTH, POSES * WIDTH)


@pytest.mark.parametrize("begin", [0, 1, 7])
def test_poses_before_the_first_are_left_out(begin: int) -> None:
    problem, diagonal, coupling = blocks(*some_twice())
    expected = dense(problem, diagonal, coupling)[begin * WIDTH :, begin * WIDTH :]
    found = assembled(problem, diagonal, coupling, begin)
    np.testing.assert_allclose(found.toarray(), expected, atol=1e-12)


@pytest.mark.parametrize("missing", [0, 1, WIDTH])
def test_a_factor_solves_in_any_order_of_the_poses(missing: int) -> None:
    problem, diagonal, coupling = blocks(*some_twice())
    matrix = assembled(problem, diagonal, coupling)[missing:, missing:]
    rng = np.random.default_rng(1)
    factor, right = Factor(matrix, rng.permutation(POSES)), rng.normal(size=POSES * WIDTH - missing)
    np.testing.assert_allclose(matrix @ factor.solve(right), right, atol=1e-9)
    assert factor.negative == 0


def test_a_matrix_without_the_first_pose_takes_no_copy_of_the_whole() -> None:
    problem, diagonal, coupling = blocks(*np.triu_indices(POSES, 1))
    size = (2 * len(coupling) + POSES) * WIDTH**2 * 12
    tracemalloc.start()
    assembled(problem, diagonal, coupling, 1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.3 * size
