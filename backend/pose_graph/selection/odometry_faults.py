"""Find the edge of odometry that a selection of loops puts in doubt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.chains import chain_members

Mask = NDArray[np.bool_]


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
