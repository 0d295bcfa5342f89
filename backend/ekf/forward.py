"""Forward pass of the filter over all events of a flight: numba kernels.

Each component of a reading passes a chi-square gate on its innovation, then updates in Joseph's form.

In the first round the linearisation point is the current estimate. Since it varies from reading to reading,
the covariance of a product of unknowns (a scale and its factor) is too small. Later rounds are linearised at
the smoothed states of the previous round; the error state then has a mean e.

Source: Bucy and Joseph 1968 (Joseph's form); Bell 1994, "The iterated Kalman smoother as a Gauss-Newton
method"; Roumeliotis and Burdick 2002, "Stochastic cloning".
"""

from __future__ import annotations

import math

import numpy as np

from backend.ekf.motion import (
    ATTITUDE_ERROR,
    BARO_ZERO,
    CLONE_POS,
    CLONE_ROT,
    GPS_ZERO,
    POS,
    RANGE_BIAS,
    ROT,
    SIZE,
    STATE,
    VEL_ERROR,
    X_CLONE_POS,
    X_CLONE_ROT,
    X_RATE,
    X_ROT,
    Array,
    apply_transition,
    difference,
    propagate,
    retract,
)
from backend.ekf.readings import (
    ATTITUDE,
    BAROMETER,
    CLONE,
    OUTPUT,
    POSITION,
    PROPAGATE,
    RANGE,
    STEP,
    VELOCITY,
    predict,
    step_residual,
)
from backend.ekf.records import (
    BIAS_STEPPED,
    INFLATED,
    REJECTED,
    UNPREDICTABLE,
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

_REJECT_FACTOR = 4.0
"""A component whose squared innovation exceeds this multiple of its gate is rejected. For a smaller excess
its noise is inflated until it lies on the gate, since sensors often have heavy tails."""


@njit(cache=True)
def forward(
    first: int, last: int, now: float, state: FilterState, inputs: FilterInputs, outputs: FilterOutputs
) -> tuple[float, int]:
    """Process events ``first`` to ``last``; ``state``, valid at the time ``now``, changes in place.

    Return the time of the last event, and the event after which a value is not finite, or -1.
    """
    x, e, C = state.x, state.e, state.C
    events, linearization, log, tape = inputs.events, inputs.linearization, outputs.log, outputs.tape
    n = len(C)
    innovation, H, variance, F = np.zeros(6), np.zeros((6, n)), np.zeros(6), np.zeros((9, 3))
    recording, relinearized = len(tape.F) > 0, len(linearization) > 0
    for k in range(first, last):
        kind, b = events.kind[k], k - first
        dt = events.stamps_s[k] - now
        F[:] = 0.0
        if dt > 0:
            propagate(x, C, dt, inputs.model, F)
            apply_transition(e, F)
            now = events.stamps_s[k]
        if kind == CLONE:
            _clone_pose(x, e, C)
        if relinearized:
            e += difference(x, linearization[k], n)
            x[:] = linearization[k]
        if recording:
            tape.dof[b] = 0
        if kind != PROPAGATE and kind != OUTPUT and kind != CLONE:
            if not relinearized:
                e[:] = 0.0
            reading = LinearizedReading(k, b, kind, now, innovation, H, variance)
            valid = _predict_reading(reading, x, inputs)
            if valid and (kind != STEP or _gate_visual_step(reading, state, inputs.gates, log)):
                for i in range(6):
                    if math.isfinite(innovation[i]):
                        _gate_and_update(i, reading, state, inputs.gates, log, tape)
            elif not valid:
                for i in range(6):
                    if math.isfinite(innovation[i]):
                        log.status[k, i] = UNPREDICTABLE
            if not relinearized:
                x[:] = retract(x, e)
                e[:] = 0.0
            if not _is_finite(x, e, C):
                return now, k
        if kind == OUTPUT:
            record_state(outputs.found, events.row[k], retract(x, e), C)
        if recording:
            tape.F[b], tape.x[b], tape.C[b] = F, retract(x, e), C
    return now, -1


@njit(cache=True)
def _predict_reading(reading: LinearizedReading, x: Array, inputs: FilterInputs) -> bool:
    """Fill in innovation, Jacobian and noise; return whether the reading is predictable in this state.

    A step's components are whitened, so that they are independent like those of other instruments.
    """
    events, H, k = inputs.events, reading.H, reading.event
    if reading.kind == STEP:
        residual, valid = step_residual(x, events.step[events.row[k]], inputs.model, H)
        white = events.step_whitener[events.row[k]]
        H[:] = white @ H
        reading.variance[:] = 1.0
        reading.innovation[:] = white @ residual
        return valid
    expected, valid = predict(reading.kind, x, events.value[k], inputs.model, H)
    reading.innovation[:] = np.nan
    for i in range(3):
        reading.innovation[i] = events.value[k, i] - expected[i]
        reading.variance[i] = events.std[k, i] ** 2
    return valid


@njit(cache=True)
def _gate_visual_step(
    reading: LinearizedReading, state: FilterState, gates: Gates, log: InnovationLog
) -> bool:
    """Apply the chi-square gate to the 6-vector of a visual step; return whether to use it.

    Innovations, each conditioned on the previous ones, are logged for a rejected step too: they are evidence
    about the model. A step that fails the gate for too long is used with inflated noise.
    """
    k, now, H, failing_since = reading.event, reading.now_s, reading.H, state.failing_since
    S = H @ (state.C @ np.ascontiguousarray(H.T)) + np.eye(6)
    off = reading.innovation - H @ state.e
    L = np.linalg.cholesky(S)
    apart = np.linalg.solve(L, off)
    nis = float((apart**2).sum())
    for i in range(6):
        log.innovation[k, i], log.variance[k, i] = apart[i] * L[i, i], L[i, i] ** 2
    if nis <= gates.step:
        failing_since[STEP, 0] = math.inf
        log.status[k, :] = USED
        return True
    failing_since[STEP, 0] = min(failing_since[STEP, 0], now)
    reading.variance[:] *= nis / gates.step
    inflated = now - failing_since[STEP, 0] >= gates.patience_s
    log.status[k, :] = INFLATED if inflated else REJECTED
    return bool(inflated)


@njit(cache=True)
def _gate_component(
    kind: int, i: int, nis_ratio: float, now: float, failing_since: Array, gates: Gates
) -> int:
    """Apply the gate to one component, with ``nis_ratio`` its NIS over the gate; return its status."""
    if nis_ratio <= 1:
        failing_since[kind, i] = math.inf
        return USED
    failing_since[kind, i] = min(failing_since[kind, i], now)
    persistent = now - failing_since[kind, i] >= gates.patience_s
    if persistent and _bias_index(kind, i) >= 0:
        failing_since[kind, i] = math.inf
        return BIAS_STEPPED
    return INFLATED if persistent or nis_ratio <= _REJECT_FACTOR else REJECTED


@njit(cache=True)
def _bias_index(kind: int, i: int) -> int:
    """Return the index of the instrument's bias that may step; -1 if it has none."""
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
def _gate_and_update(
    i: int, reading: LinearizedReading, state: FilterState, gates: Gates, log: InnovationLog, tape: Tape
) -> None:
    """Gate component i of a reading, then update with it."""
    k, kind, b = reading.event, reading.kind, reading.tape_row
    e, C, h, variance = state.e, state.C, reading.H[i], reading.variance[i]
    innovation, Ch = reading.innovation[i], np.zeros(len(C))
    for j in range(len(C)):
        if h[j] != 0.0:
            innovation -= h[j] * e[j]
            Ch += h[j] * C[j]
    expected = (h * Ch).sum()
    S = expected + variance
    if kind != STEP:  # a step is gated as a whole
        log.innovation[k, i], log.variance[k, i] = innovation, S
        nis_ratio = innovation * innovation / S / gates.component
        status = _gate_component(kind, i, nis_ratio, reading.now_s, state.failing_since, gates)
        log.status[k, i] = status
        if status == REJECTED:
            return
        if status == BIAS_STEPPED:
            own = _bias_index(kind, i)
            C[own, own] += innovation * innovation
            Ch[own] += h[own] * innovation * innovation
            S = expected + (h[own] * innovation) ** 2 + variance
        elif status == INFLATED:
            S = expected + (variance + (nis_ratio - 1) * S)
    K = Ch / S
    _update(e, C, K, Ch, S, innovation)
    if len(tape.F) > 0:
        m = tape.dof[b]
        tape.H[b, m], tape.K[b, m], tape.S[b, m], tape.innovation[b, m] = h, K, S, innovation
        tape.dof[b] = m + 1


@njit(cache=True)
def _update(e: Array, C: Array, K: Array, Ch: Array, S: float, innovation: float) -> None:
    """Update e and C in place by one component with gain K and innovation variance S."""
    e += K * innovation
    # Joseph's form (1 - K h) C (1 - K h)' + K variance K', multiplied out.
    for r in range(len(C)):
        gain, c = K[r], S * K[r] - Ch[r]
        for j in range(len(C)):
            C[r, j] += c * K[j] - gain * Ch[j]


@njit(cache=True)
def record_state(found: StateRecords, q: int, x: Array, C: Array) -> None:
    """Record state and covariance at a requested time."""
    rows = found.rows
    found.x[q] = x
    for i in range(len(rows)):
        for j in range(len(rows)):
            found.C[q, i, j] = C[rows[i], rows[j]]
    for i in range(len(C)):
        found.std[q, i] = math.sqrt(max(C[i, i], 0.0))


@njit(cache=True)
def _clone_pose(x: Array, e: Array, C: Array) -> None:
    """Clone the current pose; it replaces the previous clone."""
    x[X_CLONE_POS:X_CLONE_ROT], x[X_CLONE_ROT:STATE] = x[:3], x[X_ROT:X_RATE]
    e[CLONE_POS:CLONE_ROT], e[CLONE_ROT:SIZE] = e[POS : POS + 3], e[ROT : ROT + 3]
    C[CLONE_POS:CLONE_ROT], C[CLONE_ROT:SIZE] = C[POS : POS + 3], C[ROT : ROT + 3]
    C[:, CLONE_POS:CLONE_ROT], C[:, CLONE_ROT:SIZE] = C[:, POS : POS + 3], C[:, ROT : ROT + 3]


@njit(cache=True)
def _is_finite(x: Array, e: Array, C: Array) -> bool:
    if not (np.isfinite(x).all() and np.isfinite(e).all()):
        return False
    for k in range(len(C)):  # noqa: SIM110  a generator is none of the compiler's
        if not 0.0 <= C[k, k] < math.inf:
            return False
    return True
