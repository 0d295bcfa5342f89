"""How many others each keyframe of a long flight is compared with, by what their common points tell."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from frontend.loops import overlapping
from slam.mapping.config import LoopConfig
from tests.frontend.floor_pairs import CAMERA, body


def constraints(pairs: list[tuple[int, int]], w_T_b: np.ndarray) -> int:
    """Independent constraints that pairs give of points of the floor: sightings that match, less points.

    A feature is found again with 0.6, and matches then with 0.8: a little more rarely than in photographs.
    """
    rng, n, points = np.random.default_rng(0), len(w_T_b), 600
    center, half = w_T_b[:, :2, 3], np.ptp(CAMERA.footprint(w_T_b[0], 0.0), axis=0) / 2
    place = rng.uniform(center.min(axis=0), center.max(axis=0), (points, 2))
    off = np.abs(place[:, None] - center)
    found = (off < half).all(axis=2) & (rng.uniform(size=(points, n)) < 0.6)
    i, j = np.array(pairs).T
    point, pair = np.nonzero(found[:, i] & found[:, j])
    matched = rng.uniform(size=len(point)) < 0.8
    point, pair = point[matched], pair[matched]
    ends = point * n + i[pair], point * n + j[pair]
    joined = coo_array((np.ones(len(point), np.int8), ends), shape=(points * n,) * 2)
    return points * n - connected_components(joined)[0]


@pytest.mark.parametrize("laps", [1, 10])
def test_neighbours_of_a_long_flight_keep_the_constraints_of_all_pairs_that_overlap(laps: int) -> None:
    """Pictures that overlap by 80 % along and across, or ten laps along a line with a lateral scatter."""
    rng = np.random.default_rng(1)
    along, across = 0.2 * np.ptp(CAMERA.footprint(body(0, 0, 0.8), 0.0), axis=0)
    if laps == 1:
        places = [(along * a, across * b) for a in range(12) for b in range(12)]
    else:
        places = [
            (along * (a + rng.uniform()), across * rng.normal()) for a in range(16) for _ in range(laps)
        ]
    w_T_b = np.array([body(x, y, 0.8) for x, y in places])
    neighbours = LoopConfig().overlapping(10_000)
    everything, limited, fewer = (overlapping(CAMERA, w_T_b, 0.0, 0.3, k) for k in (200, neighbours, 8))
    whole = constraints(everything, w_T_b)
    assert len(limited) < 0.8 * len(everything)
    assert constraints(limited, w_T_b) > 0.995 * whole
    assert constraints(fewer, w_T_b) < 0.98 * whole
