"""A flight's pose graph solved keyframe by keyframe, as on board, and compared with the batch."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.measurements import Attitude, Measurements, RelativePose, SlantRange
from backend.pose_graph.incremental import BUDGET_S, Incremental
from backend.pose_graph.solve import solve
from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import Observations
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.lift_edges import lift_edges
from slam.mapping.setup import Setup
from slam.mapping.solve_pose_graph import graph_measurements

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KeyframeByKeyframe:
    """Comparison of the incremental back end with the batch on one pose graph."""

    seconds: Array
    """(n,) time to add each keyframe, in the order in which they were added."""
    loops: int
    rejected_in_flight: int
    """Edges that were rejected when the last keyframe had been added."""
    rejected_by_batch: int
    waiting: int
    """Loops that were still queued then, since an update had exceeded its budget."""
    when_added: float
    """RMS distance between the position of each keyframe when it was added and that of the batch."""
    in_flight: float
    """The same when the last keyframe had been added."""
    settled: float
    """The same after the final solve."""
    length_unit: str


def keyframe_by_keyframe(
    flight: Flight, observations: Observations, config: PipelineConfig, progress: Progress = silent
) -> KeyframeByKeyframe:
    """Replay the pose graph of a mapped flight, of which ``optimize_with_observations`` gives the
    observations.

    The heights are those of the recording: echoes of obstacles, which the map takes out, are among them.
    """
    assert flight.camera is not None
    readings = KeyframeReadings.at(flight, observations.stamps_s, flight.geo_origin(), config)
    setup = Setup(flight.camera, readings, config)
    measured, _ = graph_measurements(lift_edges(observations.registrations, setup), setup)
    return replay(measured, progress)


def replay(
    measured: Measurements, progress: Progress = silent, budget_s: float = BUDGET_S
) -> KeyframeByKeyframe:
    """Add the keyframes that edges join to the first; one without an edge to an earlier one waits for it.

    Raises ``BackendError`` for measurements that cannot be solved.
    """
    order = list(_order(measured))
    part = measured.of_keyframes(order)
    batch = solve(part, covariances=False)
    newest: list[list[RelativePose]] = [[] for _ in order]
    for edge in part.relative_poses:
        newest[max(edge.i, edge.j)].append(edge)
    attitudes: list[list[Attitude]] = [[] for _ in order]
    for attitude in part.attitudes:
        attitudes[attitude.k].append(attitude)
    ranges: list[list[SlantRange]] = [[] for _ in order]
    for slant in part.ranges:
        ranges[slant.k].append(slant)
    waiting = 0
    live, seconds, added = Incremental(budget_s), np.zeros(len(order)), np.empty((len(order), 4, 4))
    for k, edges in enumerate(newest):
        progress("keyframes", k, len(order))
        begin = time.perf_counter()
        update = live.add(tuple(edges), tuple(attitudes[k]), tuple(ranges[k]))
        seconds[k] = time.perf_counter() - begin
        waiting = update.pending
        # Relative to the first keyframe: its pose may change with each new one.
        added[k] = se3.inverse(live.pose(0)) @ update.w_T_b
    in_flight, rejected = live.trajectory(), len(live.rejected)
    live.settle()
    return KeyframeByKeyframe(
        seconds=seconds,
        loops=sum(e.kind == "loop" for e in part.relative_poses),
        rejected_in_flight=rejected,
        rejected_by_batch=int(np.count_nonzero(~batch.edge_kept)),
        waiting=waiting,
        when_added=_apart(added, batch.w_T_b),
        in_flight=_apart(in_flight, batch.w_T_b),
        settled=_apart(live.trajectory(), batch.w_T_b),
        length_unit=measured.length_unit,
    )


def _order(measured: Measurements) -> Iterator[int]:
    """Yield the keyframes in order of time, each once an edge joins it to the first or an earlier one.

    They begin with the first keyframe that has an edge.
    """
    beside: list[list[int]] = [[] for _ in measured.stamps_s]
    for edge in measured.relative_poses:
        beside[edge.i].append(edge.j)
        beside[edge.j].append(edge.i)
    placed: set[int] = set()
    for k, others in enumerate(beside):
        if others and (not placed or placed.intersection(others)):
            waiting = [k]
            while waiting:
                now = waiting.pop(0)
                if now not in placed:
                    placed.add(now)
                    yield now
                    waiting += sorted(other for other in beside[now] if other < k)


def _apart(w_T: Array, other: Array) -> float:
    """Return the RMS distance of the positions relative to the first pose."""
    first, second = (se3.inverse(T[0]) @ T for T in (w_T, other))
    return float(np.sqrt(((first - second)[:, :3, 3] ** 2).sum(axis=1).mean()))
