"""The filter's pass forward over all events of a flight: kernels.

Each component of a reading is gated by its chi-square, then taken in Joseph's form.

In the first round readings and motion are linearised about the estimate of the moment. That estimate jitters,
and a product of two unknowns (a scale and what it multiplies) seems better known for it. Further rounds are
linearised about the smoothed states of the round before; the error then has a mean e of its own.

Source: Bucy and Joseph 1968 (Joseph's form); Bell 1994, "The iterated Kalman smoother as a Gauss-Newton
method"; Roumeliotis and Burdick 2002, "Stochastic cloning" (the kept pose).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from backend.compiled import njit
from backend.ekf.motion import (
    ATTITUDE_ERROR,
    BARO_ZERO,
    GPS_ZERO,
    KEPT_POS,
    KEPT_ROT,
    POS,
    RANGE_BIAS,
    ROT,
    SIZE,
    STATE,
    VEL_ERROR,
    X_KEPT_POS,
    X_KEPT_ROT,
    X_RATE,
    X_ROT,
    Array,
    difference,
    propagate,
    push,
    retract,
)
from backend.ekf.readings import (
    ASK,
    ATTITUDE,
    BAROMETER,
    KEEP,
    POSITION,
    RANGE,
    STEP,
    TICK,
    VELOCITY,
    predict,
    step_residual,
)
from backend.ekf.records import REFUSED, SOFTENED, STEPPED, UNABLE, USED, Events, Found, Gates, Log, Tape

_WILD = 4.0
"""A component so many times beyond its gate is refused; one nearer is softened: its noise is taken for as
large as puts it at the gate, for a sensor's tails are often heavier than told."""


@njit(cache=True)
def forward(
    x: Array,
    e: Array,
    C: Array,
    now: float,
    refused_since: Array,
    first: int,
    last: int,
    events: Events,
    about: Array,
    model: Array,
    gates: Gates,
    log: Log,
    found: Found,
    rows: NDArray[np.int64],
    tape: Tape,
) -> tuple[Array, float, int]:
    """Take events ``first`` to ``last``; e, C and ``refused_since`` (kinds, 3) change in place.

    ``about`` (events, STATE) holds the states to linearise about; of no length in the first round.
    Gives the state that e is the error of, the time, and the event at which a figure ceased to be finite,
    or -1.
    """
    n = len(C)
    H, variance, F = np.zeros((6, n)), np.zeros(6), np.zeros((9, 3))
    taping, fixed = len(tape.F) > 0, len(about) > 0
    for k in range(first, last):
        kind, b = events.kind[k], k - first
        dt = events.stamps_s[k] - now
        F[:] = 0.0
        if dt > 0:
            propagate(x, C, dt, model, F)
            push(e, F)
            now = events.stamps_s[k]
        if kind == KEEP:
            _keep(x, e, C)
        if fixed:
            e += difference(x, about[k], n)
            x = about[k].copy()
        if taping:
            tape.dof[b] = 0
        if kind != TICK and kind != ASK and kind != KEEP:
            if not fixed:
                e[:] = 0.0
            innovation, able = _innovation(kind, k, x, events, model, H, variance)
            for i in range(0 if able else 6):
                if math.isfinite(innovation[i]):
                    log.status[k, i] = UNABLE
            if kind == STEP:
                able = able and _gate_step(k, innovation, e, C, H, variance, now, refused_since, gates, log)
            for i in range(6 if able else 0):
                if math.isfinite(innovation[i]):
                    since = refused_since[kind, i:]
                    _take(k, i, kind, innovation[i], e, C, H[i], variance[i], now, since, gates, log, tape, b)
            if not fixed:
                x = retract(x, e)
                e[:] = 0.0
            if not _sound(x, e, C):
                return x, now, k
        if kind == ASK:
            note(found, events.row[k], retract(x, e), C, rows)
        if taping:
            tape.F[b], tape.x[b], tape.C[b] = F, retract(x, e), C
    return x, now, -1


@njit(cache=True)
def _innovation(
    kind: int, k: int, x: Array, events: Events, model: Array, H: Array, variance: Array
) -> tuple[Array, bool]:
    """Reading minus what was expected (6,), NaN where nothing was read, with its rows and white noise.

    A step's are whitened, so that its components are independent like those of all others.
    """
    if kind == STEP:
        residual, able = step_residual(x, events.step[events.row[k]], model, H)
        white = events.step_whitener[events.row[k]]
        H[:] = white @ H
        variance[:] = 1.0
        return white @ residual, able
    expected, able = predict(kind, x, events.value[k], model, H)
    out = np.full(6, np.nan)
    for i in range(3):
        out[i] = events.value[k, i] - expected[i]
        variance[i] = events.std[k, i] ** 2
    return out, able


