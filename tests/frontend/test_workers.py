"""Sharing of jobs: order, memory, errors, and that each stage's jobs can be sent to another process."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, replace

import numpy as np
import pytest

from frontend.features import Extractor
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig
from frontend.keyframes import KeyframeConfig, Tracker
from frontend.loops import verify
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import plan_mosaic
from frontend.mosaic.render import RenderedTile, measure_exposure, render_tiles
from frontend.registration import Registration
from frontend.store import FeatureStore
from frontend.tracked import Keyframe
from frontend.workers import AHEAD, Ready, Workers, share_with, workers
from tests.frontend.mosaic.scene import CAMERA, FLOOR_Z_M, photograph, smooth_floor, survey
from tests.frontend.sent_workers import SentWorkers
from tests.frontend.small_flight import small_flight


def slow_square(delay_s: dict[int, float], x: int) -> int:
    time.sleep(delay_s.get(x, 0.0))
    return x * x


def test_results_come_in_order_whatever_takes_longest() -> None:
    assert list(Workers(4).map(slow_square, {0: 0.05, 3: 0.02}, range(9))) == [k * k for k in range(9)]
    assert list(Workers(2).map(slow_square, {}, [])) == []


def test_known_results_keep_their_place_and_cost_no_job() -> None:
    items = [1, Ready(-1), 2, Ready(-2), Ready(-3)]
    assert list(Workers(2).map(slow_square, {}, items)) == [1, -1, 4, -2, -3]


def test_only_as_many_items_are_taken_as_results_may_wait() -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for k in range(100):
            taken.append(k)
            yield k

    results = Workers(2).map(slow_square, {}, items())
    assert next(results) == 0
    assert len(taken) == 2 * AHEAD
    assert next(results) == 1
    assert len(taken) == 2 * AHEAD + 1
    results.close()  # type: ignore[attr-defined]
    assert len(taken) == 2 * AHEAD + 1


def test_no_more_jobs_run_at_a_time_than_memory_allows() -> None:
    running, most = [0], [0]
    lock = threading.Lock()

    def job(shared: None, k: int) -> None:
        with lock:
            running[0] += 1
            most[0] = max(most[0], running[0])
        time.sleep(0.005)
        with lock:
            running[0] -= 1

    list(Workers(4).map(job, None, range(12), at_once=2))
    assert most == [2]


def test_what_a_job_raises_comes_through_and_ends_the_others() -> None:
    begun: list[int] = []

    def job(shared: None, k: int) -> None:
        begun.append(k)
        if k == 1:
            raise OSError("the disk has gone")
        time.sleep(0.01)

    with pytest.raises(OSError, match="the disk has gone"):
        list(Workers(2).map(job, None, range(100)))
    assert len(begun) < 10


def test_the_chosen_workers_are_those_of_the_block_and_of_its_thread() -> None:
    chosen, other = Workers(3), []
    with share_with(chosen):
        assert workers() is chosen
        thread = threading.Thread(target=lambda: other.append(workers()))
        thread.start()
        thread.join()
    assert workers() is not chosen
    assert other[0] is not chosen


def compared() -> list[Registration]:
    flight, store, extract = small_flight(), FeatureStore(), Extractor()
    for k in (0, 3, 6, 9):
        store.append(extract(flight.images[k], flight.camera))
    pairs = [(i, j) for j in range(4) for i in range(j)]
    return list(verify(pairs, store, flight.camera, HomographyConfig(), GateConfig()))


def tracked() -> list[Keyframe]:
    flight = small_flight()
    images = [flight.images[k] for k in (0, 4, 4, 8)]
    images[2:2] = [None]
    tracker = Tracker(flight.camera, Extractor(), HomographyConfig(), GateConfig(), KeyframeConfig())
    found = list(tracker.every(images.__getitem__, len(images)))
    assert tracker.dropped[2] == "unreadable"
    assert [k.frame for k in found] == [0, 1, 4], "the same picture twice is one"
    return found


def drawn() -> list[RenderedTile]:
    floor, poses = smooth_floor(1), survey(3, rows=1, cols=3)
    views = [photograph(floor, CAMERA, T, 1) for T in poses]
    plan = replace(plan_mosaic(CAMERA, poses, FLOOR_Z_M, 0.04), tile_px=64)
    pictures = Pictures(plan, views.__getitem__)
    return list(render_tiles(plan, pictures, measure_exposure(plan, pictures)))


@pytest.mark.parametrize("stage", [compared, tracked, drawn])
def test_jobs_that_are_sent_elsewhere_give_the_same_bits(stage) -> None:
    here = stage()
    with share_with(SentWorkers(2)):
        there = stage()
    assert len(here) == len(there) > 2
    for one, other in zip(here, there, strict=True):
        np.testing.assert_equal(asdict(one), asdict(other))


def test_after_a_signal_nobody_waits_for_a_thread():
    """The signal may have left a lock taken that the thread waits for."""
    freed, done = threading.Event(), []

    def job(_: None, item: int) -> None:
        freed.wait(5.0)
        done.append(item)

    def items() -> Iterator[int]:
        yield 0
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(Workers(1).map(job, None, items()))
    assert done == []
    freed.set()
