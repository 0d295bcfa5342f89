from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend import se3
from backend.g2o import read_g2o
from backend.pose_graph.certificate import GAP, certify, lower_bound
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.solution import Solution
from backend.pose_graph.solve import solve_pose_graph
from backend.pose_graph.synchronization import Synchronization, descend, elimination_order, isotropic
from tests.backend.synthetic import graph
from tests.benchmarks.graphs import graph_folder, se_sync_optima, se_sync_optimum

FOLDER = graph_folder()


def _synchronization(made: PoseGraph) -> Synchronization:
    d, T = made.dimension, made.ij_T
    weights = isotropic(made.information)
    return Synchronization(len(made.ids), made.i, made.j, T[:, :d, :d], T[:, :d, 3], *weights)


def _isotropic(made: PoseGraph) -> PoseGraph:
    kappa, tau = isotropic(made.information)
    pair = (tau, tau, 2 * kappa) if made.dimension == 2 else (2 * kappa,) * 3 + (tau,) * 3
    return replace(made, information=np.column_stack(pair)[:, :, None] * np.eye(len(pair)))


def _placed(made: PoseGraph, w_T: np.ndarray) -> Solution:
    n, m = len(w_T), len(made.i)
    kept, none = np.ones(m, dtype=bool), ("",) * m
    return Solution(w_T, None, np.zeros(n, dtype=np.int64), kept, none, np.zeros(m), 0.0, 0, True)


def _wound(turns: int, n: int = 20) -> tuple[PoseGraph, np.ndarray]:
    """A ring that closes after one turn, and poses that turn ``turns`` times: a minimum for each."""
    angle = 2 * np.pi * np.arange(n) / n
    step = se3.from_planar(np.array([[1.0, 0, angle[1]]]))
    w_T = se3.from_planar(np.column_stack([np.cos(angle), np.sin(angle), turns * angle]))
    made = PoseGraph(
        2, np.arange(n), w_T, np.arange(n), np.roll(np.arange(n), -1), np.tile(step, (n, 1, 1)),
        np.tile(np.diag([100.0, 100, 400]), (n, 1, 1)), np.zeros(n, dtype=bool),
    )  # fmt: skip
    return made, w_T


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_objective_is_its_definition(dimension: int):
    made = graph(1, dimension, n=12)
    problem, w_T = _synchronization(made), made.poses
    total = 0.0
    for k, (i, j) in enumerate(zip(made.i, made.j, strict=True)):
        left = w_T[j] - w_T[i] @ made.ij_T[k]
        total += problem.kappa[k] * (left[:dimension, :dimension] ** 2).sum()
        total += problem.tau[k] * (left[:dimension, 3] ** 2).sum()
    assert problem.objective(w_T[:, :dimension, :dimension], w_T[:, :dimension, 3]) == pytest.approx(total)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_the_optimum_of_a_graph_of_moderate_noise_is_certified(dimension: int, seed: int):
    made = graph(seed, dimension)
    solution = solve_pose_graph(made, covariances=False)
    found = certify(made, solution)
    assert found.certified
    assert 0 <= found.gap <= GAP
    assert found.reason == ""
    assert found.error_bound <= solution.error


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_bound_meets_the_error_where_covariances_are_isotropic(dimension: int):
    made = _isotropic(graph(5, dimension))
    solution = solve_pose_graph(made, covariances=False)
    found = certify(made, solution)
    assert 0.999 * solution.error < found.error_bound <= solution.error * (1 + 1e-9)
    assert "no poses have an error below" in found.sentence(solution.error)


@pytest.mark.parametrize("turns", [0, 2, 3])
def test_a_minimum_that_is_not_the_global_one_is_not_certified(turns: int):
    made, w_T = _wound(turns)
    found = certify(made, _placed(made, w_T))
    assert not found.certified
    assert found.objective > 100
    assert found.lower_bound <= 1e-6
    assert "not certified" in found.sentence(found.objective / 2)


def test_an_exact_graph_and_a_tree_are_certified():
    made, w_T = _wound(1)
    assert certify(made, _placed(made, w_T)).certified
    tree = replace(made, i=made.i[:-1], j=made.j[:-1], ij_T=made.ij_T[:-1], information=made.information[:-1])
    assert certify(tree, _placed(tree, w_T)).certified


