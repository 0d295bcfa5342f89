"""The filter's pass forward over all events of a flight: kernels.

Each component of a reading passes a chi-square gate on its innovation, then updates in Joseph's form.

In the first round the linearisation point is the current estimate. Since that varies from reading to reading,
the covariance of a product of unknowns (a scale and what it multiplies) comes out too small. Further rounds
are linearised about the smoothed states of the round before; the error state then has a mean e.

Source: Bucy and Joseph 1968 (Joseph's form); Bell 1994, "The iterated Kalman smoother as a Gauss-Newton
method"; Roumeliotis and Burdick 2002, "Stochastic cloning" (the kept pose).
"""

from __future__ import annotations

import math

import numpy as np

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
from backend.ekf.records import (
    REFUSED,
    SOFTENED,
    STEPPED,
    UNABLE,
    USED,
    FilterInputs,
    FilterOutputs,
    FilterState,
    Gates,
    InnovationLog,
    LinearizedReading,
    StateRecords,
    Tape,
)
from backend.numba_cache import njit

_WILD = 4.0
"""A component whose squared innovation is more than so many times its gate is refused; a smaller one is
softened: its noise is inflated until it lies on the gate, since sensors often have heavy tails."""


@njit(cache=True)
def forward(
    first: int, last: int, now: float, state: FilterState, given: FilterInputs, written: FilterOutputs
) -> tuple[float, int]:
    """Take events ``first`` to ``last``; ``state``, which is that at the time ``now``, changes in place.

    Gives the time of the last event, and the event at which a figure ceased to be finite, or -1.
    """
    x, e, C = state.x, state.e, state.C
    events, about, log, tape = given.events, given.about, written.log, written.tape
    n = len(C)
    innovation, H, variance, F = np.zeros(6), np.zeros((6, n)), np.zeros(6), np.zeros((9, 3))
    taping, fixed = len(tape.F) > 0, len(about) > 0
    for k in range(first, last):
        kind, b = events.kind[k], k - first
        dt = events.stamps_s[k] - now
        F[:] = 0.0
        if dt > 0:
            propagate(x, C, dt, given.model, F)
            push(e, F)
            now = events.stamps_s[k]
        if kind == KEEP:
            _keep(x, e, C)
        if fixed:
            e += difference(x, about[k], n)
            x[:] = about[k]
        if taping:
            tape.dof[b] = 0
        if kind != TICK and kind != ASK and kind != KEEP:
            if not fixed:
                e[:] = 0.0
            reading = LinearizedReading(k, b, kind, now, innovation, H, variance)
            able = _read(reading, x, given)
            if able and (kind != STEP or _gate_step(reading, state, given.gates, log)):
                for i in range(6):
                    if math.isfinite(innovation[i]):
                        _take(i, reading, state, given.gates, log, tape)
            elif not able:
                for i in range(6):
                    if math.isfinite(innovation[i]):
                        log.status[k, i] = UNABLE
            if not fixed:
                x[:] = retract(x, e)
                e[:] = 0.0
            if not _sound(x, e, C):
                return now, k
        if kind == ASK:
            note(written.found, events.row[k], retract(x, e), C)
        if taping:
            tape.F[b], tape.x[b], tape.C[b] = F, retract(x, e), C
    return now, -1


@njit(cache=True)
def _read(reading: LinearizedReading, x: Array, given: FilterInputs) -> bool:
    """Fill in innovation, derivatives and noise; whether the instrument can read in this state.

    A step's components are whitened, so that they are independent like those of all others.
    """
    events, H, k = given.events, reading.H, reading.event
    if reading.kind == STEP:
        residual, able = step_residual(x, events.step[events.row[k]], given.model, H)
        white = events.step_whitener[events.row[k]]
        H[:] = white @ H
        reading.variance[:] = 1.0
        reading.innovation[:] = white @ residual
        return able
    expected, able = predict(reading.kind, x, events.value[k], given.model, H)
    reading.innovation[:] = np.nan
    for i in range(3):
        reading.innovation[i] = events.value[k, i] - expected[i]
        reading.variance[i] = events.std[k, i] ** 2
    return able


