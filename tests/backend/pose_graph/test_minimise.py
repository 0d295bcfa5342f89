import math
import threading
import time

import gtsam
import numpy as np
import pytest

from backend.errors import BackendError
from backend.pose_graph.elimination import DEEP_GRAPH
from backend.pose_graph.minimise import minimise, translated
from backend.pose_graph.problem import from_pose_graph
from tests.backend.synthetic import graph

UNIT2 = gtsam.noiseModel.Unit.Create(3)
UNIT3 = gtsam.noiseModel.Unit.Create(6)
TIGHT = gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)


def _chain(n: int, noise=None, gauge_fixed: bool = True) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    noise = noise or gtsam.noiseModel.Diagonal.Sigmas(np.array([0.05, 0.05, 0.01]))
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    if gauge_fixed:
        factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), TIGHT))
    for k in range(n):
        values.insert(k, gtsam.Pose2(float(k), 0.0, 0.0))
        if k:
            factors.add(gtsam.BetweenFactorPose2(k - 1, k, gtsam.Pose2(1.0, 0.0, 0.0), noise))
    return factors, values


def _problem(seed: int, dimension: int, spread: float = 0.0):
    made = from_pose_graph(graph(seed, dimension, n=30))
    factors = made.edge_factors()
    prior = gtsam.PriorFactorPose2 if dimension == 2 else gtsam.PriorFactorPose3
    values = made.values(made.initial)
    first = values.atPose2(0) if dimension == 2 else values.atPose3(0)
    factors.add(prior(0, first, gtsam.noiseModel.Isotropic.Sigma(made.dof, 1e-3)))
    rng = np.random.default_rng(seed)
    start = gtsam.Values()
    for k in range(made.count):
        pose = values.atPose2(k) if dimension == 2 else values.atPose3(k)
        start.insert(k, pose.retract(spread * rng.normal(size=made.dof)))
    return factors, start


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("spread", [0.0, 0.1, 0.4])
def test_reaches_the_optimum_of_a_fully_converged_oracle(dimension: int, spread: float):
    factors, start = _problem(7, dimension, spread)
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-14)
    params.setAbsoluteErrorTol(1e-14)
    exact, _ = _problem(7, dimension)
    oracle = gtsam.LevenbergMarquardtOptimizer(exact, _problem(7, dimension)[1], params)
    oracle.optimize()
    found = minimise(factors, start)
    assert found.converged
    assert found.error == pytest.approx(oracle.error(), rel=1e-5)
    assert factors.error(found.values) == pytest.approx(found.error, rel=1e-12)
    assert found.initial_error == pytest.approx(factors.error(start), rel=1e-12)


def test_damping_takes_over_where_the_undamped_step_rises():
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    loose, tight = gtsam.noiseModel.Isotropic.Sigma(6, 1.0), gtsam.noiseModel.Isotropic.Sigma(6, 0.01)
    turn = gtsam.Pose3(gtsam.Rot3.RzRyRx(0, 0, 2.0), np.array([1.0, 0, 0]))
    n = 12
    factors.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(), tight))
    rng = np.random.default_rng(0)
    for k in range(n):
        values.insert(k, gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3) * 2), rng.normal(size=3) * 5))
        factors.add(gtsam.BetweenFactorPose3(k, (k + 1) % n, turn, tight if k % 2 else loose))
    steps: list[float] = []
    found = minimise(factors, values, on_step=lambda _, error: steps.append(error), max_iterations=300)
    assert math.isfinite(found.error)
    assert found.error < found.initial_error
    assert np.all(np.diff([found.initial_error, *steps]) <= 1e-6 * found.initial_error)


def test_a_long_chain_is_solved():
    factors, values = _chain(3000)
    values.update(2999, gtsam.Pose2(3000.0, 5.0, 0.2))
    found = minimise(factors, values)
    assert found.converged
    assert found.error == pytest.approx(0, abs=1e-6)


