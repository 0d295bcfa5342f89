"""Parts of a map that no picture joins, joined by what the instruments say."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from backend import se3
from backend.measurements import RelativePose
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.mapping.inertial.bridge import Bridge
from slam.mapping.inertial.bridges import joined
from slam.mapping.pipeline import optimize
from tests.benchmarks.calibration import bridge
from tests.slam.mapping.made_map import made_map
from tests.slam.small_flight import flown, only, seeing

GREY = np.full((144, 176, 3), 120, np.uint8)
BLIND_S = 4.0, 6.0


@lru_cache
def one_way(seed: int) -> Flight:
    """Four metres straight on, no place seen twice, two seconds of it over a floor without features."""
    flight = flown(
        seed,
        maneuver={"way_points": [[0.3, 0.3], [4.3, 0.3]], "cruise_m_s": 0.5},
        landmarks={"A": [0.3, 0.3], "B": [4.3, 0.3]},
        world={"extent_m": [0, 0, 4.6, 1.0]},
    )
    frames = flight.frames
    assert frames is not None
    assert flight.velocity is not None
    stamps_s, load = frames.stamps_s, frames.load
    blind = seeing(flight, lambda k: GREY if BLIND_S[0] <= stamps_s[k] < BLIND_S[1] else load(k))
    return replace(blind, velocity=replace(flight.velocity, scale_std=0.0))


@lru_cache
def bridged(seed: int, with_velocity: bool) -> tuple[Flight, Estimate]:
    flight = one_way(seed) if with_velocity else replace(one_way(seed), velocity=None)
    return flight, optimize(flight)


@pytest.mark.parametrize("with_velocity", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_stretch_without_features_leaves_one_map(with_velocity):
    flight, estimate = bridged(0, with_velocity)
    assert (estimate.component == 0).all()
    assert np.isfinite(estimate.covariances).all()
    (edge,) = (e for e in estimate.relative_poses if e.kind == "inertial")
    assert edge.j == edge.i + 1
    assert estimate.stamps_s[edge.j] - estimate.stamps_s[edge.i] > BLIND_S[1] - BLIND_S[0]
    told = f"no overlapping pictures connect keyframes {edge.i} and {edge.j}: the instruments bridge the gap"
    assert told in estimate.status
    found = evaluate(estimate, flight)
    std_m = np.sqrt(np.trace(edge.covariance[3:, 3:]))
    assert found.ate_m.max < 4 * std_m + 0.01
    assert std_m < (0.07 if with_velocity else 0.2)


@pytest.mark.slow
def test_covariances_hold_on_both_sides_of_the_bridge():
    """How high the one part is against the other is none of them's own gauge."""
    scores = [
        evaluate(estimate, flight).nees for flight, estimate in (bridged(seed, True) for seed in range(4))
    ]
    assert 3 < np.mean([score.pose.mean for score in scores]) < 9
    assert max(np.nanmax(score.per_keyframe) for score in scores) < chi2.ppf(0.99999, 6)


@pytest.mark.slow
@pytest.mark.parametrize("velocity_error_m_s", [pytest.param(0.0, marks=pytest.mark.slow), 0.03])
def test_a_speed_that_reads_too_much_is_distinguished_from_a_faultless_one(velocity_error_m_s):
    """By the steps that pictures tell: a bridge is off as far as told with either."""
    scores = [bridge(seed, True, velocity_error_m_s) for seed in range(10)]
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(scores))
    assert low < sum(scores) < high


def test_behind_the_bridge_the_map_is_less_certain():
    _, estimate = bridged(0, False)
    (edge,) = (e for e in estimate.relative_poses if e.kind == "inertial")
    std_m = np.sqrt(np.trace(estimate.covariances[:, 3:, 3:], axis1=1, axis2=2))
    near, far = std_m[: edge.j].mean(), std_m[edge.j :].mean()
    assert far > 5 * near


