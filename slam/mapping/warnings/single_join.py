"""Recognises parts of a map that one pair of pictures alone joins, or that only poor pairs join.

After a stretch without features the motion is unknown. A later pair of pictures that look alike may join
what lies before and behind. Where the floor repeats, it may be a wrong one. No other pair contradicts it, and
wrong pairs of two equal places agree with each other. Pictures of one place share more points than those of
two equal tiles, whose marks differ.
"""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted
from frontend.registration import Registration
from slam.core.flight import Flight
from slam.core.messages import Message, warning
from slam.mapping.map import Map

_LEAST_KEYFRAMES = 2
"""Smallest part that counts."""


class Join(NamedTuple):
    """The pairs of keyframes that alone join two parts of a map."""

    i: int
    j: int
    """Keyframes of the best pair, i before j."""
    keyframes: int
    """Number of keyframes in the smaller part."""
    pairs: int
    """Number of pairs."""


def single_joins(map_: Map, tied: NDArray[np.int64]) -> list[Join]:
    """Return what joins keyframes to others of their part by one good pair, or by poor pairs alone.

    ``tied`` (n,): parts by the links of successive pictures and by the instruments, which confirm the pairs
    within. Links between successive keyframes need no confirmation. A pair is poor that matches fewer points
    for its overlap than any confirmed pair.
    """
    import networkx as nx  # as late as in `slam.mapping.inertial.bridges`

    part = map_.component
    pairs = [r for r in map_.kept_registrations if part[r.i] >= 0 and part[r.i] == part[r.j]]
    stretch = _stretches(map_, pairs, tied)
    least = min((_density(r) for r in pairs if stretch[r.i] == stretch[r.j]), default=0.0)
    joining = defaultdict[tuple[int, int], list[Registration]](list)
    for r in sorted(pairs, key=lambda r: -len(r.matches)):
        a, b = sorted((int(stretch[r.i]), int(stretch[r.j])))
        if a != b:
            joining[a, b].append(r)
    good = {ends: sum(_density(r) >= least for r in of_ends) for ends, of_ends in joining.items()}
    graph = nx.Graph(ends for ends, count in good.items() if count)
    alone = [ends for ends in map(_sorted, nx.bridges(graph)) if good[ends] == 1]
    graph.add_nodes_from(node for ends in joining for node in ends)
    for ends in joining:  # those with most matches first
        if not nx.has_path(graph, *ends):
            graph.add_edge(*ends)
            alone.append(ends)
    found = []
    for ends in alone:
        rest = nx.restricted_view(graph, [], [ends])
        sides = [np.isin(stretch, list(nx.node_connected_component(rest, end))).sum() for end in ends]
        best = joining[ends][0]
        if min(sides) >= _LEAST_KEYFRAMES:
            found.append(Join(*_sorted((best.i, best.j)), int(min(sides)), len(joining[ends])))
    return sorted(found)


def _stretches(map_: Map, pairs: list[Registration], tied: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number (n,) of the stretch of each keyframe, within which all pairs are confirmed."""
    import networkx as nx

    graph = nx.Graph()
    graph.add_nodes_from(range(len(tied)))
    graph.add_edges_from((r.i, r.j) for r in pairs if abs(r.i - r.j) == 1)
    graph.add_edges_from((bridge.edge.i, bridge.edge.j) for bridge in map_.bridges)
    for number in range(int(tied.max(initial=-1)) + 1):
        nx.add_path(graph, np.flatnonzero(tied == number).tolist())
    stretch = np.empty(len(tied), np.int64)
    for number, members in enumerate(nx.connected_components(graph)):
        stretch[list(members)] = number
    return stretch


def _density(pair: Registration) -> float:
    """Return the number of matches of a pair for a whole picture."""
    return len(pair.matches) / pair.overlap


def _sorted(ends: tuple[int, int]) -> tuple[int, int]:
    return min(ends), max(ends)


def single_join_warnings(flight: Flight, map_: Map, tied: NDArray[np.int64]) -> list[Message]:
    """Return a line for each part that is joined so; none where positions place all parts."""
    if map_.georeferenced or flight.frames is None:
        return []
    names = flight.picture_names(flight.frames.stamps_s[map_.observations.frame_index])
    return [
        warning(
            f"{_pairs(join, names)} {counted(join.keyframes, 'keyframe')} to the others, and no instrument "
            "confirms it: where the floor repeats, they may lie at a wrong place",
            "compare the mosaic with the ground there, or fly a second crossing",
        )
        for join in single_joins(map_, tied)
    ]


def _pairs(join: Join, names: tuple[str, ...]) -> str:
    between = f"{names[join.i]} and {names[join.j]}"
    if join.pairs == 1:
        return f"one pair of pictures alone ({between}) joins"
    return (
        f"only {join.pairs} pairs of pictures, at most one of them with many points in common (the best: "
        f"{between}) join"
    )
