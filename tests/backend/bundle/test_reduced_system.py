"""The solver of the refinement against gtsam, and OpenCV's lens, on the whole factor graph."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import L as POINT
from gtsam.symbol_shorthand import X as POSE

from backend.bundle.factors import WORLD
from backend.bundle.minimise import BundleCost, minimise_bundle
from backend.bundle.problem import Variables
from backend.bundle.structure import Structure
from tests.backend.bundle.factor_graph import all_values, factor_graph
from tests.backend.bundle.posed_costs import posed

UNKNOWN = "gps, camera unknown"

CASES = {
    "sonar": {"name": "sonar"},
    "wild observations": {"name": "sonar", "wild": 0.1},
    "points seen once or never": {"name": "sonar", "drop": 0.5},
    "no attitude": {"name": "sonar, no attitude"},
    "tilted mount": {"name": "tilted mount"},
    "gps over a slope": {"name": "gps over a slope"},
    "free lens": {"name": UNKNOWN, "free_lens": True},
    "variables of other instruments": {"name": "gps over a slope", "free_lens": True, "more": True},
    "free lens, wild observations": {"name": UNKNOWN, "free_lens": True, "wild": 0.1},
}
LONGER = ("variables of other instruments", "free lens, wild observations", "wild observations")
"""Cases whose optimum takes gtsam several seconds."""
cases = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


def behind(at: Variables, k: int) -> Variables:
    """The same with a keyframe below the floor, so that its points are behind the camera."""
    values = gtsam.Values(at.values)
    pose = values.atPose3(POSE(k))
    values.update(POSE(k), gtsam.Pose3(pose.rotation(), pose.translation() * [1, 1, -1]))
    return Variables(values, at.point)


@cases
@pytest.mark.parametrize("below", [False, True])
def test_the_error_is_that_of_gtsam(case: dict, below: bool) -> None:
    cost, at = posed(**case)
    at = behind(at, 5) if below else at
    assert cost.error(at) == pytest.approx(factor_graph(cost).error(all_values(cost, at)), rel=1e-12)


@pytest.mark.parametrize("free_lens", [False, True])
def test_points_behind_a_camera_cost(free_lens: bool) -> None:
    cost, at = posed(UNKNOWN, free_lens=free_lens)
    assert cost.error(behind(at, 5)) > 5 * cost.error(at)


@cases
def test_the_linear_system_is_that_of_gtsam(case: dict) -> None:
    """Gradient and J'J of all variables agree, those of a keyframe below the floor included."""
    cost, at = posed(**case)
    at = behind(at, 5)
    linear = cost.linearise(at, cost.structure(at))
    J, b = linear.jacobian()
    J = J.toarray()[:, in_order_of_keys(linear.structure, at)]
    theirs, right = gtsam_jacobian(cost, at)
    scale = np.linalg.norm(theirs, axis=0)
    scale[scale == 0] = 1.0
    unit, ours = theirs / scale, J / scale
    np.testing.assert_allclose(ours.T @ ours, unit.T @ unit, atol=1e-9)
    np.testing.assert_allclose(ours.T @ b, unit.T @ right, atol=1e-9 * np.linalg.norm(right))
    assert linear.error == pytest.approx(0.5 * float(right @ right), rel=1e-12)


@cases
def test_products_with_the_jacobian_need_it_not_as_a_whole(case: dict, monkeypatch) -> None:
    monkeypatch.setattr("backend.bundle.reduced_system._OBSERVATIONS_AT_ONCE", 7)
    cost, at = posed(**case)
    linear = cost.linearise(at, cost.structure(at))
    J, b = linear.jacobian()
    x, y = (np.random.default_rng(0).normal(size=(count, 3)) for count in J.shape[::-1])
    by_pose, by_point = np.split(x, [linear.structure.elimination.size])
    scale = np.sqrt((J**2).sum(axis=0)).max()
    np.testing.assert_allclose(linear.times(by_pose, by_point), J @ x, atol=1e-12 * scale)
    np.testing.assert_allclose(np.vstack(linear.transposed_times(y)), J.T @ y, atol=1e-12 * scale)
    np.testing.assert_allclose(np.concatenate(linear.gradient), J.T @ b, atol=1e-11 * scale)


