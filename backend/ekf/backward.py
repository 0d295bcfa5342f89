"""Backward pass of the smoother over the events of the forward pass: numba kernels.

The modified Bryson-Frazier form propagates an adjoint (y, L) backward: the smoothed error is ``e - C y`` and
its covariance ``C - C L C``. It does not invert the covariance of the state, which is singular just after a
pose was cloned.

Source: Bierman 1973, "Fixed interval smoothing with discrete measurements".
"""

from __future__ import annotations

import numpy as np

from backend.ekf.forward import record_state
from backend.ekf.motion import (
    CLONE_POS,
    POS,
    ROT,
    Array,
    apply_transposed_transition,
    retract,
    transform_covariance,
)
from backend.ekf.readings import CLONE, OUTPUT
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
    """Propagate the adjoint y (n,), L (n, n) back over the block that ``forward`` has recorded, in place.

    Smoothed states at the requested times go to ``found``.
    """
    for k in range(last - 1, first - 1, -1):
        b = k - first
        kind = events.kind[k]
        C = tape.C[b]
        if len(found.all_x) > 0:
            found.all_x[k] = retract(tape.x[b], -(C @ y))
        if kind == OUTPUT:
            smooth = C - C @ (L @ C)
            record_state(found, events.row[k], retract(tape.x[b], -(C @ y)), (smooth + smooth.T) / 2)
        if kind == CLONE:
            _pull_back_clone(y, L)
        elif tape.dof[b] > 0:
            _pull_back_update(y, L, tape, b)
        if tape.F[b, 0, 0] > 0:
            transform_covariance(L, tape.F[b], True)
            apply_transposed_transition(y, tape.F[b])


@njit(cache=True)
def _pull_back_clone(y: Array, L: Array) -> None:
    """Apply the adjoint of cloning: the clone's part of the adjoint is added to that of the original."""
    for k in range(6):
        copy, of = CLONE_POS + k, (POS if k < 3 else ROT - 3) + k
        L[of] += L[copy]
        L[:, of] += L[:, copy]
        y[of] += y[copy]
        L[copy] = 0.0
        L[:, copy] = 0.0
        y[copy] = 0.0


@njit(cache=True)
def _pull_back_update(y: Array, L: Array, tape: Tape, b: int) -> None:
    """Apply the adjoint of one event's updates, last first: ``L <- h h' / S + (1 - K h)' L (1 - K h)``.

    L stays exactly symmetric: asymmetric rounding errors would grow without bound.
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
