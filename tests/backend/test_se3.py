import gtsam
import numpy as np
import pytest

from backend import se3


def _tangents(seed: int, n: int = 300) -> np.ndarray:
    xi = np.random.default_rng(seed).normal(size=(n, 6)) * np.geomspace(1e-9, 3, n)[:, None]
    angle = np.linalg.norm(xi[:, :3], axis=1)
    xi[:, :3] *= np.minimum(1, 3.14 / angle)[:, None]
    return xi


def test_log_inverts_exp_and_agrees_with_gtsam():
    xi = _tangents(1)
    T = se3.exp(xi)
    np.testing.assert_allclose(se3.log(T), xi, atol=1e-9)
    oracle = [gtsam.Pose3.Logmap(gtsam.Pose3(matrix)) for matrix in T]
    np.testing.assert_allclose(se3.log(T), oracle, atol=1e-7)


def test_log_at_half_a_turn():
    xi = np.array([[np.pi - 1e-8, 0, 0, 1, 2, 3], [0, np.pi - 1e-3, 0, 1, 2, 3]])
    np.testing.assert_allclose(se3.exp(se3.log(se3.exp(xi))), se3.exp(xi), atol=1e-9)


def test_adjoint_moves_a_perturbation_to_the_other_side():
    T = se3.exp(_tangents(2, 20))
    xi = _tangents(3, 20)
    np.testing.assert_allclose(
        T @ se3.exp(xi), se3.exp((se3.adjoint(T) @ xi[:, :, None])[..., 0]) @ T, atol=1e-8
    )


def test_inverse_and_planar_round_trip():
    T = se3.exp(_tangents(4))
    np.testing.assert_allclose(T @ se3.inverse(T), np.tile(np.eye(4), (len(T), 1, 1)), atol=1e-9)
    xyt = np.random.default_rng(5).uniform(-3, 3, (50, 3))
    np.testing.assert_allclose(se3.to_planar(se3.from_planar(xyt)), xyt, atol=1e-12)


@pytest.mark.parametrize("reflect", [False, True])
def test_nearest_rotations_are_proper(reflect: bool):
    M = np.random.default_rng(6).normal(size=(40, 3, 3))
    if reflect:
        M[:, 0] *= -np.sign(np.linalg.det(M))[:, None]
    R = se3.nearest_rotations(M)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-12)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (40, 1, 1)), atol=1e-12)


def test_cross_matrices_of_one_vector_and_of_many():
    v, u = np.random.default_rng(5).normal(size=(2, 4, 3))
    many = se3.cross_matrix(v)
    np.testing.assert_allclose(np.einsum("nab,nb->na", many, u), np.cross(v, u), atol=1e-14)
    for one, matrix in zip(v, many, strict=True):
        np.testing.assert_array_equal(se3.cross_matrix(one), matrix)
