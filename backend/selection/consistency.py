"""Do all edges fit together, and which of them do not, where none is trusted more than another."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from backend import se3
from backend.elimination import set_ordering
from backend.problem import Problem
from backend.solve import OnStep

Array = NDArray[np.float64]

CONFIDENCE = 0.999
"""Of the global test, and of the limit for one edge."""

_GROWTH = 1.4
_STEPS = 200


@dataclass(frozen=True)
class ChiSquare:
    """Sum of the squared whitened residuals of the edges against what chance allows."""

    statistic: float
    freedom: int
    limit: float

    @property
    def passed(self) -> bool:
        """Whether chance explains the sum."""
        return self.statistic <= self.limit


def chi_square(problem: Problem, statistic: float) -> ChiSquare:
    """Test whether the edges agree with each other and with the absolute measurements.

    ``statistic`` is the sum of the edges' squared whitened residuals. The freedom is that of the edges'
    loops, plus what absolute measurements may ask of them.
    """
    d = problem.freedom
    tree = d * (problem.count - 1)
    rows = sum(absolute.plain.dim() for absolute in problem.absolutes)
    freedom = d * len(problem.i) - tree + min(rows, tree)
    # A tree of edges always fits: its residuals are rounding.
    return ChiSquare(statistic, freedom, float(chi2.ppf(CONFIDENCE, freedom)) if freedom > 0 else np.inf)


def edge_limit(problem: Problem) -> float:
    """Whitened norm that a true edge exceeds once in a thousand."""
    return float(np.sqrt(chi2.ppf(CONFIDENCE, problem.freedom)))


def agreeing_edges(
    problem: Problem,
    anchors: gtsam.NonlinearFactorGraph,
    w_T: Array,
    candidate: NDArray[np.bool_],
    on_step: OnStep | None = None,
    deadline: float = math.inf,
) -> tuple[NDArray[np.bool_], Array]:
    """Graduated non-convexity with truncated least squares over the candidate edges.

    Starts from the convex problem in which all count and lets the loss become truncated step by step; one
    damped step a stage suffices since each starts where the last ended. Returns (m,) kept and the poses it
    ended at. Source: Yang, Antonante, Tzoumas, Carlone 2020 (RA-L), equations 12 to 14.
    """
    c2 = edge_limit(problem) ** 2
    sure = problem.with_edges(~candidate).edge_factors()
    sure.push_back(anchors)
    loops = problem.with_edges(candidate)
    r2 = (loops.residuals(w_T) ** 2).sum(axis=1)
    if len(r2) == 0 or r2.max() <= c2:
        return np.ones(len(problem.i), dtype=bool), w_T
    mu = c2 / max(2 * r2.max() - c2, c2)
    weight = np.ones(len(r2))
    for step in range(_STEPS):
        w_T = _step(problem, sure, loops, weight, w_T)
        r2 = (loops.residuals(w_T) ** 2).sum(axis=1)
        weight = _weights(r2, c2, mu)
        if on_step is not None:
            on_step(step, float(np.minimum(r2, c2).sum() / 2))
        if (((weight == 0) | (weight == 1)).all() and mu > 1) or time.monotonic() > deadline:
            break
        mu *= _GROWTH
    kept = ~candidate
    kept[candidate] = weight > 0.5
    return kept, w_T


def _weights(r2: Array, c2: float, mu: float) -> Array:
    """Equation 14 of the source."""
    middle = np.sqrt(c2 * mu * (mu + 1) / np.maximum(r2, 1e-300)) - mu
    weight = np.where(r2 <= c2 * mu / (mu + 1), 1.0, np.where(r2 >= c2 * (mu + 1) / mu, 0.0, middle))
    return np.clip(weight, 0, 1)


def _step(
    problem: Problem, sure: gtsam.NonlinearFactorGraph, loops: Problem, weight: Array, w_T: Array
) -> Array:
    graph = loops.edge_factors(np.where(weight > 1e-8, weight, 0))
    graph.push_back(sure)
    params = gtsam.LevenbergMarquardtParams()
    set_ordering(params, graph, problem.count)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, problem.values(w_T), params)
    for _ in range(2):
        optimizer.iterate()
    return problem.poses(gtsam.Values(optimizer.values()))


def reason(problem: Problem, edge: int, w_T: Array, sigma: float) -> str:
    """Why an edge was rejected: ``disagrees by 7.3 sigma (limit 4.1): 1.2 m, 14 deg``."""
    i, j = problem.i[edge], problem.j[edge]
    off = se3.log((se3.inverse(problem.ij_T[edge]) @ se3.inverse(w_T[i]) @ w_T[j])[None])[0]
    meters, degrees = np.linalg.norm(off[3:]), np.degrees(np.linalg.norm(off[:3]))
    limit = edge_limit(problem)
    if sigma <= limit:
        return f"agrees to {sigma:.1f} sigma, but the rest tells too little of where it lies to trust it"
    return f"disagrees by {sigma:.1f} sigma (limit {limit:.1f}): {meters:.2g} m, {degrees:.2g} deg"
