"""Find the loop that covariances hide, and the step of odometry that a selection puts in doubt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, GraphFit
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.chains import chain_members
from backend.pose_graph.selection.evidence import LinearizedSet
from backend.pose_graph.selection.swap_search import SwapSearch

Mask = NDArray[np.bool_]

_SUSPECTS = 100
"""Loops of the largest residuals that are examined one by one."""


def has_dominant_loop(gauge_fixed: GaugeFixedProblem, fit: GraphFit) -> bool:
    """Return whether the removal of one loop would halve the chi-square of the fit of all edges.

    Where covariances are stated far too large, the chi-square test passes with a false loop in the graph.
    """
    problem = gauge_fixed.problem
    residual = problem.residuals(fit.w_T)
    loops = np.flatnonzero(~problem.trusted)
    loops = np.sort(loops[np.argsort(-(residual[loops] ** 2).sum(axis=1))][:_SUSPECTS])
    volumes = np.zeros(len(problem.i))
    whole = LinearizedSet.of(problem, gauge_fixed.graph, np.ones_like(problem.trusted), fit.w_T, volumes)
    if whole is None or len(loops) == 0:
        return False
    decrease = SwapSearch(whole, loops, residual).chi_square_changes()
    return bool(decrease.max() > whole.chi_square / 2)


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
