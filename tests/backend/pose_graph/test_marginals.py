from dataclasses import replace

import gtsam
import numpy as np
import pytest

from backend import se3
from backend.pose_graph.bayes_tree import bayes_tree, clique_covariances
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.marginals import pose_covariances
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.solve import solve_pose_graph
from backend.pose_graph.unary_factors import fixed
from backend.se3 import PLANAR
from tests.backend.synthetic import graph

EMBEDDED = np.ix_([3, 4, 2], [3, 4, 2])


def _anchored(seed: int, dimension: int) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    problem = from_pose_graph(graph(seed, dimension, n=25, noise=0.1))
    factors, values = problem.edge_factors(), problem.values(problem.initial)
    noise = gtsam.noiseModel.Isotropic.Sigma(problem.dof, 1e-2)
    if dimension == 2:
        factors.add(gtsam.PriorFactorPose2(0, values.atPose2(0), noise))
    else:
        factors.add(gtsam.PriorFactorPose3(0, values.atPose3(0), noise))
    return factors, values


@pytest.mark.parametrize("dimension", [2, 3])
def test_agrees_with_the_dense_inverse(dimension: int):
    factors, values = _anchored(1, dimension)
    J, _ = factors.linearize(values).jacobian()
    dense = np.linalg.inv(J.T @ J)
    d = 3 if dimension == 2 else 6
    ours = pose_covariances(factors, values, range(25))
    for k in range(25):
        block = dense[d * k : d * k + d, d * k : d * k + d]
        mine = ours[k][EMBEDDED] if dimension == 2 else ours[k]
        np.testing.assert_allclose(mine, block, rtol=1e-6, atol=1e-12)
        if dimension == 2:
            assert np.count_nonzero(ours[k]) <= 9


@pytest.mark.parametrize("by_qr", [False, True])
@pytest.mark.parametrize("dimension", [2, 3])
def test_cliques_have_the_joint_covariances_of_gtsam(dimension: int, by_qr: bool):
    factors, values = _anchored(3, dimension)
    tree = bayes_tree(factors, values, by_qr=by_qr)
    assert tree is not None
    theirs, done = gtsam.Marginals(factors, values), set()
    for clique in clique_covariances(tree, values):
        done.update(clique.frontals)
        for a, b in zip(clique.frontals, list(clique.rows)[1:], strict=False):
            low, high = min(a, b), max(a, b)
            expected = theirs.jointMarginalCovariance(gtsam.KeyVector([low, high])).fullMatrix()
            np.testing.assert_allclose(clique.of(low, high), expected, rtol=1e-6, atol=1e-9)
    assert done == set(range(25))


def test_a_floating_part_is_nan_and_the_other_is_answered():
    factors, values = _anchored(2, 3)
    alone = pose_covariances(factors, values, range(25))
    for k in (50, 51):
        values.insert(k, gtsam.Pose3())
    factors.add(gtsam.BetweenFactorPose3(50, 51, gtsam.Pose3(), gtsam.noiseModel.Unit.Create(6)))
    both = pose_covariances(factors, values, [*range(25), 50, 51])
    assert np.isnan(both[25:]).all()
    np.testing.assert_allclose(both[:25], alone, rtol=1e-6, atol=1e-12)


def test_a_part_with_an_open_direction_is_nan():
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(0, gtsam.Pose3())
    factors.add(gtsam.GPSFactor(0, np.zeros(3), gtsam.noiseModel.Unit.Create(3)))
    assert np.isnan(pose_covariances(factors, values, [0])).all()


def test_a_key_that_is_not_there_is_nan():
    factors, values = _anchored(2, 3)
    assert np.isnan(pose_covariances(factors, values, [999])).all()


def test_a_message_that_cannot_be_decoded_is_an_error_like_any_other(monkeypatch: pytest.MonkeyPatch):
    """gtsam names the variable by a letter that may be no letter."""

    def raised(*_: object, **__: object) -> None:
        b"\x9a".decode()

    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(0, gtsam.Pose3())
    factors.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Unit.Create(6)))
    monkeypatch.setattr(gtsam.GaussianFactorGraph, "eliminateMultifrontal", raised)
    assert bayes_tree(factors, values) is None


