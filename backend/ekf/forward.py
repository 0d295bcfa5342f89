"""Forward pass of the filter over all events of a flight: numba kernels.

Each component of a reading passes a chi-square gate on its innovation, then updates the state.

In the first round the linearisation point is the current estimate. Since it varies from reading to reading,
the covariance of a product of unknowns (a scale and its factor) is too small. Later rounds are linearised at
the smoothed states of the previous round; the error state then has a mean e.

Source: Bell 1994, "The iterated Kalman smoother as a Gauss-Newton method"; Roumeliotis and Burdick 2002,
"Stochastic cloning".
"""

from __future__ import annotations

import math

from backend.compilation import inlined_kernel, inner_kernel, kernel
from backend.ekf.gates import bias_index, covariances_with, gate_component, gate_visual_step
from backend.ekf.motion import (
    CLONE_POS,
    MOVING,
    POS,
    ROT,
    SIZE,
    STATE,
    X_CLONE_POS,
    X_CLONE_ROT,
    X_ROT,
    apply_transition,
    propagate,
    relinearize,
    retract,
)
from backend.ekf.readings import CLONE, OUTPUT, PROPAGATE, STEP, predict, step_residual
from backend.ekf.records import (
    BIAS_STEPPED,
    INFLATED,
    REJECTED,
    UNPREDICTABLE,
    FilterBuffers,
    FilterInputs,
    FilterOutputs,
    FilterState,
    Gates,
    InnovationLog,
    StateRecords,
    Tape,
)
from backend.ekf.rotations import Array


@kernel
def forward(
    first: int,
    last: int,
    now: float,
    state: FilterState,
    inputs: FilterInputs,
    outputs: FilterOutputs,
    work: FilterBuffers,
) -> tuple[float, int]:
    """Process events ``first`` to ``last``; ``state``, valid at the time ``now``, changes in place.

    Return the time of the last event, and the event after which a value is not finite, or -1.
    """
    x, e, C = state.x, state.e, state.C
    events, linearization, tape = inputs.events, inputs.linearization, outputs.tape
    recording, relinearized = len(tape.F) > 0, len(linearization) > 0
    for k in range(first, last):
        kind, dt = events.kind[k], events.stamps_s[k] - now
        if dt > 0:
            point = linearization[k] if relinearized else x[:0]
            propagate(x, C, dt, inputs.model, point, work.F, work.moved)
            now = events.stamps_s[k]
            if relinearized:
                apply_transition(work.F, e, work.moved)
        if kind == CLONE:
            _clone_pose(x, e, C)
        if relinearized:
            relinearize(x, e, linearization[k])
        if recording:
            tape.dof[k - first] = 0
        if kind != PROPAGATE and kind != OUTPUT and kind != CLONE:
            _process_reading(k, k - first, state, inputs, outputs.log, tape, work)
            if not relinearized:
                retract(x, e, x)
                e[:] = 0.0
            if not _is_finite(x, e, C):
                return now, k
        if kind == OUTPUT:
            record_state(outputs.found, events.row[k], x, e, C)
        if recording:
            _record_event(k - first, dt > 0, state, tape, work.F)
    return now, -1


@inlined_kernel
def _process_reading(
    k: int,
    b: int,
    state: FilterState,
    inputs: FilterInputs,
    log: InnovationLog,
    tape: Tape,
    work: FilterBuffers,
) -> None:
    """Predict the reading of event k, the b-th of its block, gate it, and update with its components."""
    events, gates = inputs.events, inputs.gates
    kind, now = events.kind[k], events.stamps_s[k]
    valid = _predict_reading(k, kind, state.x, inputs, work)
    if not valid:
        for i in range(6):
            if math.isfinite(work.innovation[i]):
                log.status[k, i] = UNPREDICTABLE
    elif kind != STEP or gate_visual_step(k, now, state, gates, log, work):
        for i in range(6):
            if math.isfinite(work.innovation[i]):
                _gate_and_update(k, kind, now, i, b, state, gates, log, tape, work)


@inlined_kernel
def _predict_reading(k: int, kind: int, x: Array, inputs: FilterInputs, work: FilterBuffers) -> bool:
    """Fill in innovation, Jacobian and noise; return whether the reading is predictable in this state.

    A step's components are whitened, so that they are independent like those of other instruments.
    """
    events, innovation, H, variance = inputs.events, work.innovation, work.H, work.variance
    if kind == STEP:
        row = events.row[k]
        variance[:] = 1.0
        valid = step_residual(x, events.step[row], inputs.model, innovation, H)
        _whiten(events.step_whitener[row], innovation, H)
        return valid
    valid = predict(kind, x, events.value[k], inputs.model, innovation, H)
    for i in range(3):
        innovation[i] = events.value[k, i] - innovation[i]
        innovation[3 + i] = math.nan
        variance[i] = events.std[k, i] * events.std[k, i]
    return valid


