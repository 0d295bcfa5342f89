"""Loops exchange_loops for others where those explain more: the end of a set that grew from what was surest.

A few false loops that agreed early bend the map until they bear each other out and shut true ones off. None
of them sticks out alone. So each loop that was left out is put in by force, and each doubtful one taken out;
then the rest follows, one loop at a time, as long as what was measured becomes more likely by it
(`backend.selection.exchange_search`). The best of these sequences is carried out, solved anew, and kept only
where the evidence of the whole has grown (`backend.selection.evidence`).

Source: Hansen and Mladenovic 2001 (EJOR 130) for a search that leaves a summit by force.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.problem import Problem
from backend.selection.agreement import Solve, places
from backend.selection.evidence import Graph, LinearizedSet
from backend.selection.exchange_search import ExchangeSearch
from backend.selection.prediction import Innovations, draws, innovations, log_prior_volume, whitened_spread

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_ROUNDS = 10
_CANDIDATES, _KEPT = 150, 300
"""Loops left out, and loops kept, that may change sides in one round."""
_FORCED_IN, _FORCED_OUT = 40, 20
_REACH = 120.0
"""Nats against a loop that is tried all the same."""
_LEAST_GAIN = 1.0
_NONE = np.zeros(0, dtype=np.int64)


def exchange_loops(
    problem: Problem, graph: Graph, solve: Solve, kept: Mask, w_T: Array, late: Callable[[], bool]
) -> tuple[Mask, Array]:
    """Edges (m,) and the poses from them, no less likely than ``kept`` and ``w_T``; odometry always stays.

    First one loop speaks for all between the same two places, which may so change sides together; then all.
    """
    place = places(problem.i, problem.j)
    search = _LocalSearch(problem, graph, solve, place, late)
    few = _one_loop_a_place(problem, kept, w_T, place)
    chosen, at = search.run(few, solve(few, w_T), opened=False)
    opened = not np.array_equal(chosen, few)
    if opened:
        kept = chosen | (kept & np.isin(place, place[chosen & ~problem.trusted]))
        w_T = solve(kept, at)
    return search.run(kept, w_T, opened)


def _one_loop_a_place(problem: Problem, kept: Mask, w_T: Array, place: Index) -> Mask:
    """Odometry, and of the loops between the same two places the one that fits best: where the floor repeats
    they are false together, and tell no more than one."""
    chosen, loops = kept & problem.trusted, np.flatnonzero(kept & ~problem.trusted)
    off = (problem.residuals(w_T)[loops] ** 2).sum(axis=1)
    chosen[_first_of_each(loops[np.argsort(off)], place)] = True
    return chosen


def _first_of_each(loops: Index, place: Index) -> Index:
    return loops[np.sort(np.unique(place[loops], return_index=True)[1])]


@dataclass(frozen=True)
class _LocalSearch:
    """From one set of loops to a more likely one, as long as there is any."""

    problem: Problem
    graph: Graph
    solve: Solve
    place: Index
    """(m,) which edges join the same two places."""
    late: Callable[[], bool]

    def run(self, kept: Mask, w_T: Array, opened: bool) -> tuple[Mask, Array]:
        """Edges (m,) kept in the end, and the poses from them.

        Loops that are merely outliers or merely agree were judged earlier; they are considered again
        (``opened``) only after an exchange.
        """
        # The volume is that of the first map: one that grows must not look better for it.
        volumes = log_prior_volume(self.problem, w_T) - self.problem.freedom / 2 * np.log(2 * np.pi)
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
        """Which loops are to change sides, with ``both`` to either; none where nothing helps."""
        drawn = draws(self.graph(here.kept), self.problem.values(here.w_T), self.problem.freedom)
        outside = None if drawn is None else self._nearest(here, drawn)
        if drawn is None or outside is None:
            return _NONE
        loops = np.sort(np.append(outside.edges, self._strained(here, drawn, outside)))
        search = ExchangeSearch(here, loops, self.problem.residuals(here.w_T))
        likely, out, in_ = search.likely(), np.flatnonzero(~search.on), np.flatnonzero(search.on)
        forced = [
            *out[np.argsort(-likely[out])[:_FORCED_IN]].tolist(),
            *in_[np.argsort(likely[in_])[:_FORCED_OUT]].tolist(),
        ]
        found = (search.best_sequence(first, both) for first in [None, *forced])
        gain, sequence = max(found, key=lambda each: each[0])
        return loops[sequence] if gain > _LEAST_GAIN else _NONE

    def _nearest(self, here: LinearizedSet, drawn: Array) -> Innovations | None:
        """Loops left out that are the least unlikely to be true, one for each pair of places from which none
        is kept; None where all are too far off."""
        left_out = np.flatnonzero(~here.kept & ~np.isin(self.place, self.place[here.kept & here.loops]))
        if len(left_out) == 0:
            return None
        found = innovations(self.problem, here.w_T, drawn, left_out, here.scale)
        likely = here.log_volumes[left_out] - self.problem.freedom * np.log(here.scale) + here.odds
        likely = likely - (found.sigma() ** 2 + np.linalg.slogdet(found.covariance)[1]) / 2
        order = _first_of_each(np.argsort(-likely), self.place[left_out])[:_CANDIDATES]
        order = order[likely[order] > -_REACH]
        return found.only(order) if len(order) else None

    def _strained(self, here: LinearizedSet, drawn: Array, outside: Innovations) -> Index:
        """Loops kept, those that one from outside would strain most if there are many."""
        inside = np.flatnonzero(here.kept & here.loops)
        if len(inside) <= _KEPT:
            return inside
        pull = np.linalg.solve(outside.covariance, outside.residual[..., None])[..., 0]
        pull = np.einsum("cds,cd->cs", outside.spread, pull) / drawn.shape[2]
        strain = np.linalg.norm(whitened_spread(self.problem, here.w_T, drawn, inside) @ pull.T, axis=1)
        return inside[np.argsort(-strain.max(axis=1))[:_KEPT]]