@pytest.mark.parametrize("dimension", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_no_poses_lie_below_the_bound(dimension: int):
    """From far starts, with noise beyond what can be certified: descents end above the bound, always."""
    made = graph(3, dimension, n=15, noise=15.0)
    problem = _synchronization(made)
    order = elimination_order(problem)
    rng = np.random.default_rng(0)
    lowest, bounds = np.inf, []
    for start in range(12):
        if start == 0:
            w_R = made.poses[:, :dimension, :dimension]
        elif dimension == 2:
            w_R = se3.from_planar(rng.uniform(-3, 3, (15, 3)))[:, :2, :2]
        else:
            w_R = Rotation.random(15, rng=rng).as_matrix()
        at = descend(problem, w_R, rng.normal(size=(15, dimension)), order)
        lowest = min(lowest, problem.objective(*at))
        bounds.append(lower_bound(problem, *at, order))
    assert max(bounds) <= lowest * (1 + 1e-9)
    assert max(bounds) > 0.05 * lowest


def test_the_least_eigenvalue_is_the_dense_one():
    """The bound at a minimum that is not global, against numpy's eigenvalues of the whole matrix."""
    made = graph(8, 3, n=12, noise=8.0)
    problem = _synchronization(made)
    order = elimination_order(problem)
    w_R, w_t = descend(problem, made.poses[:, :3, :3], made.poses[:, :3, 3], order)
    n, d = 12, 3
    Q = np.zeros((n * (d + 1), n * (d + 1)))
    for k, (i, j) in enumerate(zip(made.i, made.j, strict=True)):
        B = np.zeros((d + 1, n * (d + 1)))
        B[:, j * 4 : j * 4 + 4] = np.eye(4)
        B[0, i * 4] -= 1
        B[0, i * 4 + 1 : i * 4 + 4] -= problem.ij_t_m[k]
        B[1:, i * 4 + 1 : i * 4 + 4] -= problem.ij_R[k].T
        Q += B.T @ np.diag([problem.tau[k], *[problem.kappa[k]] * 3]) @ B
    t, r = np.arange(0, 48, 4), np.setdiff1d(np.arange(48), np.arange(0, 48, 4))
    reduced = Q[np.ix_(r, r)] - Q[np.ix_(r, t)] @ np.linalg.pinv(Q[np.ix_(t, t)]) @ Q[np.ix_(t, r)]
    for k in range(n):
        rows_k = slice(3 * k, 3 * k + 3)
        stacked = np.swapaxes(w_R, 1, 2).reshape(-1, 3)
        block = (reduced @ stacked)[rows_k] @ w_R[k]
        np.testing.assert_allclose(block, block.T, atol=1e-4 * np.abs(block).max())
        reduced[rows_k, rows_k] -= (block + block.T) / 2
    least = np.linalg.eigvalsh(reduced)[0]
    expected = problem.objective(w_R, w_t) + n * d * min(0.0, least)
    bound = lower_bound(problem, w_R, w_t, order)
    assert bound == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_rigid_motion_changes_nothing(dimension: int):
    made = graph(6, dimension)
    solution = solve_pose_graph(made, covariances=False)
    move = se3.from_planar(np.array([[5.0, -3.0, 2.0]]))[0]
    one = certify(made, solution)
    other = certify(made, replace(solution, w_T_b=move @ solution.w_T_b))
    assert other.objective == pytest.approx(one.objective, rel=1e-9)
    assert other.moved_m == pytest.approx(one.moved_m, rel=1e-4)


def test_what_cannot_be_certified_says_why():
    made = graph(6, 2)
    solution = solve_pose_graph(made, covariances=False)
    held = replace(made, fixed=made.ids < 2)
    assert "more than one vertex is held" in certify(held, solution).reason
    open_ = made.information.copy()
    open_[3] = np.diag([1.0, 0, 0])
    assert "leaves a direction open" in certify(replace(made, information=open_), solution).reason


def test_parts_are_certified_by_themselves():
    made, w_T = _wound(2)
    good, right = _wound(1)
    both = PoseGraph(
        2, np.arange(40), np.concatenate([right, w_T]), np.concatenate([good.i, made.i + 20]),
        np.concatenate([good.j, made.j + 20]), np.concatenate([good.ij_T, made.ij_T]),
        np.concatenate([good.information, made.information]), np.zeros(40, dtype=bool),
    )  # fmt: skip
    parts = np.repeat([0, 1], 20)
    found = certify(both, replace(_placed(both, both.poses), component=parts))
    assert not found.certified
    twice = replace(both, poses=np.concatenate([right, right]))
    assert certify(twice, replace(_placed(twice, twice.poses), component=parts)).certified


@pytest.mark.skipif(FOLDER is None, reason="SLAM_DATA does not name the folder of measured data")
@pytest.mark.parametrize(
    "name",
    [
        "CSAIL",
        "intel",
        pytest.param("parking-garage", marks=pytest.mark.slow),
        pytest.param("sphere2500", marks=pytest.mark.slow),
    ],
)
def test_se_syncs_published_optimum_is_reached_and_certified(name: str):
    assert FOLDER is not None
    made = read_g2o(FOLDER / f"{name}.g2o")
    solution = solve_pose_graph(made, covariances=False)
    objective, bound = se_sync_optimum(made, solution)
    assert objective == pytest.approx(se_sync_optima(FOLDER)[name], rel=5e-4)
    assert objective - bound < 1e-6 * objective
    assert certify(made, solution).certified