@inner_kernel
def _whiten(whitener: Array, innovation: Array, H: Array) -> None:
    """Multiply innovations (6,) and Jacobian (6, n) by a lower triangular matrix, in place."""
    for i in range(5, -1, -1):
        innovation[i] *= whitener[i, i]
        for j in range(H.shape[1]):
            H[i, j] *= whitener[i, i]
        for k in range(i):
            innovation[i] += whitener[i, k] * innovation[k]
            for j in range(H.shape[1]):
                H[i, j] += whitener[i, k] * H[k, j]


@inner_kernel
def _gate_and_update(
    k: int,
    kind: int,
    now: float,
    i: int,
    b: int,
    state: FilterState,
    gates: Gates,
    log: InnovationLog,
    tape: Tape,
    work: FilterBuffers,
) -> None:
    """Gate component i of the reading of event k, then update with it."""
    e, C, Ch, h, variance = state.e, state.C, work.Ch, work.H[i], work.variance[i]
    n, expected = len(C), 0.0
    innovation = work.innovation[i] - covariances_with(h, e, C, Ch)
    for j in range(n):
        expected += h[j] * Ch[j]
    S = expected + variance
    if kind != STEP:  # a step is gated as a whole
        log.innovation[k, i], log.variance[k, i] = innovation, S
        nis_ratio = innovation * innovation / S / gates.component
        status = gate_component(kind, i, nis_ratio, now, state.failing_since, gates)
        log.status[k, i] = status
        if status == REJECTED:
            return
        if status == BIAS_STEPPED:
            own = bias_index(kind, i)
            C[own, own] += innovation * innovation
            Ch[own] += h[own] * innovation * innovation
            S += h[own] * h[own] * innovation * innovation
        elif status == INFLATED:
            S += (nis_ratio - 1) * S
    for r in range(n):
        gain = Ch[r] / S
        e[r] += gain * innovation
        for j in range(n):
            C[r, j] -= gain * Ch[j]
    if len(tape.F) > 0:
        m = tape.dof[b]
        tape.S[b, m], tape.innovation[b, m] = S, innovation
        for r in range(n):
            tape.H[b, m, r], tape.K[b, m, r] = h[r], Ch[r] / S
        tape.dof[b] = m + 1


@inner_kernel
def record_state(found: StateRecords, q: int, x: Array, e: Array, C: Array) -> None:
    """Record state, of the error's mean e and covariance C, at a requested time."""
    rows = found.rows
    retract(x, e, found.x[q])
    for i in range(len(rows)):
        for j in range(len(rows)):
            found.C[q, i, j] = C[rows[i], rows[j]]
    for i in range(len(C)):
        found.std[q, i] = math.sqrt(max(C[i, i], 0.0))


@inner_kernel
def _record_event(b: int, moved: bool, state: FilterState, tape: Tape, F: Array) -> None:
    """Record transition and state of the b-th event of a block for the backward pass."""
    retract(state.x, state.e, tape.x[b])
    for i in range(MOVING):
        for j in range(MOVING):
            tape.F[b, i, j] = F[i, j] if moved else 0.0
    for i in range(len(state.C)):
        for j in range(len(state.C)):
            tape.C[b, i, j] = state.C[i, j]


@inner_kernel
def _clone_pose(x: Array, e: Array, C: Array) -> None:
    """Clone the current pose; it replaces the previous clone."""
    for k in range(3):
        x[X_CLONE_POS + k] = x[k]
    for k in range(4):
        x[X_CLONE_ROT + k] = x[X_ROT + k]
    for k in range(6):
        copy, of = CLONE_POS + k, (POS if k < 3 else ROT - 3) + k
        e[copy] = e[of]
        for j in range(SIZE):
            C[copy, j] = C[of, j]
    for k in range(6):
        copy, of = CLONE_POS + k, (POS if k < 3 else ROT - 3) + k
        for j in range(SIZE):
            C[j, copy] = C[j, of]


@inner_kernel
def _is_finite(x: Array, e: Array, C: Array) -> bool:
    total = 0.0
    for k in range(STATE):
        total += x[k]
    for k in range(len(C)):
        total += e[k]
        if not 0.0 <= C[k, k] < math.inf:
            return False
    return math.isfinite(total)
