"""Which pairs are loops: against clipping in double precision, and with places known to some metres only."""

from __future__ import annotations

import numpy as np
import pytest

from slam.evaluation.loops.reference import FALSE, TRUE, UNDECIDED, Reference, overlap_bounds
from tests.frontend.small_flight import shared_area, signed_area


def quads(rng: np.random.Generator, n: int) -> np.ndarray:
    corners = np.array([[-0.5, -0.4], [0.5, -0.4], [0.5, 0.4], [-0.5, 0.4]])
    turn = rng.uniform(-3, 3, n)
    R = np.stack([np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)], 1).reshape(n, 2, 2)
    size = rng.uniform(0.7, 1.5, (n, 1, 1))
    return size * corners @ R.transpose(0, 2, 1) + rng.uniform(-2, 2, (n, 1, 2))


def share(one: np.ndarray, other: np.ndarray) -> float:
    return shared_area(one, other) / min(abs(signed_area(one)), abs(signed_area(other)))


@pytest.mark.parametrize("slack_m", [0.0, 0.3])
def test_bounds_are_the_shares_of_footprints_moved_together_and_apart(slack_m):
    footprint, stamps_s = quads(np.random.default_rng(1), 25), 4.0 * np.arange(25)
    bounds = overlap_bounds(footprint, stamps_s, slack_m)
    centre = footprint.mean(axis=1)
    for a in range(25):
        for b in range(a + 1, 25):
            way = centre[b] - centre[a]
            distance = np.linalg.norm(way)
            apart = share(footprint[a], footprint[b] + slack_m * way / distance)
            near = share(footprint[a], footprint[b] - min(slack_m, distance) * way / distance)
            if b - a < 3:
                assert (a, b) not in bounds
            else:
                assert bounds.get((a, b), (0.0, 0.0)) == pytest.approx((apart, near), abs=1e-5)


def test_labels_need_both_bounds_and_both_keyframes():
    place = np.zeros((6, 2))
    place[5] = np.nan
    overlap = {
        (0, 1): (0.3, 0.5),
        (0, 2): (0.29, 0.9),
        (0, 3): (0.0, 0.09),
        (1, 2): (0.0, 0.1),
        (1, 5): (1.0, 1.0),
    }
    reference = Reference("gps", np.arange(6.0), place, overlap)
    pairs = [*overlap, (3, 4)]
    assert reference.labels(pairs).tolist() == [TRUE, UNDECIDED, FALSE, UNDECIDED, UNDECIDED, FALSE]
    assert reference.labels([]).tolist() == []
    assert reference.eligible(np.array([0, 1, 5])).tolist() == []
