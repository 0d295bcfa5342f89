"""A flight's pose graph solved keyframe by keyframe, as on board, and compared with the batch."""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.measurements import Attitude, Measurements, RelativePose, SlantRange
from backend.pose_graph.incremental.estimation import BUDGET_S, Incremental
from backend.pose_graph.solve import solve
from backend.preintegration.intervals import InertialInterval, preintegrate
from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import Observations
from slam.mapping.inertial.measurements import inertial_measurements
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
    bridged: int = 0
    """Keyframes that readings of the IMU alone join to earlier ones."""


def keyframe_by_keyframe(
    flight: Flight, observations: Observations, config: PipelineConfig, progress: Progress = silent
) -> KeyframeByKeyframe:
    """Replay the pose graph of a mapped flight, of which ``optimize_with_observations`` gives the
    observations.

    The heights are those of the recording: echoes of obstacles, which the map takes out, are among them. In
    metres, the readings of the IMU between keyframes take part, and join those that no picture joins.
    """
    assert flight.camera is not None
    readings = KeyframeReadings.at(flight, observations.stamps_s, flight.geo_origin(), config)
    setup = Setup(flight.camera, readings, config)
    measured, _ = graph_measurements(lift_edges(observations.registrations, setup), setup)
    if measured.length_unit == "m":
        measured = replace(measured, inertial=inertial_measurements(flight.imu, config))
    return replay(measured, progress)


def replay(
    measured: Measurements, progress: Progress = silent, budget_s: float = BUDGET_S
) -> KeyframeByKeyframe:
    """Add the keyframes that edges or inertial readings join to the first; one that nothing joins to an
    earlier one waits for an edge.

    In the batch, relative poses take the place of the readings that alone join two keyframes. Raises
    ``BackendError`` for measurements that cannot be solved.
    """
    flown = _Replay(measured, budget_s)
    for k in range(measured.count):
        progress("keyframes", k, measured.count)
        waiting = [k] if flown.joins(k) else []
        while waiting:
            now = waiting.pop(0)
            if now not in flown.number:
                flown.add(now)
                waiting += sorted(other for other in flown.beside[now] if other < k)
    live, loops_wait = flown.live, flown.loops_wait
    in_flight, rejected = live.trajectory(), len(live.rejected)
    live.settle()
    part, bridges = measured.of_keyframes(list(flown.number)), live.bridges()
    batch = solve(replace(part, relative_poses=(*part.relative_poses, *bridges)), covariances=False)
    return KeyframeByKeyframe(
        seconds=np.array(flown.seconds),
        loops=sum(e.kind == "loop" for e in part.relative_poses),
        rejected_in_flight=rejected,
        rejected_by_batch=int(np.count_nonzero(~batch.edge_kept)),
        waiting=loops_wait,
        when_added=_apart(np.array(flown.added), batch.w_T_b),
        in_flight=_apart(in_flight, batch.w_T_b),
        settled=_apart(live.trajectory(), batch.w_T_b),
        length_unit=measured.length_unit,
        bridged=len(bridges),
    )


class _Replay:
    """The incremental estimation, and the keyframes that it has."""

    def __init__(self, measured: Measurements, budget_s: float) -> None:
        inertial = measured.inertial
        intervals = preintegrate(inertial, measured.stamps_s, of_body=True) if inertial is not None else ()
        self.live = Incremental(budget_s)
        self.beside: list[list[int]] = [[] for _ in measured.stamps_s]
        """Keyframes to which each has an edge."""
        self._edges: list[list[RelativePose]] = [[] for _ in measured.stamps_s]
        for edge in measured.relative_poses:
            for k, other in ((edge.i, edge.j), (edge.j, edge.i)):
                self.beside[k].append(other)
                self._edges[k].append(edge)
        self._attitudes: dict[int, list[Attitude]] = defaultdict(list)
        for attitude in measured.attitudes:
            self._attitudes[attitude.k].append(attitude)
        self._ranges: dict[int, list[SlantRange]] = defaultdict(list)
        for slant in measured.ranges:
            self._ranges[slant.k].append(slant)
        self._intervals = {one.j: one for one in intervals}
        self.number: dict[int, int] = {}
        """Keyframe -> its number in the estimation, in the order in which they were added."""
        self.seconds: list[float] = []
        self.added: list[Array] = []
        """(4, 4) pose of each relative to the first, when it was added."""
        self.loops_wait = 0
        """Loops that are queued."""

    def joins(self, k: int) -> bool:
        """Return whether an edge, or readings since the keyframe before, join keyframe ``k``."""
        others = self.beside[k]
        if not self.number or not self.number.keys().isdisjoint(others):
            return len(others) > 0
        interval = self._interval(k)
        return interval is not None and self.live.bridges_by(interval)

    def add(self, k: int) -> None:
        """Add keyframe ``k`` with what joins it to those before."""
        number = len(self.number)
        self.number[k] = number
        edges = tuple(
            replace(e, i=self.number[e.i], j=self.number[e.j])
            for e in self._edges[k]
            if e.i in self.number and e.j in self.number
        )
        attitudes = tuple(replace(a, k=number) for a in self._attitudes[k])
        ranges = tuple(replace(r, k=number) for r in self._ranges[k])
        interval = self._interval(k)
        begin = time.perf_counter()
        update = self.live.add(edges, attitudes, ranges, inertial=interval)
        self.seconds.append(time.perf_counter() - begin)
        self.loops_wait = update.pending
        # Relative to the first keyframe: its pose may change with each new one.
        self.added.append(se3.inverse(self.live.pose(0)) @ update.w_T_b)

    def _interval(self, k: int) -> InertialInterval | None:
        """Return the readings since the keyframe before, if that was added."""
        interval = self._intervals.get(k)
        if interval is None or interval.i not in self.number:
            return None
        return replace(interval, i=self.number[interval.i])


def _apart(w_T: Array, other: Array) -> float:
    """Return the RMS distance of the positions relative to the first pose."""
    first, second = (se3.inverse(T[0]) @ T for T in (w_T, other))
    return float(np.sqrt(((first - second)[:, :3, 3] ** 2).sum(axis=1).mean()))
