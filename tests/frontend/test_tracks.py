"""Tracks: union-find against networkx, conflicts, pixels, spread."""

from __future__ import annotations

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest

from frontend.points import Points
from frontend.registration import Registration
from frontend.tracks import TrackConfig, join_tracks
from tests.frontend.floor_pairs import CAMERA, Array

ALL = TrackConfig(grids=((320, 240),))
"""A cell a pixel: every track is chosen."""


def link(i: int, j: int, matches: Array, noise_px: float = 0.3) -> Registration:
    return Registration(
        i, j, None, np.asarray(matches, np.int64).reshape(-1, 2), np.eye(3), np.eye(8), noise_px, 0.8
    )


def random_flight(
    rng: np.random.Generator, n: int, features: int, shown: int, wrong: float
) -> tuple[list[Points], list[Registration]]:
    """Each keyframe sees each point or not; pairs match what both see, and sometimes what they don't."""
    corners = rng.permutation(320 * 240)[: n * features].reshape(n, features)  # no two in one pixel
    points = [Points.alike(np.column_stack([c % 320, c // 320]).astype(float)) for c in corners]
    seen = [rng.permutation(features)[:shown] for _ in range(n)]  # feature that shows point p
    links = []
    for j in range(1, n):
        for i in range(max(0, j - 3), j):
            shared = np.flatnonzero(rng.random(shown) < 0.4)
            matches = np.column_stack([seen[i][shared], seen[j][shared]])
            swap = rng.random(len(matches)) < wrong
            matches[swap, 1] = rng.integers(0, features, swap.sum())
            links.append(link(i, j, matches, rng.uniform(0.2, 0.6)))
    return points, links


def oracle(links: list[Registration]) -> set[frozenset[tuple[int, int]]]:
    """Components of (keyframe, feature) without those that hold two features of one keyframe."""
    graph = nx.Graph()
    for r in links:
        graph.add_edges_from(((r.i, int(a)), (r.j, int(b))) for a, b in r.matches)
    parts = [frozenset(c) for c in nx.connected_components(graph)]
    return {p for p in parts if len({k for k, _ in p}) == len(p)}


@pytest.mark.parametrize("wrong", [0.0, 0.02, 0.2])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_tracks_are_the_connected_components_without_conflicts(seed: int, wrong: float) -> None:
    points, links = random_flight(np.random.default_rng(seed), 12, 60, 30, wrong)
    tracks = join_tracks(points, links, CAMERA, ALL)
    place = {(k, *p): (k, f) for k, rows in enumerate(points) for f, p in enumerate(rows.pixel.tolist())}
    found: dict[int, set[tuple[int, int]]] = {}
    for k, t, p in zip(tracks.keyframe, tracks.track, tracks.pixel.tolist(), strict=True):
        found.setdefault(int(t), set()).add(place[int(k), p[0], p[1]])
    expected = oracle(links)
    assert {frozenset(members) for members in found.values()} == expected
    assert len(expected) > 3
    assert sorted(found) == list(range(len(found)))
    assert sum(len(m) for m in found.values()) == len(tracks.track)


def test_one_wrong_match_takes_out_its_two_tracks_and_no_other() -> None:
    points = [Points.alike(np.array([[10.0, 10], [100, 10], [200, 10]])) for _ in range(3)]
    straight = [[0, 0], [1, 1], [2, 2]]
    clean = join_tracks(points, [link(0, 1, straight), link(1, 2, straight)], CAMERA, ALL)
    assert len(clean.track) == 9
    crossed = join_tracks(points, [link(0, 1, straight), link(1, 2, [[0, 0], [1, 1], [2, 1]])], CAMERA, ALL)
    assert crossed.pixel[:, 0].tolist() == [10, 10, 10]


def test_each_observation_has_the_median_noise_of_its_keyframes_registrations() -> None:
    points = [Points.alike(np.array([[10.0, 10]])) for _ in range(4)]
    links = [link(0, 1, [[0, 0]], 0.2), link(1, 2, [[0, 0]], 0.4), link(1, 3, [[0, 0]], 0.9)]
    tracks = join_tracks(points, links, CAMERA, ALL)
    assert dict(zip(tracks.keyframe.tolist(), tracks.std_px.tolist(), strict=True)) == {
        0: 0.2,
        1: 0.4,
        2: 0.4,
        3: 0.9,
    }


def test_a_point_that_is_known_less_well_is_told_so() -> None:
    rng = np.random.default_rng(3)
    points, links = random_flight(rng, 4, 60, 30, 0.0)
    even = join_tracks(points, links, CAMERA, ALL)
    spread = {tuple(pixel): rng.uniform(1, 3) for p in points for pixel in p.pixel.tolist()}
    uneven = [replace(p, spread=np.array([spread[tuple(q)] for q in p.pixel.tolist()])) for p in points]
    found = join_tracks(uneven, links, CAMERA, ALL)
    expected = [spread[tuple(q)] for q in found.pixel.tolist()]
    np.testing.assert_allclose(found.std_px / even.std_px, expected)


def test_selection_takes_the_longest_of_each_cell_of_each_picture_and_nothing_else() -> None:
    rng = np.random.default_rng(5)
    points, links = random_flight(rng, 15, 150, 120, 0.0)
    everything = join_tracks(points, links, CAMERA, ALL)
    grid = (8, 6)
    chosen = join_tracks(points, links, CAMERA, TrackConfig(grids=(grid,)))
    length = np.bincount(everything.track)
    label = {
        (int(k), *p): int(t)
        for k, t, p in zip(everything.keyframe, everything.track, everything.pixel.tolist(), strict=True)
    }
    kept = {label[int(k), p[0], p[1]] for k, p in zip(chosen.keyframe, chosen.pixel.tolist(), strict=True)}
    cells: dict[tuple[int, int, int], list[int]] = {}
    for (k, x, y), t in label.items():
        cells.setdefault((k, int(x * 8 / 320), int(y * 6 / 240)), []).append(t)
    best_of = {cell: max(length[t] for t in inside) for cell, inside in cells.items()}
    for cell, inside in cells.items():
        assert max((length[t] for t in inside if t in kept), default=0) == best_of[cell]
    for t in kept:  # each is the longest somewhere
        mine = [cell for cell, inside in cells.items() if t in inside]
        assert any(best_of[cell] == length[t] for cell in mine)
    assert len(kept) < len(length)
    # A chosen track is chosen whole.
    assert np.bincount(chosen.track).sum() == sum(length[t] for t in kept)


def test_too_many_observations_call_for_a_coarser_grid() -> None:
    points, links = random_flight(np.random.default_rng(6), 15, 150, 120, 0.0)
    grids = ((8, 6), (6, 4), (4, 3))
    alone = [join_tracks(points, links, CAMERA, TrackConfig((g,))) for g in grids]
    sizes = [len(t.track) for t in alone]
    assert sizes[0] > sizes[1] > sizes[2]
    for limit, expected in ((sizes[0], 0), (sizes[0] - 1, 1), (sizes[2], 2)):
        tracks = join_tracks(points, links, CAMERA, TrackConfig(grids, limit))
        np.testing.assert_array_equal(tracks.pixel, alone[expected].pixel)


@pytest.mark.parametrize("limit", [500, 300, 1])
def test_the_ceiling_holds_and_every_keyframe_keeps_its_share(limit: int) -> None:
    points, links = random_flight(np.random.default_rng(6), 15, 150, 120, 0.0)
    whole = join_tracks(points, links, CAMERA, TrackConfig(((4, 3),)))
    some = join_tracks(points, links, CAMERA, TrackConfig(((4, 3),), limit, least_a_keyframe=12))
    quota = max(12, limit // 15)
    assert len(some.track) <= 15 * quota < len(whole.track)
    per_keyframe = np.bincount(some.keyframe, minlength=15)
    assert per_keyframe.max() <= quota
    assert per_keyframe.min() >= 0.6 * quota  # what is left alone in its track goes too
    assert np.bincount(some.track).min() >= 2
    seen = {(int(k), *p) for k, p in zip(whole.keyframe, whole.pixel.tolist(), strict=True)}
    assert {(int(k), *p) for k, p in zip(some.keyframe, some.pixel.tolist(), strict=True)} <= seen
    # Spread: hardly a keyframe has its points in less than half of its picture.
    for k in range(15):
        cells = {(int(x * 4 / 320), int(y * 3 / 240)) for x, y in some.pixel[some.keyframe == k]}
        assert len(cells) >= 6


def test_nothing_matched_gives_no_tracks() -> None:
    for pixels in ([np.zeros((3, 2)), np.zeros((0, 2))], [], [np.zeros((0, 2))] * 2):
        tracks = join_tracks([Points.alike(p) for p in pixels], [], CAMERA, TrackConfig())
        assert len(tracks.track) == len(tracks.keyframe) == len(tracks.pixel) == len(tracks.std_px) == 0
    three = Points.alike(np.zeros((3, 2)))
    empty = join_tracks([three] * 2, [link(0, 1, np.empty((0, 2)))], CAMERA, TrackConfig())
    assert len(empty.track) == 0
