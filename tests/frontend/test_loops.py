"""Loop candidates from poses against brute force, and their verification."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from frontend.gates import GateConfig
from frontend.homography import HomographyConfig
from frontend.loops import overlapping, verify
from frontend.store import FeatureStore
from frontend.workers import Workers, share_with
from tests.frontend.floor_pairs import CAMERA, body
from tests.frontend.small_flight import features_of, small_flight, true_overlap


def all_shares(w_T_b: np.ndarray) -> np.ndarray:
    """(n, n) shares of overlap, pair by pair."""
    n = len(w_T_b)
    share = np.zeros((n, n))
    for j in range(n):
        for i in range(j):
            share[i, j] = share[j, i] = true_overlap(CAMERA, w_T_b[i], w_T_b[j])
    return share


def scattered(rng: np.random.Generator, n: int, far_m: float = 0.0) -> np.ndarray:
    """Poses at heights from 0.4 to 3 m: footprints of very different size, any yaw, some tilt."""
    return np.array(
        [
            body(
                *(far_m + rng.uniform(-2, 2, 2)),
                np.exp(rng.uniform(np.log(0.4), np.log(3))),
                rng.uniform(-np.pi, np.pi),
                *rng.normal(0, 0.1, 2),
            )
            for _ in range(n)
        ]
    )


@pytest.mark.parametrize("neighbours", [2, 5, 100])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_overlapping_agrees_with_brute_force(seed: int, neighbours: int) -> None:
    w_T_b = scattered(np.random.default_rng(seed), 30)
    share = all_shares(w_T_b)
    pairs = overlapping(CAMERA, w_T_b, 0.0, 0.3, neighbours)
    assert pairs == sorted(set(pairs))
    assert all(i < j for i, j in pairs)
    found = np.zeros((30, 30), bool)
    for i, j in pairs:
        found[i, j] = found[j, i] = True
    if neighbours == 100:
        sure = np.abs(share - 0.3) > 1e-4
        np.testing.assert_array_equal(found[sure], share[sure] > 0.3)
    # Each keyframe has its largest overlaps (footprints within others tie at 1) ...
    last = np.maximum(-np.sort(-share, axis=1)[:, min(neighbours, 30) - 1], 0.3)
    for k in range(30):
        assert found[k, share[k] > last[k] + 1e-4].all()
        assert found[k].sum() >= min(neighbours, (share[k] > 0.3 + 1e-4).sum())
    # ... and a pair is there because it is among the largest of one of the two, or joins what these do not.
    largest = [(i, j) for i, j in pairs if share[i, j] > min(last[i], last[j]) - 1e-4]
    assert len(pairs) - len(largest) == parts_of(largest) - parts_of(np.argwhere(share > 0.3))
    assert len(pairs) > 20


def parts_of(pairs) -> int:
    """Number of connected parts of 30 keyframes."""
    graph = nx.Graph(list(map(tuple, pairs)))
    graph.add_nodes_from(range(30))
    return nx.number_connected_components(graph)


def test_overlapping_joins_two_places_of_many_pictures_each() -> None:
    rng = np.random.default_rng(3)
    places = [[body(far_m, 0, 0.8, *rng.normal(0, 0.01, 3)) for _ in range(9)] for far_m in (0.0, 0.4)]
    w_T_b = np.array([*places[0], *places[1]])
    between = [(i, j) for i, j in overlapping(CAMERA, w_T_b, 0.0, 0.3, 4) if i < 9 <= j]
    share = all_shares(w_T_b)[:9, 9:]
    assert 0.3 < share.max() < 0.6
    assert [(i, j - 9) for i, j in between] == [np.unravel_index(share.argmax(), share.shape)]


def test_overlapping_of_nearly_the_same_view_and_far_from_the_origin() -> None:
    """Hovering: footprints that all but coincide; kilometres away from the origin."""
    rng = np.random.default_rng(5)
    for far_m in (0.0, 5e4):
        near = np.array([body(far_m, far_m, 0.8, *rng.normal(0, s, 3)) for s in (0, 1e-7, 1e-5, 1e-3, 1e-2)])
        near[1, :3, :3] = near[0, :3, :3]
        everything = {(i, j) for j in range(5) for i in range(j)}
        assert set(overlapping(CAMERA, near, 0.0, 0.5, 10)) == everything


def test_overlapping_leaves_out_what_has_no_place_and_uses_the_floor() -> None:
    w_T_b = np.array(
        [body(0, 0, 1), body(0.1, 0, 1), np.full((4, 4), np.nan), body(0, 0, 1, 0, -1.5), body(0, 0.1, 1)]
    )
    assert overlapping(CAMERA, w_T_b, 0.0, 0.5, 10) == [(0, 1), (0, 4), (1, 4)]
    # Parts of a map that nothing joins have each a world of their own, and overlap by chance.
    assert overlapping(CAMERA, w_T_b, 0.0, 0.5, 10, np.array([0, 1, 0, 0, 0])) == [(0, 4)]
    apart = np.array([body(0, 0, 1), body(0, 0.7, 1)])
    assert overlapping(CAMERA, apart, 0.0, 0.3, 10) == [(0, 1)]
    assert overlapping(CAMERA, apart, 0.5, 0.3, 10) == []
    assert overlapping(CAMERA, w_T_b[:1], 0.0, 0.3, 10) == []
    assert overlapping(CAMERA, np.empty((0, 4, 4)), 0.0, 0.3, 10) == []


def test_overlapping_pairs_grow_with_the_length_of_a_flight_not_with_its_square() -> None:
    rng = np.random.default_rng(6)
    n = 1500
    w_T_b = np.array([body(0.2 * k, rng.normal(0, 0.1), 0.8, rng.uniform(-3, 3)) for k in range(n)])
    pairs = overlapping(CAMERA, w_T_b, 0.0, 0.3, 8)
    assert n < len(pairs) < 8 * n


def test_verify_keeps_the_order_and_does_not_depend_on_workers() -> None:
    flight, store = small_flight(), FeatureStore()
    for features in features_of("sift", 3):
        store.append(features)
    rng = np.random.default_rng(7)
    n = len(store)
    pairs = [(k, k + 1) for k in range(0, n - 1, 3)] + [(0, n - 1), (1, n // 6), (2, n // 2)]
    pairs = [pairs[k] for k in rng.permutation(len(pairs))]
    outcomes = []
    for count in (1, 2, 4):
        done: list[int] = []
        with share_with(Workers(count)):
            results = list(verify(pairs, store, flight.camera, HomographyConfig(), GateConfig(), done.append))
        assert [(r.i, r.j) for r in results] == pairs
        assert done == list(range(1, len(pairs) + 1))
        outcomes.append(results)
    for results in outcomes[1:]:
        for one, other in zip(outcomes[0], results, strict=True):
            assert one.reason == other.reason
            np.testing.assert_array_equal(one.i_H_j, other.i_H_j)
            np.testing.assert_array_equal(one.matches, other.matches)
    share = [true_overlap(flight.camera, *flight.w_T_b[[3 * i, 3 * j]]) for i, j in pairs]
    for result, s in zip(outcomes[0], share, strict=True):
        assert result.ok or s < 0.5, (result.reason, s)
        assert not result.ok or s > 0.1
    assert {r.ok for r in outcomes[0]} == {True, False}
    assert list(verify([], store, flight.camera, HomographyConfig(), GateConfig())) == []