@pytest.mark.parametrize(
    "missing", [{"velocity": None, "imu": None}, pytest.param({"sonar": None}, marks=pytest.mark.slow)]
)
def test_without_instruments_or_metres_nothing_is_bridged(missing):
    flight = one_way(0)
    beside = np.abs(flight.frames.stamps_s - np.mean(BLIND_S)) < 2.2
    estimate = optimize(replace(only(flight, np.flatnonzero(beside)), **missing))
    assert set(estimate.component.tolist()) == {0, 1}
    assert not [e for e in estimate.relative_poses if e.kind == "inertial"]


@pytest.mark.slow
def test_a_chain_that_holds_is_left_alone(monkeypatch):
    """With nothing broken the filter is not even run."""

    def never(*_):
        raise AssertionError("the filter was run")

    monkeypatch.setattr("slam.inertial.noise_identification.identify_noise", never)
    estimate = optimize(flown(0))
    assert (estimate.component == 0).all()


def made_parts(rng):
    """Two parts over one floor, the second in a world of its own."""
    n = 8
    w_T_b = np.tile(np.eye(4), (n, 1, 1))
    w_T_b[:, :3, 3] = np.column_stack([np.arange(n) * 0.5, rng.normal(0, 0.1, n), np.full(n, 1.0)])
    tilted = np.column_stack([rng.uniform(-3, 3, n), rng.normal(0, 0.1, (n, 2))])
    w_T_b[:, :3, :3] = Rotation.from_euler("ZYX", tilted).as_matrix()
    component = np.array([0, 0, 0, 0, 0, 1, 1, 1])
    moved = se3.from_planar(np.array([[3.0, -2.0, 1.0]]))[0]
    apart = np.where((component == 1)[:, None, None], moved @ w_T_b, w_T_b)
    std = np.array([0.002, 0.002, 0.01, 0.05, 0.03, 0.01])
    edge = RelativePose(4, 5, np.linalg.inv(w_T_b[4]) @ w_T_b[5], np.diag(std**2), "inertial")
    return w_T_b, made_map(apart, component), edge


@pytest.mark.parametrize("backwards", [False, True])
def test_parts_are_laid_together_exactly(backwards):
    w_T_b, parts, edge = made_parts(np.random.default_rng(0))
    if backwards:
        edge = replace(edge, i=5, j=4, i_T_j=np.linalg.inv(edge.i_T_j))
    found = joined(parts, [edge])
    np.testing.assert_allclose(found.w_T_b, w_T_b, atol=1e-12)
    assert found.component.tolist() == [0] * 8
    assert found.bridges == (Bridge(edge),)


@pytest.mark.slow
def test_covariance_behind_a_bridge_is_that_of_many_draws():
    rng = np.random.default_rng(1)
    _, parts, edge = made_parts(rng)
    found = joined(parts, [edge])
    draws = []
    for xi in rng.multivariate_normal(np.zeros(6), edge.covariance, 3000):
        noisy = replace(edge, i_T_j=edge.i_T_j @ se3.exp(xi[None])[0])
        draws.append(joined(parts, [noisy]).w_T_b[7])
    errors = se3.log(np.linalg.inv(found.w_T_b[7])[None] @ np.array(draws))
    np.testing.assert_allclose(np.cov(errors.T), found.covariances[7], rtol=0.15, atol=3e-5)
    np.testing.assert_array_equal(found.over_floor_covariances, found.covariances)


def test_behind_a_part_without_covariances_nothing_is_certain():
    """The refinement may leave a part without them: that is no part known exactly."""
    _, parts, edge = made_parts(np.random.default_rng(3))
    unknown = parts.covariances.copy()
    unknown[:5] = np.nan
    found = joined(replace(parts, covariances=unknown), [edge])
    assert np.isfinite(found.w_T_b).all()
    assert np.isnan(found.covariances).any(axis=(1, 2)).all()


