"""Graduated non-convexity: robust selection of inliers where all edges are trusted alike."""

from __future__ import annotations

import math
import time

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.chi_square import chi_square_gate
from backend.pose_graph.descent import OnStep
from backend.pose_graph.elimination import set_ordering
from backend.pose_graph.problem import Problem

Array = NDArray[np.float64]

_MU_GROWTH = 1.4
_MAX_STEPS = 200


def gnc_inliers(
    problem: Problem,
    anchors: gtsam.NonlinearFactorGraph,
    w_T: Array,
    candidate: NDArray[np.bool_],
    on_step: OnStep | None = None,
    deadline: float = math.inf,
) -> tuple[NDArray[np.bool_], Array]:
    """Select inliers among the candidate edges by graduated non-convexity with truncated least squares.

    The loss starts convex, with all edges, and becomes truncated in stages. Two damped steps per stage
    suffice since each starts from the last result. Returns (m,) kept and the final poses.
    Source: Yang, Antonante, Tzoumas, Carlone 2020 (RA-L), equations 12 to 14.
    """
    c2 = chi_square_gate(problem.dof)
    trusted_factors = problem.with_edges(~candidate).edge_factors()
    trusted_factors.push_back(anchors)
    loops = problem.with_edges(candidate)
    r2 = (loops.residuals(w_T) ** 2).sum(axis=1)
    if len(r2) == 0 or r2.max() <= c2:
        return np.ones(len(problem.i), dtype=bool), w_T
    mu = c2 / (2 * r2.max() - c2)
    weight = np.ones(len(r2))
    for step in range(_MAX_STEPS):
        w_T = _step(problem, trusted_factors, loops, weight, w_T)
        r2 = (loops.residuals(w_T) ** 2).sum(axis=1)
        weight = _weights(r2, c2, mu)
        if on_step is not None:
            on_step(step, float(np.minimum(r2, c2).sum() / 2))
        if (((weight == 0) | (weight == 1)).all() and mu > 1) or time.monotonic() > deadline:
            break
        mu *= _MU_GROWTH
    kept = ~candidate
    kept[candidate] = weight > 0.5
    return kept, w_T


def _weights(r2: Array, c2: float, mu: float) -> Array:
    """Equation 14 of the source."""
    middle = np.sqrt(c2 * mu * (mu + 1) / np.maximum(r2, 1e-300)) - mu
    weight = np.where(r2 <= c2 * mu / (mu + 1), 1.0, np.where(r2 >= c2 * (mu + 1) / mu, 0.0, middle))
    return np.clip(weight, 0, 1)


def _step(
    problem: Problem, trusted_factors: gtsam.NonlinearFactorGraph, loops: Problem, weight: Array, w_T: Array
) -> Array:
    graph = loops.edge_factors(np.where(weight > 1e-8, weight, 0))
    graph.push_back(trusted_factors)
    params = gtsam.LevenbergMarquardtParams()
    set_ordering(params, graph, problem.count)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, problem.values(w_T), params)
    for _ in range(2):
        optimizer.iterate()
    return problem.poses(gtsam.Values(optimizer.values()))
