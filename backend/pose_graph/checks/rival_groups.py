"""Rejected edges that agree with each other, and have almost as much for them as what contradicts them.

Where a floor repeats, the loops between two stretches of the path may fall into two groups, each of which
agrees within itself: the true ones, and those to the wrong copy. The selection keeps one group. If the odds
between both are low, no answer is certain, and the user must look.

A group of rejected edges is one hypothesis: the path behind them lies elsewhere, by one transform. What
contradicts it is the cheapest cut through the kept edges between the two sides: if the rejected group is
true, all edges of the cut are false. Edges are false for one of two reasons. A row of loops or an edge of
odometry is false by itself, and lies anywhere. Several rows that agree in a false transform have a common
cause, and then their number says little: any share of the rows below a half may be false.

Odometry between distant places need not break at one step: it may bend. So each group is also solved with the
odometry, without what contradicts it (`rival_maps.py`).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from backend import se3
from backend.pose_graph.checks.improbability import Improbability, MovedRivals
from backend.pose_graph.checks.rival_maps import rival_maps
from backend.pose_graph.checks.solved_parts import posterior_samples, solved_parts
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import MAX_HYPOTHESES
from backend.pose_graph.selection.chains import Chain, Joining
from backend.pose_graph.selection.prediction import noise_scale
from backend.pose_graph.selection.rival_loops import LEAST_LOG_ODDS, described
from backend.pose_graph.solution import Solution

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_MOST_PREDICTIONS = 300_000
"""Predictions of a rejected edge by another one that are computed: some seconds."""
_MOST_GROUPS = 20
"""Groups whose contradiction is computed, those of most rows first."""
_UNITS = 1000.0
"""Integers per nat in the computation of a minimum cut."""
_EVERYTHING = 2**30


def rival_groups(problem: Problem, solution: Solution, deadline: float = math.inf) -> list[str]:
    """Return a sentence for each component whose kept loops have a rival group of low odds.

    No second map is solved after the ``deadline`` on the clock of ``time.monotonic``.
    """
    sentences = []
    for part, w_T, edges in solved_parts(problem, solution, solution.edge_informative):
        found = doubtful_rivals(part, solution.edge_kept[edges], w_T, deadline)
        if found is not None:
            sentences.append(_sentence(part, found))
    return sentences


def doubtful_rivals(
    problem: Problem, kept: Mask, w_T: Array, deadline: float = math.inf
) -> MovedRivals | None:
    """Return the rejected group of the lowest odds against it; None if all odds are high enough."""
    rejected = np.flatnonzero(~kept)
    samples = posterior_samples(problem, kept, w_T) if len(rejected) and kept.any() else None
    if samples is None:
        return None
    improbability = Improbability(problem, kept, w_T)
    groups = _groups(problem, rejected, w_T, samples, improbability)
    found = [_contradicted(problem, group, w_T, improbability) for group in groups]
    found += rival_maps(improbability, found, deadline)
    worst = min(found, key=lambda each: each.log_odds, default=None)
    return worst if worst is not None and worst.log_odds < LEAST_LOG_ODDS else None


def _groups(
    problem: Problem, rejected: Index, w_T: Array, samples: Array, improbability: Improbability
) -> list[tuple[int, Index]]:
    """Return one of the edges, and all edges, of the groups of most rows that agree in one transform."""
    state, own = _two_copies(problem, rejected, w_T, samples, noise_scale(problem, improbability.kept, w_T))
    most = max(1, min(MAX_HYPOTHESES, _MOST_PREDICTIONS // len(rejected)))
    found: list[tuple[float, int, Index]] = []
    for number in range(0, len(rejected), -(-len(rejected) // most)):
        group = _over_one_step(problem, rejected[state.agreeing(number, own)], improbability)
        if len(group):
            count = improbability.rows(group) + np.count_nonzero(problem.trusted[group])
            found.append((float(count), int(rejected[number]), group))
    groups: list[tuple[int, Index]] = []
    seen: set[int] = set()
    for _, edge, group in sorted(found, key=lambda each: -each[0]):
        if not seen.issuperset(group.tolist()):
            groups.append((edge, group))
            seen.update(group.tolist())
    return groups[:_MOST_GROUPS]


def _two_copies(
    problem: Problem, edges: Index, w_T: Array, samples: Array, scale: float
) -> tuple[Joining, Index]:
    """Return the solution twice, as two frames: each edge leads from one to the other."""
    i, j = problem.i[edges], problem.j[edges]
    early, late = np.unique(np.minimum(i, j)), np.unique(np.maximum(i, j))
    poses = np.concatenate([early, late])
    places = [np.searchsorted(early, np.minimum(i, j)), len(early) + np.searchsorted(late, np.maximum(i, j))]
    forward = i < j
    copies = replace(
        problem,
        names=tuple(problem.names[k] for k in poses.tolist()),
        i=np.where(forward, *places),
        j=np.where(forward, *reversed(places)),
        ij_T=problem.ij_T[edges],
        sqrt_information=problem.sqrt_information[edges] / scale,
        trusted=np.zeros(len(edges), dtype=bool),
        initial=w_T[poses],
        unary_factors=(),
    )
    frames = [
        Chain(np.arange(len(early)), w_T[early], scale * samples[early]),
        Chain(np.arange(len(early), len(poses)), w_T[late], scale * samples[late]),
    ]
    return Joining(copies, frames), np.arange(len(edges))


def _over_one_step(problem: Problem, group: Index, improbability: Improbability) -> Index:
    """Return the edges of a group over the step of the path that most rows span.

    Their earlier ends then lie on one side, and their later ends on the other.
    """
    if len(group) == 0:
        return group
    low, high = np.minimum(problem.i, problem.j)[group], np.maximum(problem.i, problem.j)[group]
    over = (low <= low[:, None]) & (low[:, None] < high)
    best = int(np.argmax([len(np.unique(improbability.row[group[each]])) for each in over]))
    return np.asarray(group[over[best]])


def _contradicted(
    problem: Problem, group: tuple[int, Index], w_T: Array, improbability: Improbability
) -> MovedRivals:
    """Return a group with the cheapest kept edges that must be false if it is true."""
    edge, edges = group
    low, high = np.minimum(problem.i, problem.j), np.maximum(problem.i, problem.j)
    kept = np.flatnonzero(improbability.kept)
    first, row = np.unique(improbability.row[kept], return_index=True, return_inverse=True)[1:]
    # Odometry is false by itself; a further row of loops may have the cause of the others.
    value = np.where(problem.trusted, improbability.of_edge, np.log(2))[kept][first]
    cut = kept[_minimum_cut(problem.count, low[kept], high[kept], row, value, low[edges], high[edges])]
    length, degrees = _moved(problem, edge, np.unique(high[edges]), w_T)
    return MovedRivals(edges, cut, improbability.log_odds(cut, edges), length, degrees)


def _minimum_cut(
    count: int, low: Index, high: Index, row: Index, value: Array, sources: Index, sinks: Index
) -> Mask:
    """Return (k,) the edges, in rows (k,) of one value (r,) each, that part all sources from all sinks.

    The poses are 0 to ``count``. A row that has ends on both sides costs its value once: it is a bottleneck
    from all its earlier ends to all its later ones, and another one back.
    """
    rows, k = len(value), len(row)
    source, sink = count, count + 1
    # The two nodes of each bottleneck: those of the way from earlier to later ends, and of the way back.
    first = count + 2 + np.arange(2 * rows).reshape(2, rows)
    second = first + 2 * rows
    most = np.full(k, _EVERYTHING)
    units = np.maximum(np.round(_UNITS * value), 1).astype(np.int64)
    arcs = [
        (np.full(len(sources), source), sources, np.full(len(sources), _EVERYTHING)),
        (sinks, np.full(len(sinks), sink), np.full(len(sinks), _EVERYTHING)),
    ]
    for way, (begin, end) in enumerate(((low, high), (high, low))):
        arcs += [
            (begin, first[way, row], most),
            (second[way, row], end, most),
            (first[way], second[way], units),
        ]
    tail, head, capacity = (np.concatenate([arc[part] for arc in arcs]) for part in range(3))
    size = count + 2 + 4 * rows
    network = csr_array((capacity, (tail, head)), shape=(size, size))
    network.data = np.minimum(network.data, _EVERYTHING)
    network = csr_array(network.astype(np.int32))
    left = csr_array(network - maximum_flow(network, source, sink).flow)
    left.eliminate_zeros()
    inside = np.zeros(size, dtype=bool)
    inside[breadth_first_order(left, source, return_predecessors=False)] = True
    return np.asarray(inside[low] != inside[high])


def _moved(problem: Problem, edge: int, poses: Index, w_T: Array) -> tuple[float, float]:
    """Return by how much, and by what angle (degrees), some poses move if one edge is true."""
    i, j, T = int(problem.i[edge]), int(problem.j[edge]), problem.ij_T[edge]
    to = w_T[i] @ T @ se3.inverse(w_T[j]) if j > i else w_T[j] @ se3.inverse(w_T[i] @ T)
    off = (to @ w_T[poses] - w_T[poses])[:, :3, 3]
    angle = float(np.linalg.norm(se3.log(to[None])[0, :3]))
    return float(np.sqrt((off**2).sum(axis=1).mean())), float(np.degrees(angle))


def _sentence(problem: Problem, found: MovedRivals) -> str:
    loops = found.kept[~problem.trusted[found.kept]]
    steps = found.kept[problem.trusted[found.kept]]
    against = " and ".join(
        described(problem, edges, *kinds)
        for edges, kinds in (
            (loops, ("kept loop", "kept loops")),
            (steps, ("edge of odometry", "edges of odometry")),
        )
        if len(edges)
    )
    odds = np.exp(max(found.log_odds, 0.0))
    rejected = described(problem, found.rejected, "rejected edge", "rejected edges")
    agree = "contradicts" if len(found.rejected) == 1 else "agree with each other and contradict"
    return (
        f"{rejected} {agree} {against}:"
        f" if the rejected ones are true, the later poses lie {found.length:.2g} {problem.length_unit} and"
        f" {found.degrees:.2g} deg elsewhere, and the odds for the kept ones are only {odds:.0f} to 1; check"
        " which of the two are true, and delete the others from the file"
    )