@pytest.mark.parametrize(("std", "known"), [(1e4, True), (1e6, False)])
def test_a_variance_beyond_the_limit_is_nan(std: float, known: bool):
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.push_back(fixed(0, np.eye(4), 3).factor)
    noise = gtsam.noiseModel.Isotropic.Sigma(6, std)
    factors.push_back(gtsam.BetweenFactorPose3(0, 1, gtsam.Pose3(), noise))
    for k in range(2):
        values.insert(k, gtsam.Pose3())
    found = pose_covariances(factors, values, range(2))
    assert np.isfinite(found[0]).all()
    assert np.isfinite(found[1]).all() == known


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("information", [1e12, 1e15, 1e17])
def test_an_edge_of_very_high_information_binds_two_poses_and_hides_nothing(
    dimension: int, information: float
):
    """The two poses are as one: their covariances are those of a pose of the chain that the edge shortens."""
    made = chain(dimension, information)
    solved = solve_pose_graph(made)
    assert solved.status == "ok"
    assert solved.covariances is not None
    rows = PLANAR if dimension == 2 else np.arange(6)
    found = solved.covariances[:, rows[:, None], rows]
    # Vertex 3 is at the end of three edges; vertex 8 is the same body seen from another frame.
    T = solved.w_T_b
    steps = [se3.adjoint(se3.inverse(T[3]) @ T[k])[np.ix_(rows, rows)] for k in (1, 2, 3)]
    expected = sum(A @ A.T for A in steps) / 0.01
    np.testing.assert_allclose(found[3], expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())
    A = se3.adjoint(se3.inverse(T[8]) @ T[3])[np.ix_(rows, rows)]
    expected = A @ expected @ A.T
    np.testing.assert_allclose(found[8], expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


def chain(dimension: int, information: float) -> PoseGraph:
    """Eleven edges of the information 0.01, and an exact one from vertex 3 to vertex 8 of another."""
    made = graph(1, dimension, n=12, noise=0.0)
    i, j = np.append(made.i[:11], 3), np.append(made.j[:11], 8)
    weight = np.append(np.full(11, 0.01), information)
    return replace(
        made,
        i=i,
        j=j,
        ij_T=se3.inverse(made.poses[i]) @ made.poses[j],
        information=weight[:, None, None] * np.eye(3 if dimension == 2 else 6),
    )


def test_a_long_chain_of_exact_steps_keeps_its_digits():
    """Pictures of a floor: tilt and shift of a step err together, and only the gauge tells x, y and heading.

    From a root at the far end, errors of rounding would grow to a whole covariance within 400 poses.
    """
    n, height_m = 280, 0.8
    lane, x = np.divmod(np.arange(n), 17)
    w_T = np.tile(np.eye(4), (n, 1, 1))
    w_T[:, :3, 3] = np.column_stack([0.25 * np.where(lane % 2 == 0, x, 16 - x), lane, np.full(n, height_m)])
    lever = np.eye(6)
    lever[3:5, :2] = height_m * np.array([[0.0, 1.0], [-1.0, 0.0]])
    step = gtsam.noiseModel.Gaussian.Covariance(
        lever @ np.diag([2.5e-7, 2.5e-7, 1.6e-8, *[2.5e-9] * 3]) @ lever.T
    )
    level = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.02, 0.02, 1e6, 1e6, 1e6, 0.01]))
    poses, values, factors = list(map(gtsam.Pose3, w_T)), gtsam.Values(), gtsam.NonlinearFactorGraph()
    factors.add(gtsam.PriorFactorPose3(0, poses[0], gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    for k, pose in enumerate(poses):
        values.insert(k, pose)
        factors.add(gtsam.PriorFactorPose3(k, pose, level))
        for j in range(max(k - 2, 0), k):
            factors.add(gtsam.BetweenFactorPose3(j, k, poses[j].between(pose), step))
    J, _ = factors.linearize(values).jacobian()
    dense = np.diag(np.linalg.inv(J.T @ J)).reshape(n, 6)
    found = np.diagonal(pose_covariances(factors, values, range(n)), axis1=1, axis2=2)
    np.testing.assert_allclose(found, dense, rtol=1e-7)
