"""Elimination order of a graph's variables: it determines time, memory and recursion depth."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

DEEP_GRAPH = 10_000
"""Number of keys above which nested dissection is used: COLAMD's tree of a long chain is as deep as the
chain, and gtsam recurses down it (a stack of 512 KB overflows at 10 000 poses, one of 8 MB at 100 000)."""

Index = NDArray[np.int64]
Graph = gtsam.NonlinearFactorGraph | gtsam.GaussianFactorGraph


def set_ordering(
    params: gtsam.NonlinearOptimizerParams, graph: gtsam.NonlinearFactorGraph, keys: int
) -> None:
    """Set an optimizer's elimination order for a graph of ``keys`` variables."""
    if keys > DEEP_GRAPH:
        params.setOrdering(nested_dissection(graph))
    else:
        params.setOrderingType("COLAMD")


def nested_dissection(graph: Graph) -> gtsam.Ordering:
    """Return METIS' ordering, a shallow tree.

    A variable without neighbours comes first: METIS itself would write out of bounds and abort the
    interpreter.
    """
    linear = isinstance(graph, gtsam.GaussianFactorGraph)
    tied: Any = gtsam.GaussianFactorGraph() if linear else gtsam.NonlinearFactorGraph()
    every: set[int] = set()
    joined: set[int] = set()
    for factor in filter(None, (graph.at(k) for k in range(graph.size()))):
        keys = factor.keys()
        every.update(keys)
        if len(keys) > 1:
            tied.push_back(factor)
            joined.update(keys)
    order = sorted(every - joined)
    if joined:
        of_kind = (
            gtsam.Ordering.MetisGaussianFactorGraph if linear else gtsam.Ordering.MetisNonlinearFactorGraph
        )
        dissected = of_kind(tied)
        order += [dissected.at(k) for k in range(dissected.size())]
    ordering = gtsam.Ordering()
    for key in order:
        ordering.push_back(key)
    return ordering


def elimination_exceeds(operations: float, n: int, i: Index, j: Index, d: int) -> bool:
    """Return whether the elimination of n poses of ``d`` dimensions needs more floating-point operations.

    ``i`` and ``j`` (m,) are the ends of the edges. A cheap upper bound decides first; only above it the exact
    count is taken.
    """
    return _cuthill_mckee_bound(n, i, j, d) > operations and _colamd_operations(i, j, d) > operations


def _cuthill_mckee_bound(n: int, i: Index, j: Index, d: int) -> float:
    """Return the operations of an elimination within the envelope of the Cuthill-McKee order."""
    links = csr_array((np.ones(2 * len(i)), (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(n, n))
    place = np.empty(n, dtype=np.int64)
    place[reverse_cuthill_mckee(links, symmetric_mode=True)] = np.arange(n)
    first = np.arange(n)
    np.minimum.at(first, np.maximum(place[i], place[j]), np.minimum(place[i], place[j]))
    width = (1 + np.arange(n) - first) * float(d)
    return float((width**2).sum() * d)


def colamd_order(i: Index, j: Index) -> Index:
    """Return the poses that some edges (m,) join in COLAMD's order of elimination."""
    order = gtsam.Ordering.ColamdSymbolicFactorGraph(_symbolic(i, j))
    return np.array([order.at(k) for k in range(order.size())], dtype=np.int64)


def _colamd_operations(i: Index, j: Index, d: int) -> float:
    """Return the operations of an elimination in COLAMD's order, counted on its symbolic factor."""
    graph = _symbolic(i, j)
    factor = graph.eliminateSequential(gtsam.Ordering.ColamdSymbolicFactorGraph(graph))
    width = d * np.array([1 + factor.at(k).nrParents() for k in range(factor.size())])
    return float((width.astype(np.float64) ** 2).sum() * d)


def _symbolic(i: Index, j: Index) -> gtsam.SymbolicFactorGraph:
    graph = gtsam.SymbolicFactorGraph()
    for a, b in zip(i.tolist(), j.tolist(), strict=True):
        graph.push_factor(a, b)
    return graph
