"""The pose graph of one flight: relative poses, attitudes and heights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from backend.measurements import Attitude, Measurements, SlantRange
from backend.pose_graph.edge_noise import typical_variance
from backend.pose_graph.solution import Solution
from backend.pose_graph.solve import solve
from slam.core.heap import trim_heap
from slam.core.units import unit
from slam.io.down_looking import LEAST_FALL
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.lift_edges import LEAST_HEIGHT_STD, Edges
from slam.mapping.setup import Setup


def solve_pose_graph(
    edges: Edges,
    setup: Setup,
    on_step: Callable[[int, float], None] | None = None,
    covariances: bool = False,
) -> Solution:
    """Solve for all keyframes that edges connect. Raises ``BackendError`` for a graph that is not finite."""
    trim_heap()  # what lifting all pairs has left
    measurements, plain = graph_measurements(edges, setup, on_step)
    if not edges.relative_poses:
        return plain
    return solve(measurements, initial=plain.w_T_b, covariances=covariances, on_step=on_step)


def graph_measurements(
    edges: Edges, setup: Setup, on_step: Callable[[int, float], None] | None = None
) -> tuple[Measurements, Solution]:
    """Return the measurements of the pose graph, and their fit without rejection.

    A common tilt error makes all edges disagree slightly, and so does the compression of a video, which moves
    neighbouring features alike. That is no reason to reject an edge: the covariances of all edges grow by as
    much as a typical one is off.
    """
    measurements = _stated_measurements(edges, setup)
    plain = solve(measurements, loops_robust=False, covariances=False, on_step=on_step)
    if not edges.relative_poses:
        return measurements, plain
    typical = typical_variance(measurements, plain)
    if typical > 1.0:
        widened = (replace(r, covariance=typical * r.covariance) for r in edges.relative_poses)
        measurements = replace(measurements, relative_poses=tuple(widened))
    return measurements, plain


def _stated_measurements(edges: Edges, setup: Setup) -> Measurements:
    """Return the edges, the tilts, and the heights that scale the edges, with their stated covariances."""
    readings, heights = setup.readings, edges.heights
    tied = sorted({k for r in edges.relative_poses for k in (r.i, r.j)})
    attitudes, ranges = [], []
    for k in tied:
        attitudes.append(tilt_of(readings, k, k))
        fall = max(LEAST_FALL, float(np.cos(readings.roll_pitch_rad[k]).prod()))
        height = float(heights.height_m[k])
        ranges.append(SlantRange(k, height / fall, height * max(LEAST_HEIGHT_STD, float(heights.log_std[k]))))
    return Measurements(
        stamps_s=readings.stamps_s,
        relative_poses=edges.relative_poses,
        attitudes=tuple(attitudes),
        ranges=tuple(ranges),
        names=readings.names,
        length_unit=unit(bool(heights.metric[tied].all())),
    )


def tilt_of(readings: KeyframeReadings, k: int, number: int) -> Attitude:
    """Return roll and pitch of keyframe ``k`` as a measurement of pose ``number``, without the heading."""
    angles = np.append(readings.roll_pitch_rad[k], 0.0)
    return Attitude(number, angles, np.append(readings.roll_pitch_std_rad[k], np.inf))
