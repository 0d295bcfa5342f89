"""Elimination order of a graph's variables: it determines time, memory and recursion depth."""

from __future__ import annotations

from typing import Any

import gtsam

DEEP_GRAPH = 10_000
"""Number of keys above which nested dissection is used: COLAMD's tree of a long chain is as deep as the
chain, and gtsam recurses down it (a stack of 512 KB overflows at 10 000 poses, one of 8 MB at 100 000)."""

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
