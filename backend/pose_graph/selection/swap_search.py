"""Evidence of flipping loops (accepted to rejected or back) one at a time, in one linearised problem.

Inserting or removing a loop is an update of rank d of the linear system. Source: Woodbury 1950.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.selection.evidence import LinearizedSet

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ABANDON_NATS = 150.0
"""Loss of evidence, in nats, at which a sequence is abandoned."""
_MAX_FLIPS = 40
_BLOCK = 60
_UNCHECKED = 1e-6
"""Share of a loop's variance that other edges leave open; below it rounding errors decide."""


class SwapSearch:
    """Candidate loops with their residuals and predicted covariances, updated in place by each flip."""

    def __init__(self, current: LinearizedSet, loops: Index, residual: Array) -> None:
        self.current, self.loops, self.d = current, loops, residual.shape[1]
        rows = (loops[:, None] * self.d + np.arange(self.d)).ravel()
        self.J = current.J[rows]
        self._columns: dict[int, Array] = {}
        self._start = residual[loops], self._predicted_covariances(), current.kept[loops]
        self._begin()

    def _begin(self) -> None:
        residual, covariances, accepted = self._start
        self.residual, self.covariances, self.accepted = (
            residual,
            covariances,
            accepted.copy(),
        )
        """(k, d); (k, d, d) covariance of the prediction, in units of the noise; (k,) which are accepted."""
        self._flips: list[tuple[int, Array, Array, float]] = []

    def _predicted_covariances(self) -> Array:
        d, n = self.d, len(self.loops)
        covariances = np.empty((n, d, d))
        for begin in range(0, n, _BLOCK):
            some = self.J[begin * d : (begin + _BLOCK) * d]
            product = np.asarray(some @ self.current.factor.solve(some.T.toarray()))
            k = np.arange(len(product) // d)
            covariances[begin + k] = product.reshape(len(k), d, len(k), d)[k, :, k, :]
        return covariances

    def _column(self, x: int) -> Array:
        """Return the cross-covariance (k d, d) of all predictions with that of loop x."""
        at = slice(x * self.d, (x + 1) * self.d)
        if x not in self._columns:
            self._columns[x] = np.asarray(self.J @ self.current.factor.solve(self.J[at].T.toarray()))
        column = self._columns[x].copy()
        for _, gain, other, sign in self._flips:
            column -= sign * gain @ other[at].T
        return column

    def log_odds(self) -> Array:
        """Return (k,) log odds (nats) of each loop: true against uniform over the map, given all others.

        They are infinite for an accepted loop that nothing else checks in some direction: it joins two parts.
        """
        sign = np.where(self.accepted, -1.0, 1.0)
        variance, along = _innovations(self.residual, self.covariances, sign)
        off = (along**2 / variance).sum(axis=1) / self.current.scale**2
        volume = sign * np.log(variance).sum(axis=1)
        volume_prior = self.current.log_volumes[self.loops] - self.d * np.log(self.current.scale)
        odds = np.nan_to_num(volume_prior + self.current.odds - (off + volume) / 2, nan=-ABANDON_NATS)
        return np.where(variance.min(axis=1) <= _UNCHECKED, np.inf, odds)

    def flip(self, x: int) -> None:
        """Flip loop x: insert it if it is rejected, remove it if it is accepted."""
        column, sign = self._column(x), -1.0 if self.accepted[x] else 1.0
        gain = column @ np.linalg.inv(np.eye(self.d) + sign * self.covariances[x])
        self.residual = self.residual - sign * (gain @ self.residual[x]).reshape(-1, self.d)
        by_loop = (-1, self.d, self.d)
        self.covariances = self.covariances - sign * gain.reshape(by_loop) @ np.swapaxes(
            column.reshape(by_loop), 1, 2
        )
        self._flips.append((x, gain, column, sign))
        self.accepted[x] = not self.accepted[x]

    def best_sequence(self, first: int | None, both: bool, least: float = 0.0) -> tuple[float, list[int]]:
        """Return the gain in evidence (nats) of the best greedy flip sequence, and its loops.

        ``first`` is flipped at any cost. With ``both`` at least one must be inserted and one removed. Where
        no sequence gains more than ``least``, the result is that gain and no loop.
        """
        self._begin()
        total, best, length = 0.0, least, 0
        done: list[int] = []
        directions: set[bool] = set()
        while len(done) < _MAX_FLIPS and total > -ABANDON_NATS:
            gain = np.where(self.accepted, -1.0, 1.0) * self.log_odds()
            gain[done] = -np.inf
            x = int(np.argmax(gain)) if done or first is None else first
            if (done or first is None) and gain[x] <= 0:
                break
            total += float(gain[x])
            self.flip(x)
            done.append(x)
            directions.add(bool(self.accepted[x]))
            if total > best and (len(directions) == 2 or not both):
                best, length = total, len(done)
        return best, done[:length]


def removal_gains(residual: Array, covariances: Array) -> Array:
    """Return (k,) how much the chi-square falls if each accepted loop alone is removed.

    ``residual`` (k, d) and ``covariances`` (k, d, d) of the predictions are whitened. A direction that no
    other edge checks changes nothing.
    """
    variance, along = _innovations(residual, covariances, -np.ones(len(residual)))
    return np.asarray((along**2 / np.where(variance > _UNCHECKED, variance, np.inf)).sum(axis=1))


def _innovations(residual: Array, covariances: Array, sign: Array) -> tuple[Array, Array]:
    """Return variances and innovations (k, d) on principal axes; ``sign`` (k,) is -1 for an accepted loop."""
    variance, axes = np.linalg.eigh(np.eye(residual.shape[1]) + sign[:, None, None] * covariances)
    return np.maximum(variance, _UNCHECKED), np.einsum("kab,ka->kb", axes, residual)
