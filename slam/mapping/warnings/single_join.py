"""Recognises parts of a map that one pair of pictures alone joins.

After a stretch without features the motion is unknown. A later pair of pictures that look alike may join what
lies before and behind, and where the floor repeats, it may be a wrong one. No other pair contradicts it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.mapping.map import Map

_LEAST_KEYFRAMES = 2
"""Smallest part that counts."""


def single_joins(map_: Map, tied: NDArray[np.int64]) -> list[tuple[int, int, int]]:
    """Return (i, j, count) for each pair of keyframes that alone joins ``count`` ones to others of its part.

    ``tied`` (n,): parts by the links of successive pictures and by the instruments, which confirm the pairs
    within. Links between successive keyframes need no confirmation.
    """
    import networkx as nx  # as late as in `slam.mapping.inertial.bridges`

    graph = nx.Graph()
    for r in map_.kept_registrations:
        if map_.component[r.i] >= 0 and map_.component[r.i] == map_.component[r.j]:
            graph.add_edge(r.i, r.j)
    graph.add_edges_from((edge.i, edge.j) for edge in map_.bridges)
    found = []
    for i, j in nx.bridges(graph):
        if abs(i - j) == 1 or (tied[i] >= 0 and tied[i] == tied[j]):
            continue
        rest = nx.restricted_view(graph, [], [(i, j)])
        behind = len(nx.node_connected_component(rest, j))
        count = min(behind, len(nx.node_connected_component(rest, i)))
        if count >= _LEAST_KEYFRAMES:
            found.append((min(i, j), max(i, j), count))
    return sorted(found)


def single_join_warnings(flight: Flight, map_: Map, tied: NDArray[np.int64]) -> list[str]:
    """Return a line for each part that one pair alone joins; none where positions place all parts."""
    if map_.georeferenced or flight.frames is None:
        return []
    names = flight.picture_names(flight.frames.stamps_s[map_.observations.frame_index])
    return [
        f"one pair of pictures alone ({names[i]} and {names[j]}) joins {count} keyframes to the others, and "
        "no instrument confirms it: where the floor repeats, they may lie at a wrong place; compare the "
        "mosaic with the ground there, or fly a second crossing"
        for i, j, count in single_joins(map_, tied)
    ]
