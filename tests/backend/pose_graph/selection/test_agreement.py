from dataclasses import replace

import gtsam
import numpy as np
import pytest

from backend import se3
from backend.pose_graph.from_measurements import from_measurements
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.selection import agreement, rejection
from backend.pose_graph.selection.prediction import LoopInnovations, sample_posterior
from backend.pose_graph.solve import solve, solve_pose_graph
from tests.backend.synthetic import LOOP_STD, Made, falsified, flight, graph
from tests.benchmarks.false_loops import KINDS, SEEDS, cases_of
from tests.benchmarks.false_loops import falsified as falsified_graph
from tests.benchmarks.graphs import graph_folder

FOLDER = graph_folder()


@pytest.mark.parametrize("dimension", [2, 3])
def test_posterior_samples_have_the_covariance_of_the_solution(dimension: int):
    """Against gtsam's marginals: each whitened draw has unit variance, within chance for their number."""
    problem = from_pose_graph(graph(1, dimension, n=30))
    factors, values = problem.edge_factors(), problem.values(problem.initial)
    prior = gtsam.PriorFactorPose2 if dimension == 2 else gtsam.PriorFactorPose3
    first = values.atPose2(0) if dimension == 2 else values.atPose3(0)
    factors.add(prior(0, first, gtsam.noiseModel.Isotropic.Sigma(problem.dof, 1e-2)))
    samples = sample_posterior(factors, values, problem.dof)
    assert samples is not None
    marginals = gtsam.Marginals(factors, values)
    for k in (3, 17, 29):
        whitened = np.linalg.solve(np.linalg.cholesky(marginals.marginalCovariance(k)), samples[k])
        count = whitened.size
        assert abs((whitened**2).mean() - 1) < 4.5 * np.sqrt(2 / count)


def _repeating(made: Made, rows: int, seed: int) -> tuple[Made, np.ndarray]:
    """Turn rows of five loops false in the same way: consistent with each other and with the odometry."""
    rng = np.random.default_rng(seed)
    edges = list(made.measurements.relative_poses)
    false = np.zeros(len(edges), dtype=bool)
    loops = [k for k, e in enumerate(edges) if e.kind == "loop"]
    for row in range(rows):
        a = int(rng.integers(0, 12))
        b = int(rng.integers(40, 50))
        T = se3.exp((rng.normal(size=6) * [0.05, 0.05, 0.3, 0.3, 0.3, 0.05])[None])[0]
        for k, edge in enumerate(loops[5 * row : 5 * row + 5]):
            ahead = se3.inverse(made.truth[a]) @ made.truth[a + k]
            behind = se3.inverse(made.truth[b]) @ made.truth[b + k]
            noise = se3.exp((rng.normal(size=6) * LOOP_STD)[None])[0]
            i_T_j = se3.inverse(ahead) @ T @ behind @ noise
            edges[edge] = replace(edges[edge], i=a + k, j=b + k, i_T_j=i_T_j)
            false[edge] = True
    return Made(replace(made.measurements, relative_poses=tuple(edges)), made.truth), false


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_mutually_consistent_false_loops_are_rejected(seed: int):
    made, false = _repeating(flight(seed, n=80, loops=30), 2, seed)
    s = solve(made.measurements, covariances=False)
    np.testing.assert_array_equal(s.edge_kept, ~false)


@pytest.mark.parametrize("share", [pytest.param(0.7, marks=pytest.mark.slow), 0.9])
def test_the_few_true_loops_among_many_false_are_found(share: float):
    made, false = falsified(flight(3, n=80, loops=40), round(40 * share), seed=2)
    s = solve(made.measurements, covariances=False)
    assert not (s.edge_kept & false).any()
    assert (~s.edge_kept & ~false).sum() <= 1


def test_overestimated_covariances_admit_no_false_loop():
    made, false = falsified(flight(4, n=80, loops=30), 15, seed=1)
    wide = tuple(replace(e, covariance=100 * e.covariance) for e in made.measurements.relative_poses)
    s = solve(replace(made.measurements, relative_poses=wide, attitudes=(), ranges=()), covariances=False)
    np.testing.assert_array_equal(s.edge_kept, ~false)


@pytest.mark.parametrize("unit", ["m", "heights"])
def test_every_rejected_loop_tells_why_and_no_other(unit):
    made, _ = falsified(flight(5, n=80, loops=20), 10, seed=1)
    s = solve(replace(made.measurements, length_unit=unit), covariances=False)
    for kept, reason in zip(s.edge_kept, s.edge_reason, strict=True):
        assert (reason is None) == bool(kept)
        assert kept or ("sigma" in str(reason) and f" {unit}, " in str(reason))


def test_the_choice_depends_on_nothing_but_the_graph():
    made, _ = falsified(flight(6, n=80, loops=20), 12, seed=1)
    one, other = (solve(made.measurements, covariances=False) for _ in range(2))
    np.testing.assert_array_equal(one.w_T_b, other.w_T_b)
    problem, _ = from_measurements(made.measurements, None)
    assert problem.trusted.sum() == 79


