"""Incremental estimation over 5000 keyframes with 250 loops: time per keyframe, and the batch's result."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from backend.pose_graph.incremental.estimation import BUDGET_S, Incremental
from backend.pose_graph.solve import solve
from tests.backend.synthetic import flight
from tests.benchmarks.metric import Metric, at_most, reported

KEYFRAMES, LOOPS, SEED = 5000, 250, 1
MAX_OFF = 0.01


@dataclass(frozen=True)
class Run:
    """Result of one flight, added keyframe by keyframe."""

    seconds: np.ndarray
    """(n,) time for each keyframe."""
    waited: int
    """Largest number of queued loops."""
    rebuilds: int
    off: float
    """Relative difference of the final error to the batch's."""
    moved_m: float
    """RMS change of positions by the final solve: the error of the incremental estimate."""


def measure() -> list[Metric]:
    """Measure time and error."""
    run = flown(KEYFRAMES, LOOPS, SEED)
    slowest = f"median {1e3 * np.median(run.seconds):.2f} ms, longest {1e3 * run.seconds.max():.0f} ms"
    percentile = float(np.percentile(run.seconds, 99))
    return [
        at_most("time for a keyframe, 99th percentile", 1e3 * percentile, "ms", 1e3 * BUDGET_S, slowest),
        at_most("final error: relative difference to the batch's", run.off, "", MAX_OFF),
        reported(
            "in flight against the final answer, RMS", run.moved_m, "m", f"{run.waited} loops waited at most"
        ),
        reported("built anew", run.rebuilds, ""),
    ]


def flown(keyframes: int, loops: int, seed: int) -> Run:
    """Simulate two rounds of a figure eight; all loops are in the second."""
    measured = flight(seed, n=keyframes, loops=loops).measurements
    edges: list[list] = [[] for _ in range(keyframes)]
    for edge in measured.relative_poses:
        edges[max(edge.i, edge.j)].append(edge)
    live, seconds, steps = Incremental(), [], []
    for k in range(keyframes):
        begin = time.perf_counter()
        steps.append(live.add(tuple(edges[k]), (measured.attitudes[k],), (measured.ranges[k],)))
        seconds.append(time.perf_counter() - begin)
    before = live.trajectory()[:, :3, 3]
    live.settle()
    batch = solve(measured, covariances=False, loops_robust=False)
    moved = live.trajectory()[:, :3, 3] - before
    return Run(
        seconds=np.array(seconds),
        waited=max(step.pending for step in steps),
        rebuilds=sum(step.rebuild_reason != "" for step in steps),
        off=abs(live.error() - batch.error) / batch.error,
        moved_m=float(np.sqrt((moved**2).sum(axis=1).mean())),
    )
