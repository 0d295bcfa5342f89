"""One false step of odometry that its pictures believe, against the loops that lead over it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from backend import se3
from backend.measurements import RelativePose
from frontend.registration import Registration
from slam.core.progress import silent
from slam.core.stage_timer import Stopwatch
from slam.mapping import contradicted_odometry
from slam.mapping.config import PipelineConfig
from slam.mapping.context import Context, Job
from slam.mapping.contradicted_odometry import contradicted_step, without_step
from slam.mapping.contradicted_step import ContradictedStep
from slam.mapping.front_end import Observations
from slam.mapping.map import Map
from slam.mapping.obstacles import no_masks
from slam.mapping.stages import close_loops, odometry, track
from tests.slam.mapping.exact_flight import registration
from tests.slam.mapping.made_map import CAMERA, made_map
from tests.slam.small_flight import flown

N, STEP, OFF_M = 24, 8, 0.4
CHAIN = [(k, k + a) for a in (1, 2) for k in range(N - a)]
LOOPS = [(k, N - 1 - k - a) for k in range(9) for a in (0, 1)]
"""All lead over the step: the flight goes out for half of the keyframes, and back over the same ground."""


def true_poses() -> np.ndarray:
    k = np.arange(N)
    T = np.tile(np.eye(4), (N, 1, 1))
    T[:, :3, 3] = np.column_stack([0.15 * np.minimum(k, N - 1 - k), np.zeros(N), np.ones(N)])
    return T


def believed_poses() -> np.ndarray:
    """The same with all that follows the step off to the side."""
    T = true_poses()
    T[STEP + 1 :, 1, 3] += OFF_M
    return T


def judged(
    monkeypatch: pytest.MonkeyPatch,
    loops: list[tuple[int, int]] = LOOPS,
    where: Callable[[], np.ndarray] = true_poses,
) -> tuple[Map, Observations, ContradictedStep | None]:
    """What is found where a second look finds the pairs at the poses ``where``."""
    true, believed = true_poses(), believed_poses()
    chain = made_map(believed, np.zeros(N, dtype=np.int64))
    links = [registration(believed, i, j, camera=CAMERA) for i, j in CHAIN]
    chain = replace(chain, observations=replace(chain.observations, registrations=tuple(links)))
    found = replace(
        chain.observations,
        registrations=(*links, *(registration(true, i, j, camera=CAMERA) for i, j in loops)),
    )

    def edge(T: np.ndarray, i: int, j: int) -> RelativePose:
        std_m = 3e-3 if i <= STEP < j else 1e-3  # damaged pictures fit worse
        return RelativePose(i, j, se3.inverse(T[i]) @ T[j], std_m**2 * np.eye(6), "odometry")

    def again(pairs: list[tuple[int, int]], *_: object, **__: object) -> list[Registration]:
        return [registration(where(), i, j, camera=CAMERA) for i, j in pairs]

    monkeypatch.setattr(contradicted_odometry, "verify", again)
    front_end = SimpleNamespace(camera=CAMERA, homography=None, config=PipelineConfig())
    edges = [*(edge(believed, *pair) for pair in CHAIN), *(edge(true, *pair) for pair in loops)]
    return chain, found, contradicted_step(front_end, chain, found, edges)


def test_a_step_that_many_pairs_contradict_alike_is_left_out_and_they_stay(monkeypatch):
    chain, found, step = judged(monkeypatch)
    assert step is not None
    assert step.left_out
    assert step.pairs == len(LOOPS)
    assert step.weakest == (STEP, STEP + 1)
    assert step.between == (8, 14)
    assert step.off.length == pytest.approx(OFF_M)
    left = without_step(found, chain, step)
    pairs = {(r.i, r.j) for r in left.registrations}
    assert pairs == {(i, j) for i, j in CHAIN if not i <= STEP < j} | set(LOOPS)
    assert left.contradicted_steps == (step,)
    assert "18 pairs of pictures agree with each other and contradict the odometry by 0.4 m" in str(
        step.sentence(str)
    )


def test_a_floor_that_repeats_does_not_contradict_odometry(monkeypatch):
    """There the pictures match at a copy, and where odometry has them as well."""
    assert judged(monkeypatch, where=believed_poses)[2] is None


def test_no_more_pairs_than_links_decide_nothing_but_are_told(monkeypatch):
    chain, found, step = judged(monkeypatch, LOOPS[:3])
    assert step is not None
    assert not step.left_out
    assert "too few to tell which is wrong" in str(step.sentence(str))
    assert without_step(found, chain, step).registrations == found.registrations


def test_as_many_pairs_that_agree_speak_for_odometry(monkeypatch):
    _, _, step = judged(monkeypatch, [])
    assert step is None


@pytest.mark.slow
def test_a_false_step_that_pictures_believe_is_undone_by_the_loops_over_it():
    """All links over one step are off alike, as by pictures that a decoder has smeared."""
    flight = flown(0)
    assert flight.camera is not None
    context, observations = track(Job(flight.camera, PipelineConfig(), silent, Stopwatch()), flight, no_masks)
    n = len(observations.stamps_s)

    def error_m(context: Context, observations: Observations) -> tuple[float, Map]:
        closed = close_loops(context, odometry(context, observations))
        true = np.array(
            [flight.truth.w_T_b[np.abs(flight.truth.stamps_s - t).argmin()] for t in observations.stamps_s]
        )
        apart = [np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=2) for T in (closed.w_T_b, true)]
        return float(np.sqrt(np.mean((apart[0] - apart[1]) ** 2))), closed

    right_m, right = error_m(context, observations)
    assert right.observations.contradicted_steps == ()
    step, shift = n // 4, np.eye(3)
    shift[0, 2] = 0.5 * flight.camera.size_px[0]
    changed = {
        (r.i, r.j): replace(r, i_H_j=shift @ r.i_H_j) if r.i <= step < r.j else r
        for r in observations.registrations
    }
    links = tuple(link and changed[link.i, link.j] for link in observations.links)
    wrong = replace(observations, links=links, registrations=tuple(changed.values()))
    found_m, closed = error_m(context, wrong)
    assert closed.observations.contradicted_steps[0].left_out
    assert found_m < 1.5 * right_m + 1e-3
