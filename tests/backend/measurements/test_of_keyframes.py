"""Measurements of some keyframes alone: renumbered in the given order, and nothing that names another one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backend.measurements import FloorTracks
from tests.backend.synthetic import flight


def test_what_names_other_keyframes_is_left_out_and_the_rest_is_renumbered():
    whole = flight(1, n=12, loops=0, position_std=0.1).measurements
    tracks = FloorTracks(
        np.array([3, 4, 9, 2]), np.array([5, 5, 7, 7]), np.arange(8.0).reshape(4, 2), np.ones(4)
    )
    whole = replace(whole, tracks=tracks, names=tuple("abcdefghijkl"))
    part = whole.of_keyframes([4, 3, 9])
    assert part.names == ("e", "d", "j")
    np.testing.assert_array_equal(part.stamps_s, whole.stamps_s[[4, 3, 9]])
    (edge,) = part.relative_poses
    assert (edge.i, edge.j) == (1, 0), "3 to 4; the others lead out"
    for kind in ("attitudes", "ranges", "positions"):
        assert sorted(each.k for each in getattr(part, kind)) == [0, 1, 2]
    assert {r.k: r.range_m for r in part.ranges} == {
        new: whole.ranges[old].range_m for new, old in enumerate((4, 3, 9))
    }
    np.testing.assert_array_equal(part.tracks.keyframe, [1, 0, 2])
    np.testing.assert_array_equal(part.tracks.track, [0, 0, 1])
