"""Find the loop that covariances hide, and the step of odometry that a selection puts in doubt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.chains import chain_members
from backend.pose_graph.selection.swap_search import removal_gains

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_SUSPECTS = 100
"""Loops of the largest residuals that are examined one by one."""


def suspected_loops(problem: Problem, residual: Array) -> Index:
    """Return the loops of the largest residuals, at most 100; ``residual`` (m, d) is that of a fit."""
    loops = np.flatnonzero(~problem.trusted)
    return np.sort(loops[np.argsort(-(residual[loops] ** 2).sum(axis=1))][:_SUSPECTS])


def has_dominant_loop(residual: Array, loops: Index, predictions: Array) -> bool:
    """Return whether the removal of one loop would halve the chi-square of the fit of all edges.

    Where covariances are stated far too large, the chi-square test passes with a false loop in the graph.
    ``residual`` (m, d) is that of all edges, ``predictions`` (k, d, d) the whitened covariance of each of the
    ``loops`` (k,) by the fit.
    """
    known = np.isfinite(predictions).all(axis=(1, 2))
    decrease = removal_gains(residual[loops[known]], predictions[known])
    return bool(decrease.max(initial=0.0) > (residual**2).sum() / 2)


def doubtful_odometry(problem: Problem, kept: Mask) -> int | None:
    """Return the trusted edge that more rejected loops span than kept ones, by the largest margin.

    ``kept`` is (m,). One wrong step of odometry makes all true loops over it disagree, and none beside it.
    None if at each step the kept loops are as many as the rejected ones.
    """
    chain = np.empty(problem.count, dtype=np.int64)
    for number, members in enumerate(chain_members(problem)):
        chain[members] = number
    low, high = np.minimum(problem.i, problem.j), np.maximum(problem.i, problem.j)
    loops = ~problem.trusted & (chain[low] == chain[high])
    margin = np.zeros(problem.count + 1, dtype=np.int64)
    vote = np.where(kept, -1, 1)[loops]
    np.add.at(margin, low[loops], vote)
    np.add.at(margin, high[loops], -vote)
    over = np.cumsum(margin)
    steps = np.flatnonzero(problem.trusted & kept & (high - low == 1))
    if len(steps) == 0 or over[low[steps]].max() <= 0:
        return None
    return int(steps[np.argmax(over[low[steps]])])
