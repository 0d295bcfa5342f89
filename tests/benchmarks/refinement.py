"""Refinement of made surveys: time of an iteration and of a whole refinement, and peak memory.

A camera flies along parallel legs over a flat floor, with a rangefinder and attitudes. Each keyframe sees 180
points, each point is seen by five keyframes on average, of its own leg and of those beside. gtsam's time is
that of one step of Gauss and Newton on the graph with one factor for each observation, in the same run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar
from unittest.mock import patch

import gtsam
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from backend import se3
from backend.bundle import noise
from backend.bundle.free_points import FreePoints
from backend.bundle.graph import start_variables
from backend.bundle.minimise import BundleCost, minimise_bundle
from backend.bundle.noise import start_noise
from backend.bundle.problem import BundleConfig, BundleProblem, Variables
from backend.bundle.refinement import refine
from backend.measurements import Attitude, FloorTracks, Measurements, SlantRange
from backend.pose_graph.elimination import nested_dissection
from tests.backend.bundle.factor_graph import all_values, factor_graph
from tests.backend.made_floor import CAMERA, SIZE_PX
from tests.benchmarks.apart import peak_mb
from tests.benchmarks.metric import Metric, at_most, reported

T = TypeVar("T")

LIMITS_S = {163: 0.06, 1000: 0.6, 2500: 2.0}
"""Processor time of an iteration that must not be exceeded, by number of keyframes."""
HEIGHT_M, ALONG, ASIDE, POINTS_IN_VIEW = 0.8, 0.3, 0.6, 180
"""Height, distances of keyframes along a leg and of the legs, over the height, and points in a picture."""
PIXEL_STD, TILT_STD_RAD, RANGE_STD_M = 0.3, 0.01, 0.01
REPEATS = 3


def measure() -> list[Metric]:
    """Measure each size, in one process, with one thread of BLAS as in a map."""
    with threadpool_limits(1, "blas"):
        refine(*survey(20, seed=0))  # compiles the kernels
        figures = [metric for count, limit in LIMITS_S.items() for metric in _metrics(count, limit)]
    return figures


def _metrics(count: int, limit_s: float) -> list[Metric]:
    measured, start = survey(count, seed=0)
    cost, at = _posed(measured, start)
    seconds = min(_timed(lambda: minimise_bundle(cost, at, 5, 0.0))[0] / 5 for _ in range(REPEATS))
    with _summed(noise, "find_heights") as of_relief, _summed(FreePoints, "of") as of_points:
        whole_s, bundle = _timed(lambda: refine(measured, start))
    observations = len(cost.observations.track)
    metrics = [
        at_most(
            f"{count} keyframes: processor time of an iteration", seconds, "s", limit_s,
            f"{observations} observations of {len(at.point)} points; best of {REPEATS} times 5 iterations",
        ),
        reported(
            f"{count} keyframes: processor time of a refinement", whole_s, "s",
            f"{bundle.iterations} iterations, noise and covariances included",
        ),
        at_most(
            f"{count} keyframes: time of the heights of points over that of a refinement of this flat floor",
            (sum(of_relief) + sum(of_points)) / whole_s, "", 0.1,
        ),
        reported(f"{count} keyframes: peak memory of the process", peak_mb() / 1000, "GB"),
    ]  # fmt: skip
    if count == min(LIMITS_S):
        raw_s = min(_timed(lambda: _gtsam_step(cost, at))[0] for _ in range(REPEATS))
        metrics.append(
            at_most(
                f"{count} keyframes: iteration over gtsam's with a factor for each observation",
                seconds / raw_s, "x", 0.1, f"{1e3 * seconds:.0f} ms over {1e3 * raw_s:.0f} ms",
            )
        )  # fmt: skip
    return metrics


def _gtsam_step(cost: BundleCost, at: Variables) -> None:
    """Build nothing: linearise, eliminate in METIS' order, and evaluate the error."""
    graph, values = _GRAPHS.setdefault(id(cost), (factor_graph(cost), all_values(cost, at)))
    linear = graph.linearize(values)
    graph.error(values.retract(linear.optimize(nested_dissection(graph))))


_GRAPHS: dict[int, tuple[gtsam.NonlinearFactorGraph, gtsam.Values]] = {}


