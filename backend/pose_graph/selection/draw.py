"""Loops drawn by lot, from which the selection of a dense graph starts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import MAX_HYPOTHESES
from backend.pose_graph.selection.places import ROW_LENGTH, place_pairs

Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_LOOPS_PER_POSE = 3
"""Drawn loops per pose. Published graphs have fewer (parking-garage 2.8), so all of theirs are used; with
half of them false, each pose still has three ends of true ones."""
_LEAST_DRAWN = 5 * MAX_HYPOTHESES
"""Smallest number of loops that is worth a draw: fewer are accepted within some ten rounds of the growth."""


def draw_loops(problem: Problem, seed: int) -> Mask:
    """Return (m,) odometry and enough loops to place all poses; True for all edges if there are not more.

    Each pair of places gives its first loop before any gives its second, so that no region and no robot is
    left out. The loops that are not drawn are judged later against the solution from these.
    """
    drawn, loops = np.ones_like(problem.trusted), np.flatnonzero(~problem.trusted)
    count = max(_LOOPS_PER_POSE * problem.count, _LEAST_DRAWN)
    if len(loops) <= count:
        return drawn
    loops = np.random.default_rng(seed).permutation(loops)
    place = place_pairs(problem.i[loops], problem.j[loops], ROW_LENGTH)
    drawn[loops[np.argsort(_turns(place), kind="stable")[count:]]] = False
    return drawn if _is_connected(problem, drawn) else np.ones_like(drawn)


def _turns(label: Index) -> Index:
    """Return (k,) how many of the same label come before each."""
    order = np.argsort(label, kind="stable")
    length = np.bincount(label)
    turn = np.empty_like(order)
    turn[order] = np.arange(len(label)) - np.repeat(np.cumsum(length) - length, length)
    return turn


def _is_connected(problem: Problem, which: Mask) -> bool:
    ends = problem.i[which], problem.j[which]
    links = coo_array((np.ones(len(ends[0])), ends), shape=(problem.count, problem.count))
    return bool(connected_components(links, directed=False)[0] == 1)