@njit(cache=True)
def _gate_step(
    k: int,
    innovation: Array,
    e: Array,
    C: Array,
    H: Array,
    variance: Array,
    now: float,
    refused_since: Array,
    gates: Gates,
    log: Log,
) -> bool:
    """Whether to take a step seen in pictures: wrong ones are wrong as a whole. Logged are its components,
    each given those before it, of one that is refused too: it speaks against what foresaw another."""
    S = H @ (C @ np.ascontiguousarray(H.T)) + np.eye(6)
    off = innovation - H @ e
    L = np.linalg.cholesky(S)
    apart = np.linalg.solve(L, off)
    nis = float((apart**2).sum())
    for i in range(6):
        log.innovation[k, i], log.variance[k, i] = apart[i] * L[i, i], L[i, i] ** 2
    if nis <= gates.step:
        refused_since[STEP, 0] = math.inf
        return True
    refused_since[STEP, 0] = min(refused_since[STEP, 0], now)
    variance *= nis / gates.step
    softened = now - refused_since[STEP, 0] >= gates.patience_s
    log.status[k, :] = SOFTENED if softened else REFUSED
    return softened


@njit(cache=True)
def _own_error(kind: int, i: int) -> int:
    """Where the error of an instrument stands that may step; -1 where it has none."""
    if kind == ATTITUDE:
        return ATTITUDE_ERROR + i
    if kind == RANGE:
        return RANGE_BIAS
    if kind == VELOCITY:
        return VEL_ERROR + i
    if kind == BAROMETER:
        return BARO_ZERO
    return GPS_ZERO if kind == POSITION and i == 2 else -1


@njit(cache=True)
def _take(
    k: int,
    i: int,
    kind: int,
    raw: float,
    e: Array,
    C: Array,
    h: Array,
    variance: float,
    now: float,
    refused_since: Array,
    gates: Gates,
    log: Log,
    tape: Tape,
    b: int,
) -> None:
    """Gate one component, then take it in Joseph's form; e and C change in place."""
    n = len(C)
    Ch = np.zeros(n)
    innovation = raw
    for j in range(n):
        if h[j] != 0.0:
            innovation -= h[j] * e[j]
            Ch += h[j] * C[j]
    expected = (h * Ch).sum()
    S = expected + variance
    if kind != STEP:
        log.innovation[k, i], log.variance[k, i] = innovation, S
        log.status[k, i] = USED
        over = innovation * innovation / S / gates.component
        if over <= 1:
            refused_since[0] = math.inf
        else:
            refused_since[0] = min(refused_since[0], now)
            lasting = now - refused_since[0] >= gates.patience_s
            if over > _WILD and not lasting:
                log.status[k, i] = REFUSED
                return
            own = _own_error(kind, i)
            if lasting and own >= 0:
                log.status[k, i] = STEPPED
                C[own, own] += innovation * innovation
                Ch[own] += h[own] * innovation * innovation
                expected += (h[own] * innovation) ** 2
                S = expected + variance
                refused_since[0] = math.inf
            else:
                log.status[k, i] = SOFTENED
                variance += (over - 1) * S
                S = expected + variance
    elif log.status[k, i] != SOFTENED:
        log.status[k, i] = USED
    K = Ch / S
    e += K * innovation
    # (1 - K h) C (1 - K h)' + K variance K', multiplied out.
    for r in range(n):
        gain, c = K[r], S * K[r] - Ch[r]
        for j in range(n):
            C[r, j] += c * K[j] - gain * Ch[j]
    if len(tape.F) > 0:
        m = tape.dof[b]
        tape.H[b, m], tape.K[b, m], tape.S[b, m], tape.innovation[b, m] = h, K, S, innovation
        tape.dof[b] = m + 1


@njit(cache=True)
def note(found: Found, q: int, x: Array, C: Array, rows: NDArray[np.int64]) -> None:
    """Write down state and covariance at an asked time."""
    found.x[q] = x
    for i in range(len(rows)):
        for j in range(len(rows)):
            found.C[q, i, j] = C[rows[i], rows[j]]
    for i in range(len(C)):
        found.std[q, i] = math.sqrt(max(C[i, i], 0.0))


@njit(cache=True)
def _keep(x: Array, e: Array, C: Array) -> None:
    """Keep a copy of the present pose; the one kept before is let go."""
    x[X_KEPT_POS:X_KEPT_ROT], x[X_KEPT_ROT:STATE] = x[:3], x[X_ROT:X_RATE]
    e[KEPT_POS:KEPT_ROT], e[KEPT_ROT:SIZE] = e[POS : POS + 3], e[ROT : ROT + 3]
    C[KEPT_POS:KEPT_ROT], C[KEPT_ROT:SIZE] = C[POS : POS + 3], C[ROT : ROT + 3]
    C[:, KEPT_POS:KEPT_ROT], C[:, KEPT_ROT:SIZE] = C[:, POS : POS + 3], C[:, ROT : ROT + 3]


@njit(cache=True)
def _sound(x: Array, e: Array, C: Array) -> bool:
    if not (np.isfinite(x).all() and np.isfinite(e).all()):
        return False
    for k in range(len(C)):  # noqa: SIM110  a generator is none of the compiler's
        if not 0.0 <= C[k, k] < math.inf:
            return False
    return True
