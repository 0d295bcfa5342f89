"""Factors of the measurements of one new keyframe, on the keys of a growing graph."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from backend.gauge import gauge_prior, unobserved_directions
from backend.measurements import Measurements
from backend.pose_graph.from_measurements import from_measurements
from backend.pose_graph.problem import Problem
from backend.pose_graph.unary_factors import aligned, jacobian

Array = NDArray[np.float64]

_WEAK_STD = 30.0
"""Standard deviation, in rad and m, of a gauge prior that yields to any measurement."""


def renumbered(measured: Measurements, number: int) -> tuple[Problem, list[int]]:
    """Return the new measurements as a problem of few poses, and their keys. Raises ``BackendError``."""
    owners = [
        single.k for kind in (measured.attitudes, measured.ranges, measured.positions) for single in kind
    ]
    if any(k != number for k in owners):
        raise BackendError(f"a measurement is not of the newest keyframe, {number}")
    keys = sorted({number, *(k for e in measured.relative_poses for k in (e.i, e.j))})
    if keys[0] < 0:
        raise BackendError(f"a relative pose names keyframe {keys[0]}")
    # The times do not matter here.
    local = replace(measured, stamps_s=np.zeros(number + 1)).of_keyframes(keys)
    local = replace(local, names=tuple(str(key) for key in keys))
    return from_measurements(local, None)[0], keys


def edge_factors(problem: Problem, keys: list[int]) -> list[gtsam.NonlinearFactor]:
    """Return the factor of each relative pose of a problem whose poses have other ``keys``."""
    return [factor.rekey([keys[k] for k in list(factor.keys())]) for factor in problem.single_factors()]


def rekeyed(factors: gtsam.NonlinearFactorGraph, keys: list[int]) -> gtsam.NonlinearFactorGraph:
    """Return factors whose keys are the places of their own in ``keys``."""
    out = gtsam.NonlinearFactorGraph()
    for factor in (factors.at(k) for k in range(factors.size())):
        out.push_back(factor.rekey([keys[k] for k in list(factor.keys())]))
    return out


def joined(
    edges: list[gtsam.NonlinearFactor], *more: gtsam.NonlinearFactorGraph
) -> gtsam.NonlinearFactorGraph:
    """Return one graph of factors and graphs."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in edges:
        graph.push_back(factor)
    for each in more:
        graph.push_back(each)
    return graph


def first_pose(problem: Problem, w_T_b: Array | None) -> Array:
    """Return the initial pose (4, 4) of the first keyframe: the given one, or one by its measurements."""
    if w_T_b is not None:
        if w_T_b.shape != (4, 4) or not np.isfinite(w_T_b).all():
            raise BackendError("the pose of the first keyframe is not a finite (4, 4) transform")
        return w_T_b
    return np.asarray(aligned(np.eye(4)[None], problem.unary_factors)[0])


def first_gauge(problem: Problem, start: Array) -> gtsam.NonlinearFactorGraph:
    """Return a prior on the directions that the first keyframe's measurements do not observe.

    The prior is weak, since later measurements may observe them; it is tight if the first keyframe measures
    nothing, since the trajectory is then relative to it.
    """
    out = gtsam.NonlinearFactorGraph()
    if not problem.unary_factors:
        out.push_back(gauge_prior(0, start, np.eye(6)))
        return out
    directions = unobserved_directions([jacobian(a, start, start[:3, 3]) for a in problem.unary_factors])
    if len(directions):
        out.push_back(gauge_prior(0, start, directions, _WEAK_STD))
    return out
