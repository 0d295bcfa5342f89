"""Evidence of flipping loops (accepted to rejected or back) one at a time, in the problem linearised once.

Inserting or removing a loop is an update of rank d of the linear system. Source: Woodbury 1950.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.selection.evidence import LinearizedSet
from backend.pose_graph.selection.prediction import squared_mahalanobis

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LOST = 150.0
"""A sequence whose evidence has fallen by so many nats is given up."""
_MOVES = 40
_BLOCK = 60
_HELD = 1e-9


class SwapSearch:
    """Candidate loops with their residuals and predicted covariances, updated in place by each flip."""

    def __init__(self, here: LinearizedSet, loops: Index, residual: Array) -> None:
        self.here, self.loops, self.d = here, loops, residual.shape[1]
        rows = (loops[:, None] * self.d + np.arange(self.d)).ravel()
        self.J = here.J[rows]
        self._columns: dict[int, Array] = {}
        self._start = residual[loops], self._own(), here.kept[loops]
        self._begin()

    def _begin(self) -> None:
        residual, own, on = self._start
        self.residual, self.own, self.on = residual, own, on.copy()
        """(k, d); (k, d, d) covariance of the prediction, in units of the noise; (k,) which are accepted."""
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
        """(k d, d) cross-covariance of all predictions with that of loop x."""
        at = slice(x * self.d, (x + 1) * self.d)
        if x not in self._columns:
            self._columns[x] = np.asarray(self.J @ self.here.factor.solve(self.J[at].T.toarray()))
        column = self._columns[x].copy()
        for _, gain, other, sign in self._changes:
            column -= sign * gain @ other[at].T
        return column

    def likely(self) -> Array:
        """(k,) log odds (nats) of each loop being true rather than uniform over the map, given all others."""
        sign = np.where(self.on, -1.0, 1.0)
        spread = (1 + _HELD) * np.eye(self.d) + sign[:, None, None] * self.own
        off = squared_mahalanobis(self.residual, spread) / self.here.scale**2
        volume = sign * np.linalg.slogdet(spread)[1]
        room = self.here.log_volumes[self.loops] - self.d * np.log(self.here.scale)
        return np.asarray(np.nan_to_num(room + self.here.odds - (off + volume) / 2, nan=-LOST))

    def change(self, x: int) -> None:
        """Flip loop x: insert it if it is rejected, remove it if it is accepted."""
        column, sign = self._column(x), -1.0 if self.on[x] else 1.0
        gain = column @ np.linalg.inv((1 + _HELD) * np.eye(self.d) + sign * self.own[x])
        self.residual = self.residual - sign * (gain @ self.residual[x]).reshape(-1, self.d)
        by_loop = (-1, self.d, self.d)
        self.own = self.own - sign * gain.reshape(by_loop) @ np.swapaxes(column.reshape(by_loop), 1, 2)
        self._changes.append((x, gain, column, sign))
        self.on[x] = not self.on[x]

    def best_sequence(self, first: int | None, both: bool) -> tuple[float, list[int]]:
        """Gain in evidence (nats) of the best greedy sequence of flips, and its loops, each flipped once.

        ``first`` is flipped whatever it costs. With ``both`` at least one must be inserted and one removed.
        """
        self._begin()
        total, best, length = 0.0, 0.0, 0
        done: list[int] = []
        come: set[bool] = set()
        while len(done) < _MOVES and total > -LOST:
            gain = np.where(self.on, -1.0, 1.0) * self.likely()
            gain[done] = -np.inf
            x = int(np.argmax(gain)) if done or first is None else first
            if (done or first is None) and gain[x] <= 0:
                break
            total += float(gain[x])
            self.change(x)
            done.append(x)
            come.add(bool(self.on[x]))
            if total > best and (len(come) == 2 or not both):
                best, length = total, len(done)
        return best, done[:length]
