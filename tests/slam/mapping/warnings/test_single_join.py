"""Parts of a map that one pair of pictures alone joins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.measurements import RelativePose
from frontend.registration import Registration
from slam.evaluation import evaluate
from slam.mapping.inertial.bridge import Bridge
from slam.mapping.lift_edges import Edges
from slam.mapping.map import Map
from slam.mapping.pipeline import optimize
from slam.mapping.warnings.single_join import single_joins
from tests.slam.mapping.inertial.test_bridges import one_way
from tests.slam.mapping.made_map import made_map

APART = np.array([0, 0, 0, 0, 1, 1, 1, 1])
CHAINS = [(0, 1), (1, 2), (2, 3), (4, 5), (5, 6), (6, 7)]


def with_pairs(pairs: list[tuple[int, int]], matches: dict[tuple[int, int], int] | None = None) -> Map:
    """A map of eight keyframes in one part that accepted ``pairs`` join, with 100 ``matches`` or as told."""
    whole = made_map(np.tile(np.eye(4), (8, 1, 1)), np.zeros(8, int))
    told = {pair: np.zeros((count, 2), int) for pair, count in (matches or {}).items()}
    usual = np.zeros((100, 2), int)
    registrations = tuple(
        Registration(i, j, None, told.get((i, j), usual), np.eye(3), np.eye(8), 1.0, 0.5) for i, j in pairs
    )
    return replace(
        whole,
        edges=Edges(registrations, (), whole.edges.heights),
        graph=replace(whole.graph, edge_kept=np.ones(len(pairs), bool)),
    )


def test_one_pair_between_two_stretches_is_found():
    assert single_joins(with_pairs([*CHAINS, (1, 6)]), APART) == [(1, 6, 4, 1)]


@pytest.mark.parametrize("more", [[(2, 7)], [(3, 4)]])
def test_a_second_pair_or_a_link_confirms_it(more):
    assert single_joins(with_pairs([*CHAINS, (1, 6), *more]), APART) == []


def test_poor_pairs_do_not_confirm_each_other_nor_a_good_one():
    pairs = [*CHAINS, (1, 6), (2, 7), (0, 5)]
    poor = dict.fromkeys([(1, 6), (2, 7), (0, 5)], 20)
    assert single_joins(with_pairs(pairs, {**poor, (2, 7): 21}), APART) == [(2, 7, 4, 3)]
    assert single_joins(with_pairs(pairs, {**poor, (2, 7): 100}), APART) == [(2, 7, 4, 3)]
    assert single_joins(with_pairs(pairs, {**poor, (2, 7): 100, (0, 5): 100}), APART) == []
    assert single_joins(with_pairs(pairs, poor), np.zeros(8, int)) == []


def test_what_instruments_confirm_is_not_doubted():
    pairs = with_pairs([*CHAINS, (1, 6)])
    assert single_joins(pairs, np.zeros(8, int)) == []
    bridge = Bridge(RelativePose(3, 4, np.eye(4), np.eye(6), "inertial"))
    assert single_joins(replace(pairs, bridges=(bridge,)), APART) == []


def test_links_and_single_keyframes_are_left_alone():
    assert single_joins(with_pairs([*CHAINS, (3, 4)]), APART) == []
    assert single_joins(with_pairs([*CHAINS[:5], (3, 4), (2, 7)]), np.array([0] * 7 + [-1])) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_parts_whose_poses_overlap_by_chance_stay_apart(seed):
    """Each part begins at the origin of its own world. Pairs by such poses joined them 3.2 m off."""
    flight = replace(one_way(seed), velocity=None, imu=None)
    estimate = optimize(flight)
    found = evaluate(estimate, flight)
    assert set(estimate.component.tolist()) == {0, 1}
    assert found.ate_m is not None
    assert found.ate_m.max < 0.01