def test_the_world_is_the_first_keyframes_however_small_its_part():
    """What is certain is where the flight began; laid onto the larger part, all of it seemed to be."""
    w_T_b, parts, edge = made_parts(np.random.default_rng(4))
    swapped = replace(parts, component=1 - parts.component)
    found = joined(swapped, [edge])
    np.testing.assert_allclose(found.w_T_b, w_T_b, atol=1e-12)
    assert found.component.tolist() == [0] * 8
    assert not found.covariances[:5].any()
    np.testing.assert_array_equal(found.covariances, joined(parts, [edge]).covariances)


def test_an_edge_within_a_part_or_to_an_unplaced_keyframe_changes_nothing():
    _, parts, edge = made_parts(np.random.default_rng(2))
    assert joined(parts, [replace(edge, i=0, j=1), replace(edge, i=6, j=7)]) is parts
    lost = replace(parts, component=np.where(parts.component == 1, -1, 0))
    assert joined(lost, [edge]) is lost


def test_a_middle_part_carries_the_last_one_along():
    w_T_b, parts, _ = made_parts(np.random.default_rng(3))
    component = np.array([0, 0, 0, 0, 1, 1, 2, 2])
    apart = w_T_b.copy()
    for part, shift in ((1, [1.0, 2.0, 0.3]), (2, [-4.0, 0.5, -2.0])):
        apart[component == part] = se3.from_planar(np.array([shift]))[0] @ apart[component == part]
    edges = [
        RelativePose(i, i + 1, np.linalg.inv(w_T_b[i]) @ w_T_b[i + 1], 1e-4 * np.eye(6), "inertial")
        for i in (3, 5)
    ]
    found = joined(replace(parts, w_T_b=apart, component=component), edges)
    np.testing.assert_allclose(found.w_T_b, w_T_b, atol=1e-12)
    grown = np.trace(found.covariances[:, 3:, 3:], axis1=1, axis2=2)
    assert grown[3] == 0 < grown[4] < grown[6]


def test_parts_are_joined_along_the_surest_edges():
    """Of three parts with an edge between any two, the two surest edges carry the map."""
    w_T_b = np.tile(np.eye(4), (6, 1, 1))
    w_T_b[:, 0, 3], w_T_b[:, 2, 3] = np.arange(6.0), 1.0
    parts = made_map(w_T_b, np.array([0, 0, 1, 1, 2, 2]))
    sure, unsure = np.eye(6) * 0.01**2, np.eye(6) * 0.5**2
    edges = [
        RelativePose(i, j, np.linalg.inv(w_T_b[i]) @ w_T_b[j], covariance, "inertial")
        for i, j, covariance in ((1, 2, sure), (3, 4, sure), (0, 5, unsure))
    ]
    for order in (edges, edges[::-1]):
        found = joined(parts, order)
        assert {(bridge.edge.i, bridge.edge.j) for bridge in found.bridges} == {(1, 2), (3, 4)}
        std_m = np.sqrt(np.diagonal(found.covariances[5])[3:5])
        # Each bridge errs by 0.01 m and, through its tilt, by 0.01 rad times the height of 1 m. The heading
        # of the first bridge acts over 3 m, that of the second over 1 m.
        assert std_m == pytest.approx([0.01 * np.sqrt(4), 0.01 * np.sqrt(4 + 3**2 + 1**2)], rel=1e-6)


def test_of_two_edges_between_the_same_parts_the_surer_one_joins_them():
    w_T_b, parts, edge = made_parts(np.random.default_rng(5))
    unsure = RelativePose(3, 6, np.linalg.inv(w_T_b[3]) @ w_T_b[6], 100 * edge.covariance, "inertial")
    alone = joined(parts, [edge])
    for order in ([edge, unsure], [unsure, edge]):
        found = joined(parts, order)
        assert found.bridges == (Bridge(edge),)
        np.testing.assert_array_equal(found.covariances, alone.covariances)