def test_what_on_step_raises_passes_through_and_the_interpreter_goes_on():
    factors, start = _problem(3, 3, 0.3)

    def interrupt(iteration: int, error: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        minimise(factors, start, on_step=interrupt)
    assert minimise(factors, start).converged


def test_the_time_limit_ends_the_descent_and_says_so():
    factors, start = _problem(3, 3, 0.4)
    found = minimise(factors, start, time_limit_s=0.0)
    assert not found.converged
    assert found.reason == "the time limit was reached"
    assert found.iterations == 1


def test_iterations_are_bounded():
    factors, start = _problem(3, 3, 0.4)
    found = minimise(factors, start, max_iterations=1)
    assert (found.iterations, found.converged) == (1, False)


def _with(factor, n: int = 3) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    factors, values = _chain(n, UNIT2)
    factors.add(factor)
    return factors, values


def _sigma(value: float) -> gtsam.noiseModel.Isotropic:
    return gtsam.noiseModel.Isotropic.Sigma(3, value)


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: (gtsam.NonlinearFactorGraph(), gtsam.Values()), "the graph is empty"),
        (lambda: _chain(3, gauge_fixed=False), "nothing ties keyframes 0-2 to the world"),
        (lambda: _with(gtsam.BetweenFactorPose2(1, 9, gtsam.Pose2(), UNIT2)), "keyframe 9 has measurements"),
        (
            lambda: _with(gtsam.BetweenFactorPose2(1, 2, gtsam.Pose2(math.nan, 0, 0), UNIT2)),
            "BetweenFactorPose2 on keyframe 1, keyframe 2",
        ),
        (
            lambda: _with(gtsam.BetweenFactorPose2(1, 2, gtsam.Pose2(math.inf, 0, 0), UNIT2)),
            "BetweenFactorPose2 on keyframe 1, keyframe 2",
        ),
        (
            lambda: _with(gtsam.BetweenFactorPose2(0, 2, gtsam.Pose2(), _sigma(math.nan))),
            "BetweenFactorPose2 on keyframe 0, keyframe 2",
        ),
    ],
)
def test_bad_graphs_are_refused_by_name(make, expected: str):
    with pytest.raises(BackendError) as refused:
        minimise(*make())
    assert expected in str(refused.value)
    assert "\n" not in str(refused.value)


def test_zero_sigma_is_refused_or_solved_never_left_unfinite():
    none = gtsam.noiseModel.Isotropic.Sigma(3, 0.0)
    factors, values = _with(gtsam.BetweenFactorPose2(0, 2, gtsam.Pose2(5, 5, 1), none))
    with pytest.raises(BackendError, match="keyframe 0, keyframe 2"):
        minimise(factors, values)


def test_an_unfinite_start_and_a_value_without_measurement_are_refused():
    factors, values = _chain(3)
    values.update(1, gtsam.Pose2(math.nan, 0, 0))
    with pytest.raises(BackendError, match="initial value of keyframe 1 is not finite"):
        minimise(factors, values)
    factors, values = _chain(3)
    values.insert(7, gtsam.Pose2())
    with pytest.raises(BackendError, match="keyframe 7 has a value but no measurement"):
        minimise(factors, values)


def test_a_floating_part_is_found_beside_an_anchored_one():
    factors, values = _chain(3)
    for k in (10, 11):
        values.insert(k, gtsam.Pose2())
    factors.add(gtsam.BetweenFactorPose2(10, 11, gtsam.Pose2(), UNIT2))
    with pytest.raises(BackendError, match="nothing ties keyframes 10-11 to the world"):
        minimise(factors, values)


def test_an_open_direction_is_named():
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(4):
        values.insert(k, gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1 * k, 0.2, 0), np.array([k, k * k, 1.0])))
    for k in range(3):
        step = values.atPose3(k).between(values.atPose3(k + 1))
        factors.add(gtsam.BetweenFactorPose3(k, k + 1, step, UNIT3))
    factors.add(gtsam.PoseRotationPrior3D(0, values.atPose3(0).rotation(), UNIT2))
    with pytest.raises(BackendError) as refused:
        minimise(factors, values)
    assert str(refused.value) == "under-determined: x, y, height of keyframes 0-3 not observed"


def test_two_poses():
    factors, values = _chain(2)
    assert minimise(factors, values).converged


@pytest.mark.parametrize("key", [103, gtsam.symbol("x", 103)])
def test_gtsam_s_own_account_is_translated(key: int):
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(key, gtsam.Pose3())
    factors.add(gtsam.GPSFactor(key, np.zeros(3), gtsam.noiseModel.Unit.Create(3)))
    with pytest.raises(RuntimeError) as raised:
        gtsam.GaussNewtonOptimizer(factors, values, gtsam.GaussNewtonParams()).iterate()
    assert translated(str(raised.value)) == "the measurements around keyframe 103 leave a direction open"


def test_a_deep_chain_in_a_small_stack():
    """COLAMD's tree of this chain needs more stack than a thread of 512 KB has; the interpreter would end."""
    factors, values = _chain(DEEP_GRAPH + 2000)
    found = []
    old = threading.stack_size(512 * 1024)
    try:
        worker = threading.Thread(target=lambda: found.append(minimise(factors, values)))
        worker.start()
        worker.join()
    finally:
        threading.stack_size(old)
    assert found[0].converged


@pytest.mark.slow
def test_a_chain_of_100_000_poses():
    factors, values = _chain(100_000)
    begin = time.process_time()
    assert minimise(factors, values).converged
    assert time.process_time() - begin < 120
