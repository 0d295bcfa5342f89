"""NEES: the statistics of errors whose covariance is known, both ways."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from scipy.stats import chi2, kstest, wishart

from slam.evaluation import evaluate
from slam.evaluation.nees import consistency, nees, world_errors
from tests.slam.evaluation.scene import estimate_of, exponential, flight_of, smooth_poses, yaw_shift

STD = np.array([0.01, 0.02, 0.03, 0.05, 0.03, 0.1])


def with_known_errors(seed, count=120):
    """Truth, estimate and full covariances: each error is one draw of its own covariance."""
    rng = np.random.default_rng(seed)
    hat = smooth_poses(rng, count)
    P = np.outer(STD, STD) * wishart(df=12, scale=np.eye(6) / 12, seed=seed).rvs(count)
    xi = np.stack([rng.multivariate_normal(np.zeros(6), p) for p in P])
    return hat @ exponential(xi), hat, P


def test_the_error_is_gtsams_logarithm():
    truth, hat, P = with_known_errors(0)
    xi_w, P_w, _ = world_errors(hat, truth, P)
    for k in range(0, 120, 7):
        ours = np.concatenate([hat[k, :3, :3].T @ part for part in (xi_w[k, :3], xi_w[k, 3:])])
        theirs = gtsam.Pose3.Logmap(gtsam.Pose3(hat[k]).between(gtsam.Pose3(truth[k])))
        np.testing.assert_allclose(ours, theirs, atol=1e-12)
        assert xi_w[k] @ np.linalg.solve(P_w[k], xi_w[k]) == pytest.approx(
            theirs @ np.linalg.solve(P[k], theirs)
        )


@pytest.mark.parametrize("seed", range(3))
def test_single_values_are_chi_square_with_six_degrees(seed):
    truth, hat, P = with_known_errors(seed, 400)
    found = nees(hat, truth, P)
    assert kstest(found.per_keyframe, chi2(6).cdf).pvalue > 1e-3
    assert found.pose.dof == 6
    assert found.position.dof == found.rotation.dof == 3


def bands(seeds, factor=1.0):
    for seed in seeds:
        truth, hat, P = with_known_errors(seed)
        yield nees(hat, truth, factor * P)


@pytest.mark.slow
def test_the_band_holds_and_is_not_too_wide():
    found = list(bands(range(200)))
    for block, dof in (("pose", 6), ("position", 3), ("rotation", 3)):
        blocks = [getattr(each, block) for each in found]
        inside = np.mean([each.consistent for each in blocks])
        assert 0.90 <= inside <= 0.995, block
        assert np.mean([each.mean for each in blocks]) == pytest.approx(dof, rel=0.02)
        assert np.mean([each.upper95 - each.lower95 for each in blocks]) < 0.6 * dof


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_covariances_off_by_two_are_found(factor):
    found = list(bands(range(20), factor))
    assert not any(each.pose.consistent for each in found)
    assert np.mean([each.position.consistent for each in found]) < 0.1
    outside = [each.pose.mean > each.pose.upper95 for each in found]
    assert all(outside) if factor < 1 else not any(outside)


@pytest.mark.parametrize("mistake", ["translation first", "left perturbation", "inverse"])
def test_another_convention_is_found(mistake):
    truth, hat, P = with_known_errors(1)
    if mistake == "translation first":
        order = [3, 4, 5, 0, 1, 2]
        P = P[:, order][:, :, order]
    elif mistake == "left perturbation":
        P = np.stack(
            [
                gtsam.Pose3(T).AdjointMap() @ p @ gtsam.Pose3(T).AdjointMap().T
                for T, p in zip(hat, P, strict=True)
            ]
        )
    else:
        P = np.linalg.inv(P)
    assert not nees(hat, truth, P).pose.consistent


def markov(rng, count, length):
    rho = np.exp(-1 / length)
    z = rng.normal(size=(count, 6))
    for k in range(1, count):
        z[k] = rho * z[k - 1] + np.sqrt(1 - rho**2) * z[k]
    return z


def pinned_walk(rng, count, _):
    """Odometry with a loop at its end: a random walk that both ends hold."""
    walk, share = np.cumsum(rng.normal(size=(count + 1, 6)), axis=0), np.arange(1, count + 1) / (count + 1)
    return (walk[:-1] - share[:, None] * walk[-1]) / np.sqrt((count + 1) * share * (1 - share))[:, None]


@pytest.mark.parametrize(
    ("process", "length", "least"),
    [(markov, 3, 0.9), (markov, 10, 0.9), (markov, 50, 0.9), (pinned_walk, 0, 0.85)],
)
def test_the_band_allows_for_correlated_errors(process, length, least):
    rng = np.random.default_rng(7)
    found = [consistency(process(rng, 150, length)) for _ in range(200)]
    textbook = [chi2.ppf([0.025, 0.975], 900) / 150] * 200
    assert least <= np.mean([each.consistent for each in found]) <= 0.995
    naive = np.mean([low <= each.mean <= high for each, (low, high) in zip(found, textbook, strict=True)])
    assert naive < 0.85
    assert np.mean([each.mean for each in found]) == pytest.approx(6, rel=0.1)


def with_a_common_scale(seed, scale_std, std=0.02, count=60):
    """Own errors that fade within four keyframes, and one scale for all: estimate, truth, covariances."""
    rng = np.random.default_rng(seed)
    hat = smooth_poses(rng, count)
    way_m = hat[:, :3, 3] - hat[0, :3, 3]
    common = np.pad(scale_std * way_m, ((0, 0), (3, 0)))
    xi_w = std * markov(rng, count, 4) + rng.normal() * common
    P_w = std**2 * np.eye(6) + common[:, :, None] * common[:, None, :]
    b_R_w = np.zeros((count, 6, 6))
    b_R_w[:, :3, :3] = b_R_w[:, 3:, 3:] = hat[:, :3, :3].transpose(0, 2, 1)
    truth = hat @ exponential((b_R_w @ xi_w[:, :, None])[:, :, 0])
    truth[0] = hat[0]
    shared = np.zeros((count, 6, 3))
    shared[:, :, 0] = (b_R_w @ common[:, :, None])[:, :, 0]
    return hat, truth, b_R_w @ P_w @ b_R_w.transpose(0, 2, 1), shared


@pytest.mark.parametrize("told", ["joint", "scale", pytest.param("", marks=pytest.mark.slow)])
def test_the_band_allows_for_a_scale_that_all_poses_share(told):
    """Where the way turns, neighbours do not show that they err alike in it."""
    found = []
    for seed in range(80):
        hat, truth, P, shared = with_a_common_scale(seed, 0.02)
        estimate = estimate_of(
            hat,
            covariances=P,
            joint_errors=shared if told == "joint" else None,
            scale_std=0.02 if told == "scale" else None,
        )
        found.append(evaluate(estimate, flight_of(truth)).nees)
    inside = np.mean([each.position.consistent for each in found])
    assert 0.92 <= inside <= 0.99 if told else inside < 0.9
    assert np.mean([each.rotation.consistent for each in found]) >= 0.9


def test_the_scale_is_about_the_first_keyframe_that_is_compared():
    """In a file of an earlier version, whose first keyframe may have no pose."""
    hat, truth, P, _ = with_a_common_scale(0, 0.02)
    whole = evaluate(estimate_of(hat, covariances=P, scale_std=0.02), flight_of(truth)).nees.position
    later = np.concatenate([np.full((1, 4, 4), np.nan), hat[:-1]]), np.concatenate([P[:1], P[:-1]])
    component = np.r_[-1, np.zeros(len(hat) - 1, dtype=int)]
    estimate = estimate_of(later[0], covariances=later[1], scale_std=0.02, component=component)
    found = evaluate(estimate, flight_of(np.concatenate([truth[:1], truth[:-1]]))).nees.position
    assert found.n_eff == pytest.approx(whole.n_eff, rel=0.1)


def test_a_scale_that_errs_twice_as_much_as_stated_is_found():
    beyond = []
    for seed in range(30):
        hat, truth, P, shared = with_a_common_scale(seed, 0.02)
        estimate = estimate_of(hat, covariances=P / 4, joint_errors=shared / 2)
        beyond.append(not evaluate(estimate, flight_of(truth)).nees.position.consistent)
    assert np.mean(beyond) > 0.9


def few_bends(rng, count, shared):
    """Errors of which a few smooth ones are most, as on a map whose loops leave only bends of the whole path,
    and those few (shared, count, 6)."""
    at = np.linspace(0, np.pi, count)
    share = 0.7 ** np.arange(1, shared + 1)
    bends = np.array([np.cos(m * at + phase)[:, None] for m, phase in enumerate(rng.uniform(0, 3, shared))])
    U = np.sqrt(0.9 * share / share.sum())[:, None, None] * bends * rng.normal(size=(shared, 1, 6))
    left = np.sqrt(1 - np.clip(np.sum(U**2, axis=0), 0, 1))
    U /= np.maximum(np.sqrt(np.sum(U**2, axis=0)), 1.0)
    return np.einsum("m,mna->na", rng.normal(size=shared), U) + left * rng.normal(size=(count, 6)), U


def test_the_band_is_exact_where_a_few_errors_are_shared():
    rng = np.random.default_rng(5)
    drawn = [few_bends(rng, 100, 8) for _ in range(400)]
    told = [consistency(*each) for each in drawn]
    assert 0.93 <= np.mean([each.consistent for each in told]) <= 0.97
    below, above = (np.mean([side(each) for each in told]) for side in (
        lambda each: each.mean < each.lower95, lambda each: each.mean > each.upper95
    ))  # fmt: skip
    assert max(below, above) < 0.045
    untold = [consistency(errors) for errors, _ in drawn]
    assert np.mean([each.consistent for each in untold]) < 0.9


def test_independent_errors_keep_nearly_all_their_weight():
    rng = np.random.default_rng(3)
    counts = [consistency(rng.normal(size=(150, 6))).n_eff for _ in range(50)]
    assert 135 < np.mean(counts) <= 150
    assert max(counts) <= 150


def test_covariances_that_cannot_be_used_are_left_out():
    truth, hat, P = with_known_errors(4)
    broken = P.copy()
    broken[3] = np.nan
    broken[4] = 0.0
    broken[5, 0, 0] = -1.0
    broken[6] = np.outer(STD, STD)
    found = nees(hat, truth, broken)
    assert found.left_out == 4
    assert np.isnan(found.per_keyframe[3:7]).all()
    np.testing.assert_allclose(found.per_keyframe[7:], nees(hat, truth, P).per_keyframe[7:])
    assert nees(hat, truth, np.full_like(P, np.nan)) is None


def dead_reckoning(seed, count=60):
    """Odometry composed from a known first pose, and its covariance by first-order propagation."""
    rng = np.random.default_rng(seed)
    truth = smooth_poses(rng, count)
    Q = np.diag(np.square([1e-3, 1e-3, 2e-3, 4e-3, 3e-3, 2e-3]))
    hat, P = truth.copy(), np.zeros((count, 6, 6))
    for k in range(1, count):
        step = np.linalg.inv(truth[k - 1]) @ truth[k]
        measured = step @ exponential(rng.multivariate_normal(np.zeros(6), Q))
        hat[k] = hat[k - 1] @ measured
        A = gtsam.Pose3(measured).inverse().AdjointMap()
        P[k] = A @ P[k - 1] @ A.T + Q
    return truth, hat, P


def test_propagated_covariances_are_consistent_through_evaluate_in_any_gauge():
    found = []
    for seed in range(30):
        truth, hat, P = dead_reckoning(seed)
        G = yaw_shift(0.1 * seed, np.array([seed, -2.0, 0.5]))
        found.append(evaluate(estimate_of(G @ hat, covariances=P), flight_of(truth)).nees)
    assert np.mean([each.pose.mean for each in found]) == pytest.approx(6, rel=0.15)
    assert 0.8 <= np.mean([each.pose.consistent for each in found]) <= 1.0
    assert all(len(each.per_keyframe) == 59 and each.left_out == 0 for each in found)


def test_propagated_covariances_that_are_too_small_are_found_through_evaluate():
    above = []
    for seed in range(12):
        truth, hat, P = dead_reckoning(seed)
        pose = evaluate(estimate_of(hat, covariances=0.2 * P), flight_of(truth)).nees.pose
        above.append(pose.mean > pose.upper95)
    assert np.mean(above) > 0.9


def test_a_map_without_metres_is_judged_in_its_own_unit():
    """A unit of 1.25 m, as a mean height, changes no NEES."""
    rng = np.random.default_rng(3)
    truth = smooth_poses(rng, 60)
    covariances = np.tile(np.diag(STD**2), (60, 1, 1))
    hat = truth @ exponential(rng.normal(size=(60, 6)) * STD)
    hat[0] = truth[0]
    metric = estimate_of(hat, covariances=covariances)
    unit = np.repeat([1.0, 0.8], 3)
    in_units, by_unit = hat.copy(), unit[:, None] * covariances * unit
    in_units[:, :3, 3] *= 0.8
    relative = evaluate(estimate_of(in_units, covariances=by_unit, metric=False), flight_of(truth))
    # One number, the scale, is fitted to 59 poses.
    expected = evaluate(metric, flight_of(truth)).nees.pose.mean
    assert relative.nees.pose.mean == pytest.approx(expected, rel=0.02)
    assert relative.nees.pose.consistent
