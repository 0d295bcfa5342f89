"""Loops exchanged for others where those explain more: the end of a set that grew from what was surest.

A few false loops that agreed early bend the map until they bear each other out and shut true ones off. None
of them sticks out alone. So each loop that was left out is put in by force, and each doubtful one taken out;
then the rest follows, one loop at a time, as long as what was measured becomes more likely by it. All that
happens in the linear system about the solution, where a loop is an update of rank d. The best of these ways
is gone, solved anew, and kept only where the evidence of the whole has grown.

The evidence is the probability of all measurements where the loops of a set are true and any other may lie
anywhere in the map. Source: MacKay 1992 (Neural Computation 4), section 3; Woodbury 1950 for the updates;
Hansen and Mladenovic 2001 (EJOR 130) for a search that leaves a summit by force.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import SuperLU

from backend.linear import cholesky, jacobian
from backend.problem import Problem
from backend.selection.agreement import places
from backend.selection.prediction import draws, innovations, log_room, noise_scale, squared, whitened_spread

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
Graph = Callable[[Mask], gtsam.NonlinearFactorGraph]
"""The factors of some edges, with all that holds them."""
Solve = Callable[[Mask, Array], Array]
"""Poses from some edges and a start."""
Late = Callable[[], bool]

_LOG_DOUBT = float(np.log(0.05))
"""Of the odds for a loop: one that just breaks even is not taken."""
_ROUNDS = 10
_MOVES = 40
_CANDIDATES, _KEPT = 150, 300
"""Loops left out, and loops kept, that may change sides in one round."""
_FORCED_IN, _FORCED_OUT = 40, 20
_REACH, _LOST = 120.0, 150.0
"""Nats against a loop that is tried all the same, and below which no way is followed."""
_LEAST_GAIN = 1.0
_BLOCK = 60
_HELD = 1e-9


def exchanged(
    problem: Problem, graph: Graph, solve: Solve, kept: Mask, w_T: Array, late: Late
) -> tuple[Mask, Array]:
    """Edges (m,) and the poses from them, no less likely than ``kept`` and ``w_T``; odometry always stays.

    First one loop speaks for all between the same two places, which may so change sides together; then all.
    """
    place = places(problem.i, problem.j)
    spokesmen = _spokesmen(problem, kept, w_T, place)
    chosen, at = _climbed(problem, graph, solve, spokesmen, solve(spokesmen, w_T), place, late, False)
    opened = not np.array_equal(chosen, spokesmen)
    if opened:
        kept = chosen | (kept & np.isin(place, place[chosen & ~problem.trusted]))
        w_T = solve(kept, at)
    return _climbed(problem, graph, solve, kept, w_T, place, late, opened)


def _climbed(
    problem: Problem,
    graph: Graph,
    solve: Solve,
    kept: Mask,
    w_T: Array,
    place: Index,
    late: Late,
    opened: bool,
) -> tuple[Mask, Array]:
    """What merely sticks out or agrees was judged before: that is open again (``opened``) only once loops
    were exchanged."""
    # The room is that of the first map: one that grows must not look better for it.
    rooms = log_room(problem, w_T) - problem.freedom / 2 * np.log(2 * np.pi)
    here = _Standing.of(problem, graph, kept, w_T, rooms)
    for _ in range(_ROUNDS):
        if here is None or late():
            break
        changes = _best_way(problem, graph, here, place, both=not opened)
        if len(changes) == 0:
            break
        other = here.kept.copy()
        other[changes] = ~other[changes]
        there = _Standing.of(problem, graph, other, solve(other, here.w_T), rooms)
        if there is None or there.evidence(here.scale, here.odds) <= here.evidence(here.scale, here.odds):
            break
        here, opened = there, True
    return (kept, w_T) if here is None else (here.kept, here.w_T)


def _spokesmen(problem: Problem, kept: Mask, w_T: Array, place: Index) -> Mask:
    """Odometry, and of the loops between the same two places the one that fits best: where the floor repeats
    they are false together, and tell no more than one."""
    chosen, loops = kept & problem.trusted, np.flatnonzero(kept & ~problem.trusted)
    off = (problem.residuals(w_T)[loops] ** 2).sum(axis=1)
    chosen[_first_of_each(loops[np.argsort(off)], place)] = True
    return chosen


def _first_of_each(loops: Index, place: Index) -> Index:
    return loops[np.sort(np.unique(place[loops], return_index=True)[1])]


@dataclass(frozen=True)
class _Standing:
    """A set of edges, its solution, and the linear system about it."""

    kept: Mask
    w_T: Array
    loops: Mask
    J: csr_array
    """(m d, size) of all edges."""
    factor: SuperLU
    """Of the information of those that are kept."""
    squares: float
    rooms: Array
    """(m,) logarithm of the whitened volume in which a loop might lie, over that of a unit Gaussian."""
    scale: float
    """How large noise is over what is stated."""

    @staticmethod
    def of(problem: Problem, graph: Graph, kept: Mask, w_T: Array, rooms: Array) -> _Standing | None:
        """None where the system is singular."""
        m, d = len(problem.i), problem.freedom
        J = csr_array(jacobian(graph(np.ones(m, dtype=bool)), problem.values(w_T)))
        edges = J[: m * d]
        used = J[np.append(np.repeat(kept, d), np.ones(J.shape[0] - m * d, dtype=bool))]
        try:
            factor = cholesky(csc_array(used.T @ used))
        except RuntimeError:
            return None
        squares = float((problem.residuals(w_T)[kept] ** 2).sum())
        scale = noise_scale(problem, kept, w_T)
        return _Standing(kept, w_T, ~problem.trusted, edges, factor, squares, rooms, scale)

    @property
    def odds(self) -> float:
        """Logarithm, of a loop before it was looked at."""
        kept, out = int((self.kept & self.loops).sum()), int((~self.kept).sum())
        return float(np.log((1 + kept) / (1 + out))) + _LOG_DOUBT

    def evidence(self, scale: float, odds: float) -> float:
        """Logarithm, but for what is common to all sets; the information is that of Laplace."""
        d = self.J.shape[0] // len(self.kept)
        taken = self.kept & self.loops
        volume = float(np.log(np.abs(self.factor.U.diagonal())).sum())
        gained = float((self.rooms[taken] - d * np.log(scale) + odds).sum())
        return gained - self.squares / scale**2 / 2 - volume / 2


def _best_way(problem: Problem, graph: Graph, here: _Standing, place: Index, both: bool) -> Index:
    """Numbers of the loops that are to change sides, with ``both`` to either; none where nothing helps."""
    drawn = draws(graph(here.kept), problem.values(here.w_T), problem.freedom)
    left_out = np.flatnonzero(~here.kept & ~np.isin(place, place[here.kept & here.loops]))
    if drawn is None or len(left_out) == 0:
        return left_out[:0]
    found = innovations(problem, here.w_T, drawn, left_out, here.scale)
    likely = here.rooms[left_out] - problem.freedom * np.log(here.scale) + here.odds
    likely = likely - (found.sigma() ** 2 + np.linalg.slogdet(found.covariance)[1]) / 2
    order = _first_of_each(np.argsort(-likely), place[left_out])[:_CANDIDATES]
    order = order[likely[order] > -_REACH]
    if len(order) == 0:
        return left_out[:0]
    pull = np.linalg.solve(found.covariance[order], found.residual[order][..., None])[..., 0]
    pull = np.einsum("cds,cd->cs", found.spread[order], pull) / drawn.shape[2]
    inside = np.flatnonzero(here.kept & here.loops)
    if len(inside) > _KEPT:
        strain = np.linalg.norm(whitened_spread(problem, here.w_T, drawn, inside) @ pull.T, axis=1)
        inside = np.sort(inside[np.argsort(-strain.max(axis=1))[:_KEPT]])
    search = _Search(here, np.sort(np.append(left_out[order], inside)), problem.residuals(here.w_T))
    likely = search.likely()
    outer, inner = np.flatnonzero(~search.on), np.flatnonzero(search.on)
    forced = [
        *outer[np.argsort(-likely[outer])[:_FORCED_IN]].tolist(),
        *inner[np.argsort(likely[inner])[:_FORCED_OUT]].tolist(),
    ]
    gain, way = max((search.way(first, both) for first in [None, *forced]), key=lambda found: found[0])
    return search.loops[way] if gain > _LEAST_GAIN else left_out[:0]


class _Search:
    """Some loops that may change sides; what a change makes of the others, without solving anew."""

    def __init__(self, here: _Standing, loops: Index, residual: Array) -> None:
        self.here, self.loops, self.d = here, loops, residual.shape[1]
        rows = (loops[:, None] * self.d + np.arange(self.d)).ravel()
        self.J = here.J[rows]
        self._columns: dict[int, Array] = {}
        self._start = residual[loops], self._own(), here.kept[loops]
        self._begin()

    def _begin(self) -> None:
        residual, own, on = self._start
        self.residual, self.own, self.on = residual, own, on.copy()
        """(k, d); (k, d, d) covariance of the prediction, in units of the noise; (k,) who is in."""
        self._changes: list[tuple[int, Array, Array, float]] = []

    def _own(self) -> Array:
        d, n = self.d, len(self.loops)
        own = np.empty((n, d, d))
        for begin in range(0, n, _BLOCK):
            some = self.J[begin * d : (begin + _BLOCK) * d]
            product = np.asarray(some @ self.here.factor.solve(some.T.toarray()))
            k = np.arange(len(product) // d)
            own[begin + k] = product.reshape(len(k), d, len(k), d)[k, :, k, :]
        return own

    def _column(self, x: int) -> Array:
        """(k d, d) covariance of all predictions with that of one."""
        at = slice(x * self.d, (x + 1) * self.d)
        if x not in self._columns:
            self._columns[x] = np.asarray(self.J @ self.here.factor.solve(self.J[at].T.toarray()))
        column = self._columns[x].copy()
        for _, gain, other, sign in self._changes:
            column -= sign * gain @ other[at].T
        return column

    def likely(self) -> Array:
        """(k,) nats for each loop to be true and not anywhere, by what all others say of it."""
        sign = np.where(self.on, -1.0, 1.0)
        spread = (1 + _HELD) * np.eye(self.d) + sign[:, None, None] * self.own
        off = squared(self.residual, spread) / self.here.scale**2
        volume = sign * np.linalg.slogdet(spread)[1]
        room = self.here.rooms[self.loops] - self.d * np.log(self.here.scale)
        return np.asarray(np.nan_to_num(room + self.here.odds - (off + volume) / 2, nan=-_LOST))

    def _change(self, x: int) -> None:
        """Put a loop in, or take it out."""
        column, sign = self._column(x), -1.0 if self.on[x] else 1.0
        gain = column @ np.linalg.inv((1 + _HELD) * np.eye(self.d) + sign * self.own[x])
        self.residual = self.residual - sign * (gain @ self.residual[x]).reshape(-1, self.d)
        by_loop = (-1, self.d, self.d)
        self.own = self.own - sign * gain.reshape(by_loop) @ np.swapaxes(column.reshape(by_loop), 1, 2)
        self._changes.append((x, gain, column, sign))
        self.on[x] = not self.on[x]

    def way(self, first: int | None, both: bool) -> tuple[float, list[int]]:
        """Gain in nats and the loops that change, one by force at first; each changes once.

        With ``both`` some must leave and others come.
        """
        self._begin()
        total, best, way = 0.0, 0.0, 0
        done: list[int] = []
        come: set[bool] = set()
        while len(done) < _MOVES and total > -_LOST:
            gain = np.where(self.on, -1.0, 1.0) * self.likely()
            gain[done] = -np.inf
            x = int(np.argmax(gain)) if done or first is None else first
            if (done or first is None) and gain[x] <= 0:
                break
            total += float(gain[x])
            self._change(x)
            done.append(x)
            come.add(bool(self.on[x]))
            if total > best and (len(come) == 2 or not both):
                best, way = total, len(done)
        return best, done[:way]
