"""The front end over a whole flight: what is compared, once, and what is kept of it."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from backend.measurements import LinkCheck, Rejection
from frontend.camera import Camera
from frontend.features import FeatureConfig
from frontend.loops import verify
from frontend.registration import Registration
from frontend.retrieval import Candidates
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.core.streams import Frames
from slam.mapping.config import LoopConfig, PipelineConfig
from slam.mapping.front_end import FrontEnd, Observations
from slam.mapping.read_ahead import read_ahead
from slam.mapping.search_radius import SearchRadius
from tests.slam.small_flight import flown, only, seeing

CONFIG = PipelineConfig()


@lru_cache
def watched() -> tuple[Flight, FrontEnd, Observations]:
    flight = flown(0)
    front_end = FrontEnd(flight, flight.camera, CONFIG, silent)
    return flight, front_end, front_end.track()


def unknown_reach(n: int) -> SearchRadius:
    """Of n keyframes of which nothing is known yet: any two may have seen the same ground."""
    return SearchRadius(np.full((n, 3), np.nan), np.full(n, np.nan), np.zeros(n, dtype=np.int64))


@lru_cache
def retrieved() -> Observations:
    """With the loops that retrieval finds where nothing is known of the poses."""
    _, front_end, observations = watched()
    return front_end.close_loops(observations, unknown_reach(len(observations.store)))


def pose(flight: Flight, stamp_s: float) -> np.ndarray:
    """The true pose nearest in time."""
    return flight.truth.w_T_b[np.abs(flight.truth.stamps_s - stamp_s).argmin()]


def off_px(flight: Flight, camera: Camera, observations: Observations, r: Registration) -> float:
    """Largest corner error of a registration against the truth."""
    floor_H = [camera.floor_H_image(pose(flight, observations.stamps_s[k])) for k in (r.i, r.j)]
    expected = np.linalg.inv(floor_H[0]) @ floor_H[1]
    corner = np.column_stack([camera.corners_px, np.ones(4)])
    a, b = corner @ expected.T, corner @ r.i_H_j.T
    return float(np.linalg.norm(a[:, :2] / a[:, 2:] - b[:, :2] / b[:, 2:], axis=1).max())


def counting(front_end: FrontEnd) -> Counter[str]:
    """Count the extractions of a front end from here on."""
    count, extract = Counter(), front_end.extractor

    def counted(*picture):
        count["extracted"] += 1
        return extract(*picture)

    counted.config = extract.config
    front_end.extractor = counted
    return count


def test_a_pass_with_masks_repeats_only_what_they_change():
    """The same result to the bit as a front end that knows of no earlier pass, with less work."""
    flight = only(flown(0), range(32))
    first = FrontEnd(flight, flight.camera, CONFIG, silent)
    observations = first.track()
    first.neighbours(observations)
    hidden = int(observations.frame_index[len(observations.frame_index) // 2])

    def masks(frame: int) -> np.ndarray:
        mask = np.full(flight.camera.size_px[::-1], 255, np.uint8)
        mask[:, : flight.camera.size_px[0] // 3] = 0 if frame == hidden else 255
        return mask

    work, results, compared = [], [], []
    for earlier in (None, first.work):
        front_end = FrontEnd(
            flight, flight.camera, CONFIG, lambda *done: compared.append(done), earlier, masks
        )
        count = counting(front_end)
        results.append(front_end.neighbours(front_end.track()))
        work.append((count["extracted"], sum(stage == "neighbours" for stage, *_ in compared)))
        compared.clear()
    alone, again = results
    assert again.frame_index.tolist() == alone.frame_index.tolist()
    for k in range(len(alone.store)):
        assert again.store.digest(k) == alone.store.digest(k)
    assert len(again.registrations) == len(alone.registrations)
    for r, s in zip(again.registrations, alone.registrations, strict=True):
        assert (r.i, r.j) == (s.i, s.j)
        assert np.array_equal(r.i_H_j, s.i_H_j)
        assert np.array_equal(r.matches, s.matches)
    assert work[1][0] < 0.7 * work[0][0]
    assert work[1][1] < 0.7 * work[0][1]


def test_keyframes_are_linked_to_the_one_before():
    _, _, observations = watched()
    assert observations.links[0] is None
    assert [(r.i, r.j) for r in observations.links[1:]] == [
        (k, k + 1) for k in range(len(observations.links) - 1)
    ]
    assert observations.registrations == observations.links[1:]
    assert len(observations.store) == len(observations.links) == len(observations.stamps_s)
    assert observations.frames == 98
    assert observations.refused == ()


def test_neighbours_tie_the_chain_crosswise():
    """Two to four keyframes back, where enough is shared; each pair once."""
    _, front_end, observations = watched()
    tied = front_end.neighbours(observations)
    added = [(r.i, r.j) for r in tied.registrations[len(observations.registrations) :]]
    assert len(added) >= 10
    assert {j - i for i, j in added} == {2, 3, 4}
    pairs = Counter((r.i, r.j) for r in (*tied.registrations, *tied.refused))
    assert max(pairs.values()) == 1


@pytest.mark.parametrize("all_that_cross", [False, True])
def test_a_neighbour_off_the_chain_is_refused_unless_most_contradict_it(monkeypatch, all_that_cross):
    """One pair a tile off is a look-alike; where all that cross the link from 5 to 6 are, the link may be."""
    _, front_end, observations = watched()

    def astray(r: Registration) -> bool:
        return r.i <= 5 < r.j if all_that_cross else (r.i, r.j) == (5, 7)

    def slipped(*arguments, **named):
        for r in verify(*arguments, **named):
            off = np.eye(3)
            off[0, 2] = 60.0 if astray(r) else 0.0
            yield replace(r, i_H_j=off @ r.i_H_j)

    monkeypatch.setattr("slam.mapping.front_end.verify", slipped)
    tied = front_end.neighbours(observations)
    assert (5, 7) in {(r.i, r.j) for r in (*tied.registrations, *tied.refused)}
    told = [(r.i, r.j) for r in tied.refused if r.reason.check is LinkCheck.CHAIN]
    assert told == ([] if all_that_cross else [(5, 7)])


def test_neighbours_do_not_reach_across_a_break():
    _, front_end, observations = watched()
    links = list(observations.links)
    links[6] = None
    broken = Observations(
        observations.store,
        observations.frame_index,
        observations.stamps_s,
        tuple(links),
        tuple(r for r in links if r is not None),
        (),
        observations.frames,
        Counter(),
    )
    tied = front_end.neighbours(broken)
    assert not [r for r in (*tied.registrations, *tied.refused) if r.i < 6 <= r.j]


def test_retrieval_finds_the_loops_and_they_hold():
    flight, _, observations = watched()
    found = retrieved()
    loops = [r for r in found.registrations if observations.stamps_s[r.j] - observations.stamps_s[r.i] > 5.0]
    assert len(loops) >= 5
    # Corners lie far outside the common part: a few pixels are an excellent fit.
    assert max(off_px(flight, flight.camera, observations, r) for r in loops) < 8.0
    assert all(r.reason for r in found.refused)
    assert all(r.ok for r in found.registrations)


def test_a_revisit_adds_what_the_poses_say_and_compares_no_pair_twice():
    flight, front_end, observations = watched()
    found = retrieved()
    w_T_b = np.array([pose(flight, t) for t in observations.stamps_s])
    seen = front_end.match_overlaps(found, w_T_b, 0.0)
    assert seen.registrations[: len(found.registrations)] == found.registrations
    pairs = Counter((r.i, r.j) for r in (*seen.registrations, *seen.refused))
    assert max(pairs.values()) == 1
    assert len(seen.registrations) > len(found.registrations)
    again = front_end.match_overlaps(seen, w_T_b, 0.0)
    assert len(again.registrations) == len(seen.registrations)
    assert len(again.refused) == len(seen.refused)
    lost = front_end.match_overlaps(observations, np.full_like(w_T_b, np.nan), 0.0)
    assert lost.registrations == observations.registrations


def test_each_keyframe_of_a_long_flight_is_compared_with_as_many_as_in_a_short_one(monkeypatch):
    flight, _, observations = watched()
    asked = []
    monkeypatch.setattr("slam.mapping.front_end.overlapping", lambda *inputs: asked.append(inputs[4]) or [])
    monkeypatch.setattr(
        "slam.mapping.front_end.propose_loops",
        lambda store, retrieval, gate: asked.append(retrieval.neighbours) or Candidates((), ()),
    )
    short_of_total = replace(CONFIG, loops=LoopConfig(max_pairs=2 * len(observations.store)))
    fewer = replace(CONFIG, loops=LoopConfig(max_neighbours=20))
    for config in (CONFIG, short_of_total, fewer):
        front_end = FrontEnd(flight, flight.camera, config, silent)
        front_end.close_loops(observations, unknown_reach(len(observations.store)))
        for count in (1, 10, 200, 10_000):
            front_end.match_overlaps(observations, np.tile(np.eye(4), (count, 1, 1)), 0.0)
    n, each = len(observations.store), CONFIG.retrieval.neighbours
    assert asked[:5] == [each, 80, 80, 60, 16]
    assert asked[5:10] == [4, min(80, 4 * n), min(80, 4 * n // 10), 4, 4]
    assert asked[10:] == [each, 20, 20, 20, 16]


def test_refused_afterwards_is_refused_with_its_reason():
    _, _, observations = watched()
    fewer = observations.without({(2, 3): Rejection(LinkCheck.PLACE, "because")})
    assert (2, 3) not in {(r.i, r.j) for r in fewer.registrations}
    assert [(r.i, r.j, r.reason) for r in fewer.refused] == [(2, 3, Rejection(LinkCheck.PLACE, "because"))]
    assert len(fewer.registrations) + 1 == len(observations.registrations)
    assert fewer.contradicted == {(2, 3)}


def counted(count: int) -> tuple[Flight, list[int], list[threading.Thread]]:
    """A flight whose pictures say when they are read."""
    read: list[int] = []
    threads: list[threading.Thread] = []

    def load(k: int) -> np.ndarray:
        read.append(k)
        threads.append(threading.current_thread())
        return np.full((2, 2), k, np.uint8)

    names = tuple(str(k) for k in range(count))
    return Flight("f", frames=Frames(np.arange(count) * 1.0, names, load)), read, threads


def test_pictures_are_read_once_in_order_and_one_ahead():
    flight, read, threads = counted(20)
    told: list[int] = []
    for k, image in enumerate(read_ahead(flight, lambda stage, done, total: told.append(done))):
        assert image[0, 0] == k
        assert len(read) <= k + 2
    assert read == list(range(20))
    assert told == list(range(1, 21))
    assert threading.current_thread() not in threads


def test_no_pictures_are_no_trouble():
    flight, read, _ = counted(0)
    assert list(read_ahead(flight, silent)) == []
    assert read == []


def test_what_reading_raises_comes_through():
    flight = flown(0)

    def load(k: int) -> np.ndarray:
        if k == 3:
            raise OSError("the disk has gone")
        return flight.frames.load(k)

    with pytest.raises(OSError, match="the disk has gone"):
        list(read_ahead(seeing(flight, load), silent))


def test_a_detector_that_the_build_lacks_is_an_error_of_the_input() -> None:
    flight = flown(0)
    with pytest.raises(InputError, match="lacks SURF") as refused:
        FrontEnd(flight, flight.camera, replace(CONFIG, features=FeatureConfig("surf")), silent)
    assert "\n" not in str(refused.value)


def test_similar_pictures_out_of_reach_are_not_compared_with_the_reason():
    _, front_end, observations = watched()
    everywhere = retrieved()
    n = len(observations.store)
    apart = SearchRadius(
        10.0 * np.arange(n)[:, None] * [1.0, 0, 0], np.full(n, 4.0), np.zeros(n, dtype=np.int64)
    )
    nowhere = front_end.close_loops(observations, apart)
    assert len(everywhere.registrations) > len(observations.registrations)
    assert len(nowhere.registrations) == len(observations.registrations)
    told = nowhere.refused[len(observations.refused) :]
    assert len(told) >= n
    assert all(r.reason.check is LinkCheck.REACH and len(r.matches) == 0 for r in told)
    pairs = [(r.i, r.j) for r in (*nowhere.registrations, *nowhere.refused)]
    assert len(pairs) == len(set(pairs))
