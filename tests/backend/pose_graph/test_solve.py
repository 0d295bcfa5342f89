from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from backend import se3
from backend.errors import BackendError
from backend.measurements import Attitude, Measurements, Position, RelativePose, SlantRange
from backend.pose_graph.from_measurements import from_measurements
from backend.pose_graph.solve import solve, solve_pose_graph
from tests.backend.synthetic import falsified, flight, graph


def _rmse(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(((a[:, :3, 3] - b[:, :3, 3]) ** 2).sum(axis=1).mean()))


def _onto_first(w_T: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Position and heading of the first pose put on the truth's: what a flight without GPS leaves open."""
    turn = truth[0] @ se3.inverse(w_T[0])
    heading = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    move = se3.from_planar(np.array([[0, 0, heading]]))[0]
    move[:2, 3] = truth[0, :2, 3] - (move @ w_T[0])[:2, 3]
    return move @ w_T


def test_attitude_and_range_put_the_flight_level_at_its_height():
    made = flight(1)
    s = solve(made.measurements)
    assert s.status == "ok"
    assert s.converged
    assert s.edge_kept.all()
    assert s.unobserved == ("heading, x and y of keyframes 0-59: nothing measures them, held at keyframe 0",)
    off = s.w_T_b[:, 2, 3] - made.truth[:, 2, 3]
    assert 0.0005 < np.sqrt((off**2).mean()) < 0.01
    assert _rmse(_onto_first(s.w_T_b, made.truth), made.truth) < 0.08


def test_deviations_that_rounding_dominates_are_told():
    made = graph(4, 3)
    s = solve_pose_graph(replace(made, information=made.information * 2e-14))
    assert s.covariances is not None
    assert np.isnan(s.covariances).any()
    assert any("have no standard deviations" in warning for warning in s.warnings)


@pytest.mark.parametrize("kind", ["nothing", "attitude", "heading", "positions"])
def test_what_is_held_is_what_nothing_measures(kind: str):
    made = {
        "nothing": flight(2, attitude_std=None, range_std=None),
        "attitude": flight(2, range_std=None),
        "heading": flight(2, attitude_std=(0.01, 0.01, 0.02)),
        "positions": flight(2, position_std=0.1),
    }[kind]
    s = solve(made.measurements)
    expected = {
        "nothing": (
            "position and attitude of keyframes 0-59: nothing measures them,"
            " keyframe 0 is held where it starts",
        ),
        "attitude": (
            "heading, x, y and height of keyframes 0-59: nothing measures them, held at keyframe 0",
        ),
        "heading": ("x and y of keyframes 0-59: nothing measures them, held at keyframe 0",),
        "positions": (),
    }[kind]
    assert s.unobserved == expected
    assert s.converged


def test_holding_costs_nothing():
    """A gauge that is held adds no error: a rigid motion of the start leaves the error."""
    made = flight(3)
    move = se3.from_planar(np.array([[5.0, -3.0, 2.0]]))[0]
    gaussian = solve(made.measurements, initial=made.truth)
    moved = solve(made.measurements, initial=move @ made.truth)
    assert moved.error == pytest.approx(gaussian.error, rel=1e-5)
    np.testing.assert_allclose(moved.w_T_b, move @ gaussian.w_T_b, atol=2e-3)


def test_without_a_start_the_same_optimum_as_from_the_truth():
    made = flight(4, position_std=0.2)
    assert solve(made.measurements).error == pytest.approx(
        solve(made.measurements, initial=made.truth).error, rel=1e-4
    )


def test_a_partial_start_is_completed_along_the_edges():
    made = flight(4, attitude_std=None, range_std=None)
    initial = np.full_like(made.truth, np.nan)
    initial[7] = made.truth[7]
    s = solve(made.measurements, initial=initial)
    assert _rmse(s.w_T_b, made.truth) < 0.3


def test_covariances_are_calibrated():
    """Normalised errors of all keyframes over seeds: the mean within its two-sided 99.9 % band."""
    nees = []
    for seed in range(25):
        made = flight(seed, n=20, loops=4, attitude_std=(0.01, 0.01, 0.02), position_std=0.05)
        s = solve(made.measurements)
        assert s.covariances is not None
        k = seed % 20
        e = se3.log(se3.inverse(s.w_T_b[k : k + 1]) @ made.truth[k : k + 1])[0]
        nees.append(e @ np.linalg.solve(s.covariances[k], e))
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(nees)) / len(nees)
    assert low < np.mean(nees) < high


def test_the_error_is_distributed_as_chi_square():
    """Twice the error over seeds against its degrees of freedom, two-sided."""
    total, dof = 0.0, 0
    for seed in range(15):
        made = flight(seed, n=25, loops=6, attitude_std=None, range_std=None)
        total += 2 * solve(made.measurements, covariances=False).error
        dof += 6 * (24 + 6) - 6 * 24
    low, high = chi2.ppf([0.0005, 0.9995], dof)
    assert low < total < high


