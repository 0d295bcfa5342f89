"""The smoother's pass back over the events that the filter has gone through: kernels.

The modified Bryson-Frazier form carries an adjoint (y, L) back through the same events: smoothed error ``e
- C y``, covariance ``C - C L C``. It inverts no covariance of the state, which is singular where a pose has
just been kept.

Source: Bierman 1973, "Fixed interval smoothing with discrete measurements".
"""

from __future__ import annotations

import numpy as np

from backend.ekf.forward import note
from backend.ekf.motion import (
    KEPT_POS,
    POS,
    ROT,
    Array,
    both_sides,
    pull,
    retract,
)
from backend.ekf.readings import ASK, KEEP
from backend.ekf.records import FilterEvents, StateRecords, Tape
from backend.numba_cache import njit


@njit(cache=True)
def backward(
    y: Array,
    L: Array,
    first: int,
    last: int,
    events: FilterEvents,
    found: StateRecords,
    tape: Tape,
) -> None:
    """Carry the adjoint y (n,), L (n, n) back over the block that ``forward`` has taped, in place.

    Notes smoothed states at the asked times.
    """
    for k in range(last - 1, first - 1, -1):
        b = k - first
        kind = events.kind[k]
        C = tape.C[b]
        if len(found.all_x) > 0:
            found.all_x[k] = retract(tape.x[b], -(C @ y))
        if kind == ASK:
            smooth = C - C @ (L @ C)
            note(found, events.row[k], retract(tape.x[b], -(C @ y)), (smooth + smooth.T) / 2)
        if kind == KEEP:
            _let_go(y, L)
        elif tape.dof[b] > 0:
            _give_back(y, L, tape, b)
        if tape.F[b, 0, 0] > 0:
            both_sides(L, tape.F[b], True)
            pull(y, tape.F[b])


@njit(cache=True)
def _let_go(y: Array, L: Array) -> None:
    """The adjoint of cloning the pose: what the adjoint holds of the clone is added to the original."""
    for k in range(6):
        copy, of = KEPT_POS + k, (POS if k < 3 else ROT - 3) + k
        L[of] += L[copy]
        L[:, of] += L[:, copy]
        y[of] += y[copy]
        L[copy] = 0.0
        L[:, copy] = 0.0
        y[copy] = 0.0


@njit(cache=True)
def _give_back(y: Array, L: Array, tape: Tape, b: int) -> None:
    """The adjoint of one event's updates, last first: ``L <- h h' / S + (1 - K h)' L (1 - K h)``.

    L stays symmetric to the last bit: rounding that is not grows without bound on the way back.
    """
    n = len(L)
    for m in range(tape.dof[b] - 1, -1, -1):
        h, K, S = tape.H[b, m], tape.K[b, m], tape.S[b, m]
        LK, yK = np.zeros(n), 0.0
        for j in range(n):
            yK += K[j] * y[j]
            LK += K[j] * L[j]
        KLK = (K * LK).sum() + 1 / S
        for j in range(n):
            if h[j] != 0.0:
                y[j] -= h[j] * (tape.innovation[b, m] / S + yK)
        for j in range(n):
            if h[j] != 0.0:
                for r in range(n):
                    L[j, r] -= h[j] * LK[r]
                    L[r, j] -= h[j] * LK[r]
        for j in range(n):
            if h[j] != 0.0:
                for r in range(n):
                    L[j, r] += KLK * h[j] * h[r]
