"""Speed of the front end on the demo's frames, and its ratio to the time of OpenCV alone.

Frames are rendered beforehand. For each segment of the flight one untimed run records every OpenCV call, and
instead of our SIFT OpenCV's on the same picture. Then the front end and the list of recorded calls run in
alternation; the best of several rounds counts. CPU seconds of tracking by optical flow and by the features of
every picture are compared in alternation too.
"""

from __future__ import annotations

import ast
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

import frontend
from frontend import registration
from frontend.detections import Described
from frontend.features import Features
from frontend.keyframes import KeyframeConfig
from frontend.scale_space import CONTRAST, EDGE_RATIO
from frontend.sift import Sift
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.core.streams import Frames, Image
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import FrontEnd
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe
from tests.benchmarks.metric import Metric, at_least, at_most, reported

CORES = 2
PIECES, TURNS, TURNS_BY_FEATURES = 8, 5, 2
ASKED = {(176, 144): 350.0, (320, 240): 200.0}
"""Target in frames a second, by the size of the pictures."""


def measure() -> list[Metric]:
    """Return frames a second and the two ratios, for two sizes of pictures."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CORES])
    cv2.setNumThreads(CORES)
    eight = load_recipe("figure_eight")
    assert eight.camera is not None
    metrics = []
    for size_px, asked in ASKED.items():
        flight = simulate(replace(eight, camera=replace(eight.camera, size_px=size_px)), 0)
        metrics += of_size("x".join(map(str, size_px)), in_memory(flight), asked)
    return metrics


def of_size(size: str, pieces: list[Flight], asked: float) -> list[Metric]:
    """Return the figures of one size of pictures."""
    count = sum(len(piece.frames) for piece in pieces if piece.frames)
    ours, bare, matching = map(sum, zip(*(best_of(piece) for piece in pieces), strict=True))
    by_flow, by_features = map(sum, zip(*(cpu_of(piece) for piece in pieces), strict=True))
    per_frame = f"{1e3 * ours / count:.1f} ms over {{:.1f}} ms a frame, best of {TURNS} turns"
    return [
        at_least(f"front end on the demo's frames, {size}, two cores", count / ours, "frames/s", asked),
        at_most(
            f"front end over OpenCV's calls and SIFT for the same pictures, {size}", ours / bare, "x", 1.15,
            per_frame.format(1e3 * bare / count),
        ),
        reported(
            f"front end over the same with OpenCV's matcher (batchDistance) for its matrix product, {size}",
            ours / (bare + matching), "x", per_frame.format(1e3 * (bare + matching) / count),
        ),
        at_most(
            f"CPU time of tracking by optical flow over that by the features of every frame, {size}",
            by_flow / by_features, "x", 0.5,
            f"{1e3 * by_flow / count:.1f} over {1e3 * by_features / count:.1f} ms a frame",
        ),
    ]  # fmt: skip


def in_memory(flight: Flight) -> list[Flight]:
    """Return the flight in rendered segments: the best time of a short segment is free of other load."""
    assert flight.frames is not None
    frames, pieces = flight.frames, []
    for k in np.array_split(np.arange(len(frames)), PIECES):
        images = [frames.load(int(n)) for n in k]
        names = tuple(frames.names[n] for n in k)
        piece = Frames(frames.stamps_s[k], names, images.__getitem__)
        pieces.append(replace(flight, frames=piece))
    return pieces


def best_of(piece: Flight) -> tuple[float, float, float]:
    """Return the least seconds of the front end, of OpenCV's calls and SIFT, and of OpenCV's matcher, in
    alternation."""
    with recorded() as record:
        track(piece)
    turns = [
        (timed(lambda: track(piece)), timed(lambda: again(record.calls)), timed(lambda: matched(record)))
        for _ in range(TURNS)
    ]
    ours, bare, matching = (min(column) for column in zip(*turns, strict=True))
    return ours, bare, matching


def cpu_of(piece: Flight) -> tuple[float, float]:
    """Return the least CPU seconds of tracking by optical flow and by features, in alternation."""
    turns = [
        [timed(lambda flow=flow: track(piece, flow), time.process_time) for flow in (True, False)]
        for _ in range(TURNS_BY_FEATURES)
    ]
    by_flow, by_features = (min(column) for column in zip(*turns, strict=True))
    return by_flow, by_features


def track(flight: Flight, flow: bool = True) -> None:
    """Run the front end over all frames: tracking, gates, keyframes."""
    assert flight.camera is not None
    config = PipelineConfig(keyframes=KeyframeConfig(flow=flow))
    with threadpool_limits(1, "blas"):  # as the pipeline has it
        FrontEnd(flight, flight.camera, config, silent).track()


def timed(work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the seconds of a call."""
    began = clock()
    work()
    return clock() - began


Call = tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]


@dataclass(frozen=True)
class Record:
    """Recorded OpenCV calls and matched descriptors."""

    calls: list[Call]
    pairs: list[tuple[Features, Features]]


def again(calls: list[Call]) -> None:
    """Repeat the recorded calls."""
    for call, arguments, named in calls:
        call(*arguments, **named)


def matched(record: Record) -> None:
    """Match the same descriptors by OpenCV: two nearest forward, the nearest backward."""
    for a, b in record.pairs:
        cv2.batchDistance(a.descriptor, b.descriptor, cv2.CV_32F, normType=cv2.NORM_L2, K=2)
        cv2.batchDistance(b.descriptor, a.descriptor, cv2.CV_32F, normType=cv2.NORM_L2, K=1)


@contextmanager
def recorded() -> Iterator[Record]:
    """Record every OpenCV function that the front end's source calls, and OpenCV's SIFT in place of ours."""
    record, paused = Record([], []), False

    def listed(call: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*arguments: Any, **named: Any) -> Any:
            if not paused:
                record.calls.append((call, arguments, named))
            return call(*arguments, **named)

        return wrapped

    def search(own: Sift, grey: Image, mask: Image | None, limit: int) -> Described | None:
        nonlocal paused
        api: Any = cv2  # the type stubs lack its last argument
        theirs = api.SIFT_create(
            limit, contrastThreshold=CONTRAST, edgeThreshold=EDGE_RATIO, enable_precise_upscale=True
        )
        record.calls.append((theirs.detectAndCompute, (grey, mask), {}))
        paused = True
        try:
            return searched(own, grey, mask, limit)
        finally:
            paused = False

    searched = Sift.__call__

    def match(a: Features, b: Features, *arguments: Any) -> Any:
        record.pairs.append((a, b))
        return original(a, b, *arguments)

    original = registration.match
    with mock.patch.object(registration, "match", match):
        patches = [mock.patch.object(cv2, name, listed(getattr(cv2, name))) for name in functions()]
        patches.append(mock.patch.object(Sift, "__call__", search))
        for patch in patches:
            patch.start()
        try:
            yield record
        finally:
            for patch in patches:
                patch.stop()


def functions() -> set[str]:
    """Return the names of the OpenCV functions that the front end calls."""
    names = set()
    for path in Path(frontend.__path__[0]).glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("cv2."):
                names.add(ast.unparse(node.func).removeprefix("cv2."))
    return {name for name in names if name[0].islower() and "." not in name}