def test_an_elimination_keeps_less_than_the_blocks_of_the_poses_beside_its_factor() -> None:
    """What points and poses have in common would be half as large again as these blocks."""
    cost, at = posed(UNKNOWN)
    linear = cost.linearise(at, cost.structure(at))
    arrays = [each for each in vars(linear.eliminate()).values() if isinstance(each, np.ndarray)]
    own = [each.nbytes for each in arrays if not np.shares_memory(each, linear.seen.of_pose)]
    assert len(arrays) > len(own) > 0
    assert sum(own) < linear.seen.of_pose.nbytes


def gtsam_jacobian(cost: BundleCost, at: Variables) -> tuple[np.ndarray, np.ndarray]:
    """The Jacobian of gtsam, columns of the pose side by key and of the points, and its right-hand side."""
    ordering = gtsam.Ordering()
    for key in [*sorted(at.values.keys()), *(POINT(t) for t in range(len(at.point)))]:
        ordering.push_back(key)
    J, right = factor_graph(cost).linearize(all_values(cost, at)).jacobian(ordering)
    return J[:, : at.values.dim() + at.point.size], right


def in_order_of_keys(structure: Structure, at: Variables) -> np.ndarray:
    """The columns of `LinearSystem.jacobian` in that order."""
    of_keys = np.concatenate([np.r_[structure.columns(key)] for key in sorted(at.values.keys())])
    return np.concatenate([of_keys, len(of_keys) + np.arange(at.point.size)])


@cases
def test_the_step_solves_the_normal_equations(case: dict) -> None:
    """The solution with eliminated points is that of all equations together, damped or not."""
    cost, at = posed(**case)
    linear = cost.linearise(at, cost.structure(at))
    J, b = linear.jacobian()
    for damping in (0.0, 10.0):
        step = linear.eliminate(damping).solve(*linear.gradient)
        x = np.concatenate(step)
        rest = J.T @ (b - J @ x) - damping * x
        assert np.abs(rest / np.sqrt((J**2).sum(axis=0))).max() < 1e-6 * np.linalg.norm(b)
        predicted = 0.5 * float(np.sum((b - J @ x) ** 2))
        assert linear.error_after(step, damping) == pytest.approx(predicted, rel=1e-6)


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=pytest.mark.slow if name in LONGER else (), id=name)
        for name, case in CASES.items()
    ],
)
def test_the_optimum_and_its_covariances_are_those_of_gtsam(case: dict) -> None:
    cost, at = posed(**case)
    found = minimise_bundle(cost, at, 100, 1e-13)
    graph, poses = factor_graph(cost), [POSE(k) for k in range(cost.problem.measurements.count)]
    params = gtsam.GaussNewtonParams()
    params.setLinearSolverType("MULTIFRONTAL_QR")
    params.setRelativeErrorTol(1e-14)
    params.setAbsoluteErrorTol(1e-14)
    theirs = gtsam.GaussNewtonOptimizer(graph, all_values(cost, at), params).optimize()
    assert found.error == pytest.approx(graph.error(theirs), rel=1e-9)
    for key in poses:
        np.testing.assert_allclose(
            found.at.values.atPose3(key).matrix(), theirs.atPose3(key).matrix(), atol=1e-6
        )
    np.testing.assert_allclose(found.at.values.atVector(WORLD), theirs.atVector(WORLD), atol=1e-6, rtol=1e-6)
    if cost.problem.self_calibrates:
        lens = (values.atVector(CALIBRATION(0)) for values in (found.at.values, theirs))
        np.testing.assert_allclose(*lens, rtol=1e-6, atol=1e-6)
    ours = cost.linearise(found.at, found.structure).eliminate().joint_covariances(poses, WORLD)
    J, _ = gtsam_jacobian(cost, found.at)
    root = np.linalg.inv(np.linalg.qr(J, mode="r"))
    dense, columns = root @ root.T, columns_by_key(found.at.values)
    for key, joint in zip(poses, ours, strict=True):
        both = np.concatenate([columns[key], columns[WORLD]])
        std = np.sqrt(np.diag(dense)[both])
        theirs = dense[np.ix_(both, both)] / np.outer(std, std)
        np.testing.assert_allclose(joint / np.outer(std, std), theirs, atol=1e-6)


def columns_by_key(values: gtsam.Values) -> dict[int, np.ndarray]:
    """Return the columns of each variable, sorted by key."""
    dims = values.dims()
    keys = sorted(dims)
    begin = np.cumsum([0, *(dims[key] for key in keys)])
    return {key: np.arange(a, a + dims[key]) for key, a in zip(keys, begin[:-1], strict=True)}