@pytest.mark.parametrize("share", [pytest.param(0.1, marks=pytest.mark.slow), 0.5])
def test_false_loops_are_rejected_with_their_reason(share: float):
    clean = flight(5, n=80, loops=20)
    made, false = falsified(clean, int(20 * share), seed=1)
    s = solve(made.measurements)
    np.testing.assert_array_equal(s.edge_kept, ~false)
    for reason, wrong in zip(s.edge_reason, false, strict=True):
        assert ("sigma (limit 4.7)" in str(reason)) == bool(wrong)
    best = solve(clean.measurements)
    one, other = (_rmse(_onto_first(x.w_T_b, clean.truth), clean.truth) for x in (s, best))
    assert one < 1.5 * other


def test_rejection_can_be_forbidden_and_is_then_told():
    made, _ = falsified(flight(5), 4, seed=1)
    s = solve(made.measurements, loops_robust=False)
    assert s.edge_kept.all()
    (said,) = s.contradictions
    assert "disagree more than their covariances allow" in said
    assert said in s.reasons
    assert said not in s.warnings, "each line once"


def test_no_edge_is_rejected_where_the_whole_fits():
    """Single edges beyond the limit are chance as long as the global test passes."""
    for seed in range(8):
        assert solve(flight(seed, n=30, loops=15).measurements, covariances=False).edge_kept.all()


def test_positions_with_outliers_do_not_pull():
    made = flight(6, position_std=0.1)
    bad = [
        replace(p, w_p_antenna_m=p.w_p_antenna_m + 20.0) if p.k % 12 == 0 else p
        for p in made.measurements.positions
    ]
    s = solve(replace(made.measurements, positions=tuple(bad)))
    assert _rmse(s.w_T_b, made.truth) < 0.1
    said = next(w for w in s.warnings if "5 of 60 positions lie farther off than noise explains" in w)
    # Three coordinates of 0.1 m, each off by 20 m; noise of one of 60 exceeds the limit once in 1000.
    assert "is off by 347 times its stated deviation, and noise explains up to 5 times" in said
    assert "check them, leave them out, or state larger deviations" in said


def test_positions_are_those_of_the_antenna():
    """A metre ahead of the body it moves with the heading: an arm that is forgotten bends the track."""
    made, arm_m = flight(6, position_std=0.1), np.array([1.0, -0.5, 0.3])
    of_antenna = tuple(
        replace(p, w_p_antenna_m=p.w_p_antenna_m + made.truth[p.k, :3, :3] @ arm_m)
        for p in made.measurements.positions
    )
    of_body = solve(made.measurements)
    found = solve(replace(made.measurements, positions=of_antenna, antenna_m=arm_m))
    forgotten = solve(replace(made.measurements, positions=of_antenna))
    assert _rmse(found.w_T_b, made.truth) < 1.2 * _rmse(of_body.w_T_b, made.truth)
    assert _rmse(forgotten.w_T_b, made.truth) > 5 * _rmse(of_body.w_T_b, made.truth)


def test_a_range_spike_does_not_pull():
    made = flight(6)
    ranges = list(made.measurements.ranges)
    ranges[10] = replace(ranges[10], range_m=3.0)
    s = solve(replace(made.measurements, ranges=tuple(ranges)))
    assert abs(s.w_T_b[10, 2, 3] - made.truth[10, 2, 3]) < 0.02
    assert any(
        "1 of 60 heights over the floor lie farther off than noise explains" in w and "10" in w
        for w in s.warnings
    )
    assert not any("ranges" in w for w in s.warnings)  # the heights may come from other instruments


def test_a_horizontal_position_leaves_the_height_to_the_range():
    made = flight(8, position_std=0.1)
    flat = [
        replace(p, w_p_antenna_m=np.append(p.w_p_antenna_m[:2], np.nan)) for p in made.measurements.positions
    ]
    s = solve(replace(made.measurements, positions=tuple(flat)))
    assert s.unobserved == ()
    assert np.abs(s.w_T_b[:, 2, 3] - made.truth[:, 2, 3]).max() < 0.03


def _cut(measurements: Measurements, at: int) -> Measurements:
    edges = tuple(e for e in measurements.relative_poses if (e.i < at) == (e.j < at))
    return replace(measurements, relative_poses=edges)


def test_disconnected_parts_are_each_anchored_and_told():
    made = flight(9, loops=0)
    s = solve(_cut(made.measurements, 20))
    np.testing.assert_array_equal(s.component, [1] * 20 + [0] * 40)
    assert len(s.unobserved) == 2
    assert s.status == "2 parts are not connected to each other"
    assert np.isfinite(s.w_T_b).all()
    assert np.abs(s.w_T_b[:, 2, 3] - made.truth[:, 2, 3]).max() < 0.05


def test_a_keyframe_that_nothing_reaches_is_not_placed():
    made = flight(9, loops=0, attitude_std=None, range_std=None)
    edges = tuple(e for e in made.measurements.relative_poses if 59 not in (e.i, e.j))
    s = solve(replace(made.measurements, relative_poses=edges))
    assert s.component[59] == -1
    assert np.isnan(s.w_T_b[59]).all()
    assert s.covariances is not None
    assert np.isnan(s.covariances[59]).all()
    assert "keyframe 59 not placed: no edge and no position" in s.unobserved