def test_time_limit_ends_the_search():
    made, _ = falsified(flight(6, n=80, loops=20), 12, seed=1)
    s = solve(made.measurements, covariances=False, time_limit_s=0.0)
    assert np.isfinite(s.w_T_b).all()


def test_a_growth_without_anything_left_to_judge_is_complete():
    """Joints between chains may have taken all loops. That ended with an internal error."""
    problem, _ = from_measurements(flight(6, n=20, loops=3).measurements, None)
    every, w_T = np.ones(len(problem.i), dtype=bool), problem.initial
    grown = agreement.grow_consistent_set(
        problem, every, w_T, lambda kept, w_T: w_T, lambda kept, w_T: np.zeros((20, 6, 4)), lambda *_: None
    )
    assert grown.is_complete
    assert grown.kept.all()


@pytest.mark.parametrize("count", [40, 2000])
def test_each_round_takes_half_of_the_sharp_loops_however_many(count: int):
    """Rounds of a fixed number of loops would grow in number with the map, and each of them in time."""
    rng = np.random.default_rng(0)
    spread = 0.1 * rng.normal(size=(count, 3, 20))
    pending = LoopInnovations(np.arange(count), rng.normal(size=(count, 3)), spread, np.full(count, 20.0))
    agreeing = np.count_nonzero(pending.agrees())
    chosen = agreement._select_loops(pending, pending.log_pass_probability(), np.arange(count), odds=-3.0)
    assert len(np.unique(chosen)) == len(chosen) == pytest.approx(agreeing / 2, rel=0.05)
    assert pending.agrees()[chosen].all()


def test_a_growth_that_is_cut_off_is_in_the_status(monkeypatch):
    made, _ = falsified(flight(6, n=80, loops=20), 12, seed=1)
    assert solve(made.measurements, covariances=False).status == "ok"
    monkeypatch.setattr(agreement, "_ROUNDS", 1)
    assert "search for consistent loops was cut off" in solve(made.measurements, covariances=False).status


def test_a_few_false_loops_among_many_are_found_from_the_fit_of_all_edges(monkeypatch):
    made, false = falsified(flight(6, n=200, loops=120), 2, seed=1)
    monkeypatch.setattr(rejection, "_MANY_LOOPS", 100)
    monkeypatch.delattr(rejection, "grow_from_odometry")
    s = solve(made.measurements, covariances=False)
    assert not (s.edge_kept & false).any()
    assert (~s.edge_kept & ~false).sum() <= 2


@pytest.mark.slow
def test_many_false_loops_on_a_graph_do_not_fill_the_elimination_up():
    """2000 poses with 1500 random loops: all of them solved at once would take minutes."""
    made = _long_walk(2000)
    whole = solve_pose_graph(made, covariances=False).w_T_b
    false, wrong = falsified_graph(made, whole, 0.7, 1, seed=0)
    s = solve_pose_graph(false, covariances=False)
    assert (s.edge_kept & wrong).sum() <= 2
    assert (~s.edge_kept & ~wrong).sum() <= 2


def _long_walk(n: int):
    """A spatial walk along a serpentine whose rows see each other."""
    rng = np.random.default_rng(0)
    row, column = np.divmod(np.arange(n), 50)
    column = np.where(row % 2 == 0, column, 49 - column)
    truth = se3.from_planar(np.column_stack([column, row, np.where(row % 2 == 0, 0.0, np.pi)]))
    across = np.flatnonzero(row < row.max())
    i = np.concatenate([np.arange(n - 1), across])
    j = np.concatenate([np.arange(1, n), (2 * (row + 1) * 50 - 1 - np.arange(n))[across]])
    far = np.abs(i - j) != 1
    near = np.arange(len(i)) < n - 1
    i, j = i[far | near], j[far | near]
    std = np.array([0.01, 0.01, 0.01, 0.03, 0.03, 0.03])
    ij_T = se3.inverse(truth[i]) @ truth[j] @ se3.exp(rng.normal(size=(len(i), 6)) * std)
    information = np.tile(np.diag(std**-2), (len(i), 1, 1))
    made = graph(0, 3, n=6)
    return replace(
        made, ids=np.arange(n), poses=np.full_like(truth, np.nan), i=i, j=j, ij_T=ij_T,
        information=information, fixed=np.zeros(n, dtype=bool),
    )  # fmt: skip


@pytest.mark.skipif(FOLDER is None, reason="SLAM_DATA does not name the folder of measured data")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["intel", "CSAIL"])
def test_half_of_the_loops_false_on_a_measured_graph(name: str):
    assert FOLDER is not None
    cases = cases_of(FOLDER / f"{name}.g2o", (0.5,))
    assert len(cases) == len(KINDS) * len(SEEDS)
    for case in cases:
        assert case.ratio < 1.2, case
        assert case.kept == 0
