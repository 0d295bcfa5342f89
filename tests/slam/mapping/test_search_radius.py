"""Which keyframes can have seen the same ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.mapping.search_radius import SearchRadius


def test_two_views_meet_where_their_circles_do_and_where_nothing_is_known():
    place = np.array([[0.0, 0, 1], [1.9, 0, 1], [2.1, 0, 1], [9, 9, 1], [np.nan] * 3, [0.1, 0, 1]])
    reach = SearchRadius(place, np.array([1.0, 1.0, 1.0, 50.0, 1.0, np.nan]), np.array([0, 0, 0, 1, 0, 0]))
    rows = np.arange(6)
    assert reach.holds(0, rows).tolist() == [True, True, False, True, True, True]
    assert [bool(reach.holds(j, np.array([0]))[0]) for j in rows] == reach.holds(0, rows).tolist()
    assert str(reach.reason(0, 2)) == "out of reach: 2.10 m apart by the poses so far, at most 2.00 m allowed"
    assert "2.10 heights apart" in str(replace(reach, metric=False).reason(0, 2))
    nowhere = SearchRadius(np.full((6, 3), np.nan), np.full(6, np.nan), np.zeros(6, dtype=np.int64))
    assert nowhere.holds(3, rows).all()
