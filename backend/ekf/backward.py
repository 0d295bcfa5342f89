"""Backward pass of the smoother over the events of the forward pass: numba kernels.

The modified Bryson-Frazier form propagates an adjoint (y, L) backward: the smoothed error is ``e - C y`` and
its covariance ``C - C L C``. It does not invert the covariance of the state, which is singular just after a
pose was cloned.

Source: Bierman 1973, "Fixed interval smoothing with discrete measurements".
"""

from __future__ import annotations

from backend.compilation import inner_kernel, kernel
from backend.ekf.forward import record_state
from backend.ekf.motion import (
    CLONE_POS,
    MOVING,
    POS,
    ROT,
    apply_transition,
    retract,
    transform_covariance,
)
from backend.ekf.readings import CLONE, OUTPUT
from backend.ekf.records import FilterBuffers, FilterEvents, StateRecords, Tape
from backend.ekf.rotations import Array


@kernel
def backward(
    y: Array,
    L: Array,
    first: int,
    last: int,
    events: FilterEvents,
    found: StateRecords,
    tape: Tape,
    work: FilterBuffers,
) -> None:
    """Propagate the adjoint y (n,), L (n, n) back over the block that ``forward`` has recorded, in place.

    Smoothed states at the requested times go to ``found``. The recorded covariances are overwritten.
    """
    for k in range(last - 1, first - 1, -1):
        b, kind = k - first, events.kind[k]
        C, x, e, back = tape.C[b], tape.x[b], work.Ch, work.F
        if len(found.all_x) > 0 or kind == OUTPUT:
            _smoothed_error(C, y, e)
        if len(found.all_x) > 0:
            retract(x, e, found.all_x[k])
        if kind == OUTPUT:
            _smooth_covariance(C, L, work.LC, work.moved)
            record_state(found, events.row[k], x, e, C)
        if kind == CLONE:
            _pull_back_clone(y, L)
        elif tape.dof[b] > 0:
            _pull_back_update(y, L, tape, b, work.Ch)
        if tape.F[b, 0, 0] > 0:
            for i in range(MOVING):
                for j in range(MOVING):
                    back[i, j] = tape.F[b, j, i]
            transform_covariance(back, L, work.moved)
            apply_transition(back, y, work.moved)


@inner_kernel
def _smoothed_error(C: Array, y: Array, e: Array) -> None:
    """Write ``-C y`` into e (n,)."""
    for i in range(len(y)):
        total = 0.0
        for j in range(len(y)):
            total -= C[i, j] * y[j]
        e[i] = total


@inner_kernel
def _smooth_covariance(C: Array, L: Array, LC: Array, work: Array) -> None:
    """Replace a covariance C (n, n) by ``C - C L C``, exactly symmetric; uses the first row of ``work``."""
    n, row = len(C), work[0]
    for i in range(n):
        for j in range(n):
            LC[i, j] = 0.0
        for k in range(n):
            for j in range(n):
                LC[i, j] += L[i, k] * C[k, j]
    for i in range(n):
        for j in range(n):
            row[j] = C[i, j]
        for k in range(n):
            for j in range(n):
                C[i, j] -= row[k] * LC[k, j]
    for i in range(n):
        for j in range(i):
            C[i, j] = C[j, i] = (C[i, j] + C[j, i]) / 2


@inner_kernel
def _pull_back_clone(y: Array, L: Array) -> None:
    """Apply the adjoint of cloning: the clone's part of the adjoint is added to that of the original."""
    n = len(L)
    for k in range(6):
        copy, of = CLONE_POS + k, (POS if k < 3 else ROT - 3) + k
        y[of], y[copy] = y[of] + y[copy], 0.0
        for j in range(n):
            L[of, j], L[copy, j] = L[of, j] + L[copy, j], 0.0
        for j in range(n):
            L[j, of], L[j, copy] = L[j, of] + L[j, copy], 0.0


@inner_kernel
def _pull_back_update(y: Array, L: Array, tape: Tape, b: int, LK: Array) -> None:
    """Apply the adjoint of one event's updates, last first: ``L <- h h' / S + (1 - K h)' L (1 - K h)``.

    L stays exactly symmetric: asymmetric rounding errors would grow without bound. LK (n,) is a buffer.
    """
    n = len(L)
    for m in range(tape.dof[b] - 1, -1, -1):
        h, K, S = tape.H[b, m], tape.K[b, m], tape.S[b, m]
        yK, KLK = 0.0, 1 / S
        for j in range(n):
            LK[j] = 0.0
            yK += K[j] * y[j]
        for j in range(n):
            for r in range(n):
                LK[r] += K[j] * L[j, r]
        for j in range(n):
            KLK += K[j] * LK[j]
        for j in range(n):
            if h[j] != 0.0:
                y[j] -= h[j] * (tape.innovation[b, m] / S + yK)
                for r in range(n):
                    L[j, r] -= h[j] * LK[r]
                for r in range(n):
                    L[r, j] -= h[j] * LK[r]
        for j in range(n):
            if h[j] != 0.0:
                for r in range(n):
                    L[j, r] += KLK * h[j] * h[r]