def _posed(measured: Measurements, start: np.ndarray) -> tuple[BundleCost, Variables]:
    assert measured.tracks is not None
    assert measured.camera is not None
    problem = BundleProblem(measured, measured.tracks, measured.camera, BundleConfig(), False)
    at = start_variables(problem, start, 0.0)
    used = np.ones(len(measured.tracks.track), dtype=bool)
    return BundleCost.of(problem, start_noise(measured, problem.config), used, at.values), at


def _timed(run: Callable[[], T]) -> tuple[float, T]:
    began = time.process_time()
    found = run()
    return time.process_time() - began, found


@contextmanager
def _summed(holder: object, name: str) -> Iterator[list[float]]:
    """Yield a list to which the processor time of each call of a function of ``holder`` is added."""
    run, found = getattr(holder, name), list[float]()

    def timed(*arguments: object) -> object:
        seconds, result = _timed(lambda: run(*arguments))
        found.append(seconds)
        return result

    with patch.object(holder, name, timed):
        yield found


def survey(count: int, seed: int) -> tuple[Measurements, np.ndarray]:
    """Return the measurements of a survey of square shape, and a start near the truth (n, 4, 4)."""
    rng = np.random.default_rng(seed)
    legs = round(float(np.sqrt(count * ALONG / ASIDE)))
    leg, place = np.divmod(np.arange(count), -(-count // legs))
    place = np.where(leg % 2, place.max() - place, place)
    w_T_b = np.tile(np.eye(4), (count, 1, 1))
    tilt = rng.normal(0, 0.03, (count, 3)) * [1.0, 1.0, 0.0] + np.outer(leg % 2, [0.0, 0.0, np.pi])
    w_T_b[:, :3, :3] = Rotation.from_euler("xyz", tilt).as_matrix()
    w_T_b[:, :3, 3] = HEIGHT_M * np.column_stack(
        [ALONG * place, ASIDE * leg, 1 + 0.08 * np.sin(np.arange(count))]
    )
    angles = Rotation.from_matrix(w_T_b[:, :3, :3]).as_euler("ZYX")[:, ::-1]
    angles = angles + rng.normal(0, TILT_STD_RAD, angles.shape)
    slant = w_T_b[:, 2, 3] / w_T_b[:, 2, 2] + rng.normal(0, RANGE_STD_M, count)
    measured = Measurements(
        np.arange(count) * 1.0,
        attitudes=tuple(Attitude(k, a, np.full(3, TILT_STD_RAD)) for k, a in enumerate(angles)),
        ranges=tuple(SlantRange(k, float(r), RANGE_STD_M) for k, r in enumerate(slant)),
        tracks=_tracks(w_T_b @ CAMERA.b_T_c, rng),
        camera=CAMERA,
    )
    off = np.hstack([rng.normal(0, 0.005, (count, 3)), rng.normal(0, 0.01 * HEIGHT_M, (count, 3))])
    off[0] = 0.0
    return measured, w_T_b @ se3.exp(off)


def _tracks(w_T_c: np.ndarray, rng: np.random.Generator) -> FloorTracks:
    """Return the observations of points that are spread evenly over the floor."""
    centre, focal = np.array(CAMERA.center_px), np.array(CAMERA.focal_px)
    view_m = SIZE_PX * HEIGHT_M / focal
    low, high = w_T_c[:, :2, 3].min(axis=0) - view_m, w_T_c[:, :2, 3].max(axis=0) + view_m
    count = int(POINTS_IN_VIEW * np.prod(high - low) / np.prod(view_m))
    point = np.column_stack([rng.uniform(low, high, (count, 2)), np.zeros(count)])
    near = cKDTree(point[:, :2]).query_ball_point(w_T_c[:, :2, 3], float(np.linalg.norm(view_m)))
    keyframe, track, pixel = [], [], []
    for k, candidates in enumerate(near):
        c_p = (point[candidates] - w_T_c[k, :3, 3]) @ w_T_c[k, :3, :3]
        seen = c_p[:, :2] / c_p[:, 2:] * focal + centre
        inside = ((seen > 0) & (seen < SIZE_PX)).all(axis=1)
        pixel.append(seen[inside] + rng.normal(0, PIXEL_STD, (inside.sum(), 2)))
        track.append(np.array(candidates)[inside])
        keyframe.append(np.full(inside.sum(), k))
    which = np.concatenate(track)
    shared = np.bincount(which)[which] >= 2
    number = np.unique(which[shared], return_inverse=True)[1]
    told = np.full(int(shared.sum()), PIXEL_STD)
    return FloorTracks(np.concatenate(keyframe)[shared], number, np.concatenate(pixel)[shared], told)
