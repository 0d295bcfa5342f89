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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import Solve, place_pairs
from backend.pose_graph.selection.evidence import Graph, LinearizedSet
from backend.pose_graph.selection.prediction import (
    LoopInnovations,
    innovations,
    log_prior_volume,
    sample_posterior,
    whitened_spread,
)
from backend.pose_graph.selection.swap_search import SwapSearch

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_ROUNDS = 10
_CANDIDATES, _KEPT = 150, 300
"""Rejected loops, and accepted ones, that may be flipped in one round."""
_FORCED_IN, _FORCED_OUT = 40, 20
_REACH = 120.0
"""Rejected loops with log odds (nats) below minus this are not tried."""
_LEAST_GAIN = 1.0
_NONE = np.zeros(0, dtype=np.int64)


def swap_loops(
    problem: Problem, graph: Graph, solve: Solve, kept: Mask, w_T: Array, late: Callable[[], bool]
) -> tuple[Mask, Array]:
    """Edges (m,) and the poses from them, of evidence no lower than ``kept`` and ``w_T``; odometry is kept.

    First with one representative loop for each pair of places, so that a whole group can be flipped at once;
    then with all loops.
    """
    place = place_pairs(problem.i, problem.j)
    search = _LocalSearch(problem, graph, solve, place, late)
    few = _one_loop_a_place(problem, kept, w_T, place)
    chosen, at = search.run(few, solve(few, w_T), opened=False)
    opened = not np.array_equal(chosen, few)
    if opened:
        kept = chosen | (kept & np.isin(place, place[chosen & ~problem.trusted]))
        w_T = solve(kept, at)
    return search.run(kept, w_T, opened)


def _one_loop_a_place(problem: Problem, kept: Mask, w_T: Array, place: Index) -> Mask:
    """Odometry, and for each pair of places the accepted loop of the smallest residual.

    Where the floor repeats, loops between the same places are false together and are no independent evidence.
    """
    chosen, loops = kept & problem.trusted, np.flatnonzero(kept & ~problem.trusted)
    off = (problem.residuals(w_T)[loops] ** 2).sum(axis=1)
    chosen[_first_of_each(loops[np.argsort(off)], place)] = True
    return chosen


def _first_of_each(loops: Index, place: Index) -> Index:
    return loops[np.sort(np.unique(place[loops], return_index=True)[1])]


@dataclass(frozen=True)
class _LocalSearch:
    """Hill climbing on the evidence over sets of accepted loops."""

    problem: Problem
    graph: Graph
    solve: Solve
    place: Index
    """(m,) which edges join the same two places."""
    late: Callable[[], bool]

    def run(self, kept: Mask, w_T: Array, opened: bool) -> tuple[Mask, Array]:
        """Edges (m,) kept in the end, and the poses from them.

        Pure insertions or removals were decided earlier; they are allowed again (``opened``) only after a
        swap.
        """
        # The volume is that of the first map: one that grows must not look better for it.
        volumes = log_prior_volume(self.problem, w_T) - self.problem.dof / 2 * np.log(2 * np.pi)
        here = LinearizedSet.of(self.problem, self.graph, kept, w_T, volumes)
        for _ in range(_ROUNDS):
            if here is None or self.late():
                break
            changes = self._best_changes(here, both=not opened)
            if len(changes) == 0:
                break
            other = here.kept.copy()
            other[changes] = ~other[changes]
            there = LinearizedSet.of(self.problem, self.graph, other, self.solve(other, here.w_T), volumes)
            if there is None or there.evidence(here.scale, here.odds) <= here.evidence(here.scale, here.odds):
                break
            here, opened = there, True
        return (kept, w_T) if here is None else (here.kept, here.w_T)

    def _best_changes(self, here: LinearizedSet, both: bool) -> Index:
        """The loops whose flips gain most, with ``both`` some of them insertions and some removals."""
        samples = sample_posterior(self.graph(here.kept), self.problem.values(here.w_T), self.problem.dof)
        outside = None if samples is None else self._nearest(here, samples)
        if samples is None or outside is None:
            return _NONE
        loops = np.sort(np.append(outside.edges, self._strained(here, samples, outside)))
        search = SwapSearch(here, loops, self.problem.residuals(here.w_T))
        likely, out, in_ = search.likely(), np.flatnonzero(~search.on), np.flatnonzero(search.on)
        forced = [
            *out[np.argsort(-likely[out])[:_FORCED_IN]].tolist(),
            *in_[np.argsort(likely[in_])[:_FORCED_OUT]].tolist(),
        ]
        found = (search.best_sequence(first, both) for first in [None, *forced])
        gain, sequence = max(found, key=lambda each: each[0])
        return loops[sequence] if gain > _LEAST_GAIN else _NONE

    def _nearest(self, here: LinearizedSet, samples: Array) -> LoopInnovations | None:
        """The rejected loops of highest log odds, one for each pair of places that has no accepted loop.

        None where all are too unlikely.
        """
        left_out = np.flatnonzero(~here.kept & ~np.isin(self.place, self.place[here.kept & here.loops]))
        if len(left_out) == 0:
            return None
        found = innovations(self.problem, here.w_T, samples, left_out, here.scale)
        likely = here.log_volumes[left_out] - self.problem.dof * np.log(here.scale) + here.odds
        likely = likely - (found.sigma() ** 2 + np.linalg.slogdet(found.covariance)[1]) / 2
        order = _first_of_each(np.argsort(-likely), self.place[left_out])[:_CANDIDATES]
        order = order[likely[order] > -_REACH]
        return found.only(order) if len(order) else None

    def _strained(self, here: LinearizedSet, samples: Array, outside: LoopInnovations) -> Index:
        """Accepted loops; if many, those whose residuals inserting an ``outside`` loop would change most."""
        inside = np.flatnonzero(here.kept & here.loops)
        if len(inside) <= _KEPT:
            return inside
        pull = np.linalg.solve(outside.covariance, outside.residual[..., None])[..., 0]
        pull = np.einsum("cds,cd->cs", outside.spread, pull) / samples.shape[2]
        strain = np.linalg.norm(whitened_spread(self.problem, here.w_T, samples, inside) @ pull.T, axis=1)
        return inside[np.argsort(-strain.max(axis=1))[:_KEPT]]
