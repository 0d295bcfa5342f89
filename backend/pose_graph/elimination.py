"""In which order the variables of a graph are eliminated: it decides on time, memory and depth."""

from __future__ import annotations

from typing import Any

import gtsam

DEEP_GRAPH = 10_000
"""Keys from which nested dissection orders the elimination: COLAMD's tree of a long chain is as deep as the
chain, and gtsam recurses down it (a thread with a stack of 512 KB dies at 10 000 poses, one of 8 MB at
100 000)."""

Graph = gtsam.NonlinearFactorGraph | gtsam.GaussianFactorGraph


def set_ordering(
    params: gtsam.NonlinearOptimizerParams,
    graph: gtsam.NonlinearFactorGraph,
    keys: int,
    common: int | None = None,
) -> None:
    """Tell an optimizer how to eliminate a graph of so many variables.

    Where next to all of them share a ``common`` one COLAMD fills in three times as much.
    """
    if common is not None or keys > DEEP_GRAPH:
        params.setOrdering(nested_dissection(graph, common))
    else:
        params.setOrderingType("COLAMD")


def nested_dissection(graph: Graph, last: int | None = None) -> gtsam.Ordering:
    """METIS' ordering, a shallow tree; one variable can be put ``last``.

    A variable without neighbours, such as a floor point that nobody sees any more, comes first: METIS itself
    would write past its memory and end the interpreter.
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
    if last is not None:
        order = [key for key in order if key != last] + [last]
    ordering = gtsam.Ordering()
    for key in order:
        ordering.push_back(key)
    return ordering
