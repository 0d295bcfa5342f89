"""Swap accepted loops for rejected ones where that raises the evidence: a local search after greedy growth.

A few false loops accepted early can distort the map until they support each other and the true ones fail
their gates; none of them is an outlier by itself. To leave such a local optimum, each rejected loop is
accepted by force, or each doubtful one rejected, and further loops are then flipped one at a time while that
raises the evidence of the linearised problem (`backend.pose_graph.selection.swap_search`). The best
sequence is applied, the graph solved again, and the result kept only where its evidence is higher
(`backend.pose_graph.selection.evidence`).

Source: Hansen and Mladenovic 2001 (EJOR 130), variable neighbourhood search.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import Solve
from backend.pose_graph.selection.chains import connected
from backend.pose_graph.selection.evidence import Graph, LinearizedSet, log_unit_volumes
from backend.pose_graph.selection.places import place_pairs
from backend.pose_graph.selection.prediction import (
    LoopInnovations,
    innovations,
    sample_posterior,
    solve_covariance,
    whitened_spread,
)
from backend.pose_graph.selection.swap_search import SwapSearch

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_ROUNDS = 10
_MAX_REJECTED, _MAX_ACCEPTED = 150, 300
"""Rejected loops, and accepted ones, that may be flipped in one round."""
_FORCED_IN, _FORCED_OUT = 40, 20
_MAX_LOG_ODDS_DEFICIT = 120.0
"""Rejected loops with log odds below minus this number of nats are not tried."""
_MIN_GAIN = 1.0
_NONE = np.zeros(0, dtype=np.int64)


def swap_loops(
    problem: Problem, graph: Graph, solve: Solve, kept: Mask, w_T: Array, out_of_time: Callable[[], bool]
) -> tuple[Mask, Array]:
    """Return edges (m,) and their poses, with evidence no lower than ``kept`` and ``w_T``.

    Odometry is kept. The first search has one representative loop per pair of places, so that a whole group
    can be flipped at once; the second has all loops.
    """
    place = place_pairs(problem.i, problem.j)
    search = LocalSearch(problem, graph, solve, place, out_of_time)
    few = one_loop_a_place(problem, kept, w_T, place)
    chosen, at = search.run(few, solve(few, w_T), allow_single_flips=False)
    allow_single_flips = not np.array_equal(chosen, few)
    if allow_single_flips:
        kept = chosen | (kept & np.isin(place, place[chosen & ~problem.trusted]))
        w_T = solve(kept, at)
    return search.run(kept, w_T, allow_single_flips)


def one_loop_a_place(problem: Problem, kept: Mask, w_T: Array, place: Index) -> Mask:
    """Return odometry, and for each pair of places the accepted loop of the smallest residual.

    On a repetitive floor loops between the same places are false together: they are not independent.
    """
    chosen, loops = kept & problem.trusted, np.flatnonzero(kept & ~problem.trusted)
    off = (problem.residuals(w_T)[loops] ** 2).sum(axis=1)
    chosen[_first_of_each(loops[np.argsort(off)], place)] = True
    return connected(problem, chosen, kept, w_T)


def _first_of_each(loops: Index, place: Index) -> Index:
    return loops[np.sort(np.unique(place[loops], return_index=True)[1])]


@dataclass(frozen=True)
class LocalSearch:
    """Hill climbing on the evidence over sets of accepted loops."""

    problem: Problem
    graph: Graph
    solve: Solve
    place: Index
    """(m,) label of the two places of each edge."""
    out_of_time: Callable[[], bool]
    least_gain: float = _MIN_GAIN
    """Evidence (nats) that a sequence of flips must gain."""

    def run(self, kept: Mask, w_T: Array, allow_single_flips: bool) -> tuple[Mask, Array]:
        """Return the finally kept edges (m,) and their poses.

        Pure insertions or removals were decided earlier; ``allow_single_flips`` or a swap permits them.
        """
        # The volume is that of the first map: a growing map must not raise the evidence.
        volumes = log_unit_volumes(self.problem, w_T)
        current = LinearizedSet.of(self.problem, self.graph, kept, w_T, volumes)
        for _ in range(_ROUNDS):
            if current is None or self.out_of_time():
                break
            odds, both = current.odds, not allow_single_flips
            # False loops in a set inflate its noise until they look like noise: try the stated noise too.
            scales = sorted({current.scale, min(current.scale, 1.0)})
            proposals = [self.propose(replace(current, scale=scale), both, volumes) for scale in scales]
            best = max((p for p in proposals if p is not None), key=lambda p: p.evidence(odds), default=None)
            if best is None or best.evidence(odds) <= current.evidence(odds):
                break
            current, allow_single_flips = best, True
        return (kept, w_T) if current is None else (current.kept, current.w_T)

    def propose(self, current: LinearizedSet, both: bool, volumes: Array) -> LinearizedSet | None:
        """Return the set after the best flip sequence; None if there is none."""
        flips = self._best_flips(current, both)
        if len(flips) == 0:
            return None
        other = current.kept.copy()
        other[flips] = ~other[flips]
        return LinearizedSet.of(self.problem, self.graph, other, self.solve(other, current.w_T), volumes)

    def _best_flips(self, current: LinearizedSet, both: bool) -> Index:
        """Return the loops of the best flip sequence; ``both`` demands an insertion and a removal."""
        samples = sample_posterior(
            self.graph(current.kept), self.problem.values(current.w_T), self.problem.dof
        )
        outside = None if samples is None else self._likeliest_rejected(current, samples)
        if samples is None or outside is None:
            return _NONE
        loops = np.sort(np.append(outside.edges, self._most_affected(current, samples, outside)))
        search = SwapSearch(current, loops, self.problem.residuals(current.w_T))
        log_odds = search.log_odds()
        out = np.flatnonzero(~search.accepted)
        in_ = np.flatnonzero(search.accepted & np.isfinite(log_odds))
        forced = [
            *out[np.argsort(-log_odds[out])[:_FORCED_IN]].tolist(),
            *in_[np.argsort(log_odds[in_])[:_FORCED_OUT]].tolist(),
        ]
        least = self.least_gain
        found = (search.best_sequence(first, both, least) for first in [None, *forced])
        return loops[max(found, key=lambda each: each[0])[1]]

    def _likeliest_rejected(self, current: LinearizedSet, samples: Array) -> LoopInnovations | None:
        """Return the rejected loops of highest log odds, one per pair of places without an accepted loop.

        The result is None if all are too unlikely.
        """
        left_out = np.flatnonzero(
            ~current.kept & ~np.isin(self.place, self.place[current.kept & current.loops])
        )
        if len(left_out) == 0:
            return None
        found = innovations(self.problem, current.w_T, samples, left_out, current.scale)
        log_odds = current.log_volumes[left_out] - self.problem.dof * np.log(current.scale) + current.odds
        log_odds = log_odds - (found.sigma() ** 2 + np.linalg.slogdet(found.covariance)[1]) / 2
        order = _first_of_each(np.argsort(-log_odds), self.place[left_out])[:_MAX_REJECTED]
        order = order[log_odds[order] > -_MAX_LOG_ODDS_DEFICIT]
        return found.subset(order) if len(order) else None

    def _most_affected(self, current: LinearizedSet, samples: Array, outside: LoopInnovations) -> Index:
        """Return accepted loops; if many, those whose residuals an ``outside`` loop would change most."""
        inside = np.flatnonzero(current.kept & current.loops)
        if len(inside) <= _MAX_ACCEPTED:
            return inside
        pull = solve_covariance(outside.covariance, outside.residual[..., None])[..., 0]
        pull = np.einsum("cds,cd->cs", outside.spread, pull) / samples.shape[2]
        strain = np.linalg.norm(whitened_spread(self.problem, current.w_T, samples, inside) @ pull.T, axis=1)
        return inside[np.argsort(-strain.max(axis=1))[:_MAX_ACCEPTED]]
