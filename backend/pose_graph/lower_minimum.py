"""A lower minimum of a solved pose graph, by damped descents from other starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.errors import BackendError
from backend.pose_graph.checks.solved_parts import gauge_fixed_part
from backend.pose_graph.gauge_fixed_problem import damped_fit, initial_poses
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.solution import Solution

Array = NDArray[np.float64]

_LOWER = 1e-3
"""Relative decrease of the error that is another minimum, and not a descent that stopped earlier."""


def lower_minimum(graph: PoseGraph, solution: Solution) -> Array | None:
    """Return poses (n, 4, 4) of a lower error for the kept edges; None if no other start leads there.

    The starts are the poses of the file and a tree of the edges that prefers odometry. Only graphs of one
    part are tried.
    """
    if solution.component.any():
        return None
    problem = from_pose_graph(graph).with_edges(solution.edge_kept)
    gauge_fixed = gauge_fixed_part(problem, solution.w_T_b)
    anchor = int(np.argmax(graph.fixed))
    lowest = solution.error * (1 - _LOWER)
    w_T: Array | None = None
    by_odometry = initial_poses(replace(problem, initial=np.full_like(graph.poses, np.nan)))
    for start in (by_odometry, graph.poses):
        if not np.isfinite(start).all():
            continue
        placed = solution.w_T_b[anchor] @ se3.inverse(start[anchor]) @ start
        try:
            fit = damped_fit(gauge_fixed, placed)
        except BackendError:
            continue
        if fit.minimum.error < lowest:
            lowest, w_T = fit.minimum.error, fit.w_T
    return None if w_T is None else np.where(graph.fixed[:, None, None], graph.poses, w_T)
