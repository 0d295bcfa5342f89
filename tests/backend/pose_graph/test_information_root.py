import numpy as np
import pytest

from backend.pose_graph.information_root import covariance_root, joint_root, marginal_root


@pytest.mark.parametrize("n", [1, 8, 200])
def test_the_marginal_information_is_the_inverse_of_a_part_of_the_covariance(n: int):
    rng = np.random.default_rng(n)
    W = np.triu(rng.normal(size=(n, n))) + 2 * np.sqrt(n) * np.eye(n)
    covariance = np.linalg.inv(W.T @ W)
    for kept in (rng.permutation(n)[: n // 3], np.arange(n), np.arange(0)):
        U = marginal_root(W, kept)
        assert np.array_equal(U, np.triu(U))
        np.testing.assert_allclose(
            np.linalg.inv(U.T @ U), covariance[np.ix_(kept, kept)], rtol=1e-9, atol=1e-13
        )
    np.testing.assert_allclose(covariance_root(W) @ covariance_root(W).T, covariance, rtol=1e-9, atol=1e-13)


def test_a_clique_adds_its_own_equations_to_the_information_on_its_separator():
    rng = np.random.default_rng(0)
    R, S, U = np.triu(rng.normal(size=(3, 3))), rng.normal(size=(3, 2)), np.triu(rng.normal(size=(2, 2)))
    W, rows = joint_root(R, S, U), np.hstack([R, S])
    expected = rows.T @ rows
    expected[3:, 3:] += U.T @ U
    np.testing.assert_allclose(W.T @ W, expected)
    assert np.array_equal(W, np.triu(W))


def test_a_singular_root_has_no_covariance():
    assert np.isnan(covariance_root(np.diag([1.0, 0.0]))).all()
    assert np.isnan(covariance_root(joint_root(np.eye(1), np.ones((1, 1)), np.full((1, 1), np.nan)))).any()
    assert np.isnan(marginal_root(np.full((200, 200), np.nan), np.arange(3))).any()