@njit(cache=True)
def _gate_step(reading: LinearizedReading, state: FilterState, gates: Gates, log: InnovationLog) -> bool:
    """Chi-square gate on a picture step's whole 6-vector; whether to take it.

    Logs the innovations, each conditioned on those before it, of a rejected step too: it is evidence on the
    model that predicted another. A step that is softened has its noise inflated.
    """
    k, now, H, refused_since = reading.event, reading.now_s, reading.H, state.refused_since
    S = H @ (state.C @ np.ascontiguousarray(H.T)) + np.eye(6)
    off = reading.innovation - H @ state.e
    L = np.linalg.cholesky(S)
    apart = np.linalg.solve(L, off)
    nis = float((apart**2).sum())
    for i in range(6):
        log.innovation[k, i], log.variance[k, i] = apart[i] * L[i, i], L[i, i] ** 2
    if nis <= gates.step:
        refused_since[STEP, 0] = math.inf
        log.status[k, :] = USED
        return True
    refused_since[STEP, 0] = min(refused_since[STEP, 0], now)
    reading.variance[:] *= nis / gates.step
    softened = now - refused_since[STEP, 0] >= gates.patience_s
    log.status[k, :] = SOFTENED if softened else REFUSED
    return softened


@njit(cache=True)
def _gate(kind: int, i: int, over: float, now: float, refused_since: Array, gates: Gates) -> int:
    """Chi-square gate on one component; ``over`` is its NIS in gates. Gives its status."""
    if over <= 1:
        refused_since[kind, i] = math.inf
        return USED
    refused_since[kind, i] = min(refused_since[kind, i], now)
    lasting = now - refused_since[kind, i] >= gates.patience_s
    if lasting and _own_error(kind, i) >= 0:
        refused_since[kind, i] = math.inf
        return STEPPED
    return SOFTENED if lasting or over <= _WILD else REFUSED


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
    i: int, reading: LinearizedReading, state: FilterState, gates: Gates, log: InnovationLog, tape: Tape
) -> None:
    """Gate component i of a reading, then take it."""
    k, kind, b = reading.event, reading.kind, reading.taped
    e, C, h, variance = state.e, state.C, reading.H[i], reading.variance[i]
    innovation, Ch = reading.innovation[i], np.zeros(len(C))
    for j in range(len(C)):
        if h[j] != 0.0:
            innovation -= h[j] * e[j]
            Ch += h[j] * C[j]
    expected = (h * Ch).sum()
    S = expected + variance
    if kind != STEP:  # that one was gated as a whole
        log.innovation[k, i], log.variance[k, i] = innovation, S
        over = innovation * innovation / S / gates.component
        status = _gate(kind, i, over, reading.now_s, state.refused_since, gates)
        log.status[k, i] = status
        if status == REFUSED:
            return
        if status == STEPPED:
            own = _own_error(kind, i)
            C[own, own] += innovation * innovation
            Ch[own] += h[own] * innovation * innovation
            S = expected + (h[own] * innovation) ** 2 + variance
        elif status == SOFTENED:
            S = expected + (variance + (over - 1) * S)
    K = Ch / S
    _update(e, C, K, Ch, S, innovation)
    if len(tape.F) > 0:
        m = tape.dof[b]
        tape.H[b, m], tape.K[b, m], tape.S[b, m], tape.innovation[b, m] = h, K, S, innovation
        tape.dof[b] = m + 1


@njit(cache=True)
def _update(e: Array, C: Array, K: Array, Ch: Array, S: float, innovation: float) -> None:
    """Kalman update by one component with gain K and innovation variance S; e and C change in place."""
    e += K * innovation
    # Joseph's form (1 - K h) C (1 - K h)' + K variance K', multiplied out.
    for r in range(len(C)):
        gain, c = K[r], S * K[r] - Ch[r]
        for j in range(len(C)):
            C[r, j] += c * K[j] - gain * Ch[j]


@njit(cache=True)
def note(found: StateRecords, q: int, x: Array, C: Array) -> None:
    """Write down state and covariance at an asked time."""
    rows = found.rows
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