def test_names_are_used():
    made = flight(9, n=4, loops=0)
    named = replace(made.measurements, names=("a.png", "b.png", "c.png", "d.png"))
    edges = tuple(e for e in named.relative_poses if 3 not in (e.i, e.j))
    s = solve(replace(named, relative_poses=edges))
    assert any("d.png" in messages for messages in s.unobserved)


def test_interrupt_leaves_cleanly():
    made = flight(1)

    def interrupt(iteration: int, error: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve(made.measurements, on_step=interrupt)
    assert solve(made.measurements).converged


EYE = np.eye(4)
GOOD = np.eye(6) * 1e-4


def _edge(T=EYE, covariance=GOOD, i: int = 0, j: int = 1) -> RelativePose:
    return RelativePose(i, j, T, covariance, "odometry")


@pytest.mark.parametrize(
    ("measurements", "expected"),
    [
        (Measurements(np.zeros(0)), "no keyframe"),
        (Measurements(np.arange(2.0), (_edge(EYE * np.nan),)), "odometry edge 0-1 is not a finite rigid"),
        (Measurements(np.arange(2.0), (_edge(np.diag([1, 1, -1, 1.0])),)), "not a finite rigid"),
        (Measurements(np.arange(2.0), (_edge(EYE * 2),)), "not a finite rigid"),
        (Measurements(np.arange(2.0), (_edge(covariance=GOOD * np.nan),)), "not symmetric positive definite"),
        (Measurements(np.arange(2.0), (_edge(covariance=GOOD * 0),)), "not symmetric positive definite"),
        (Measurements(np.arange(2.0), (_edge(covariance=-GOOD),)), "not symmetric positive definite"),
        (
            Measurements(np.arange(2.0), (_edge(covariance=GOOD + np.triu(np.ones((6, 6)) * 1e-5, 1)),)),
            "not symmetric positive definite",
        ),
        (Measurements(np.arange(2.0), (_edge(j=7),)), "joins keyframes 0 and 7 of 2"),
        (Measurements(np.arange(2.0), (_edge(j=0),)), "joins keyframes 0 and 0"),
        (Measurements(np.arange(2.0), ranges=(SlantRange(5, 1.0, 0.1),)), "names keyframe 5 of 2"),
        (Measurements(np.arange(2.0), ranges=(SlantRange(0, 1.0, 0.0),)), "the range of keyframe 0"),
        (
            Measurements(np.arange(2.0), attitudes=(Attitude(0, np.zeros(3), np.zeros(3)),)),
            "the attitude of keyframe 0",
        ),
        (
            Measurements(np.arange(2.0), positions=(Position(1, np.zeros(3), np.full(3, np.nan)),)),
            "the position of",
        ),
        (Measurements(np.arange(2.0), names=("one",)), "1 names for 2 keyframes"),
    ],
)
def test_bad_figures_are_refused_by_name(measurements: Measurements, expected: str):
    with pytest.raises(BackendError, match=expected) as refused:
        solve(measurements)
    assert "\n" not in str(refused.value)


def test_unusable_single_figures_are_left_out_and_counted():
    made = flight(1, n=6, loops=0)
    ranges = tuple(
        replace(r, range_m=v) for r, v in zip(made.measurements.ranges, [np.nan, -1, 0, 1, 1, 1], strict=True)
    )
    s = solve(replace(made.measurements, ranges=ranges))
    assert any("3 attitudes, ranges or positions without a usable figure" in w for w in s.warnings)


def test_one_and_two_keyframes():
    one = solve(Measurements(np.zeros(1)))
    assert one.component.tolist() == [0]
    np.testing.assert_array_equal(one.w_T_b[0], EYE)
    two = solve(Measurements(np.arange(2.0), (_edge(),)))
    assert two.converged
    np.testing.assert_allclose(two.w_T_b[1], EYE, atol=1e-9)


def test_the_time_limit_is_told():
    s = solve(flight(1).measurements, time_limit_s=0.0)
    assert s.status != "ok" or s.converged


def test_the_slant_range_factor_is_its_definition():
    """Residual zero where height over the cosine of the tilt is the range, one sigma off by one sigma."""
    tilt = se3.exp(np.array([[0.2, -0.1, 0.7, 0, 0, 0]]))[0]
    tilt[2, 3] = 1.3
    slant = 1.3 / tilt[2, 2]
    for off, expected in ((0.0, 0.0), (0.01, 1.0)):
        problem, _ = from_measurements(
            Measurements(np.zeros(1), ranges=(SlantRange(0, slant + off, 0.01 / tilt[2, 2]),)), tilt[None]
        )
        error = problem.unary_factors[0].gaussian.error(problem.values(tilt[None]))
        assert np.sqrt(2 * error) == pytest.approx(expected * tilt[2, 2] ** 2, rel=1e-6, abs=1e-9)
