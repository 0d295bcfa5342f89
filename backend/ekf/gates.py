"""Chi-square gates on innovations: numba kernels.

A component is rejected, or its noise is inflated, or the instrument's bias makes a step.
"""

from __future__ import annotations

import math

from backend.compilation import inner_kernel
from backend.ekf.motion import ATTITUDE_ERROR, BARO_ZERO, GPS_ZERO, RANGE_BIAS, VEL_ERROR
from backend.ekf.readings import ATTITUDE, BAROMETER, POSITION, RANGE, STEP, VELOCITY
from backend.ekf.records import (
    BIAS_STEPPED,
    INFLATED,
    REJECTED,
    USED,
    FilterBuffers,
    FilterState,
    Gates,
    InnovationLog,
)
from backend.ekf.rotations import Array

_REJECT_FACTOR = 4.0
"""A component whose squared innovation exceeds this multiple of its gate is rejected. For a smaller excess
its noise is inflated until it lies on the gate, since sensors often have heavy tails."""


@inner_kernel
def covariances_with(h: Array, e: Array, C: Array, Ch: Array) -> float:
    """Write ``C h`` into Ch (n,), and return ``h' e``; most of h (n,) is zero."""
    n, mean = len(C), 0.0
    for j in range(n):
        Ch[j] = 0.0
    for j in range(n):
        if h[j] != 0.0:
            mean += h[j] * e[j]
            for r in range(n):
                Ch[r] += h[j] * C[j, r]
    return mean


@inner_kernel
def gate_visual_step(
    k: int, now: float, state: FilterState, gates: Gates, log: InnovationLog, work: FilterBuffers
) -> bool:
    """Apply the chi-square gate to the 6-vector of a visual step; return whether to use it.

    Innovations, each conditioned on the previous ones, are logged for a rejected step too: they are evidence
    about the model. A step that fails the gate for too long is used with inflated noise.
    """
    H, L, failing_since = work.H, work.L, state.failing_since
    nis = 0.0
    for i in range(6):
        # Row i of the innovations' covariance, of its Cholesky factor L, and of the whitened innovations.
        miss = work.innovation[i] - covariances_with(H[i], state.e, state.C, work.Ch)
        for j in range(i + 1):
            total = 1.0 if i == j else 0.0
            for r in range(len(work.Ch)):
                total += work.Ch[r] * H[j, r]
            for m in range(j):
                total -= L[i, m] * L[j, m]
            L[i, j] = total / L[j, j] if j < i else math.sqrt(total)
        for j in range(i):
            miss -= L[i, j] * L[j, 6]
        L[i, 6] = miss / L[i, i]
        nis += L[i, 6] * L[i, 6]
        log.innovation[k, i], log.variance[k, i] = miss, L[i, i] * L[i, i]
    status = USED
    if nis <= gates.step:
        failing_since[STEP, 0] = math.inf
    else:
        failing_since[STEP, 0] = min(failing_since[STEP, 0], now)
        status = INFLATED if now - failing_since[STEP, 0] >= gates.patience_s else REJECTED
        for i in range(6):
            work.variance[i] *= nis / gates.step
    log.status[k, :] = status
    return bool(status != REJECTED)


@inner_kernel
def gate_component(
    kind: int, i: int, nis_ratio: float, now: float, failing_since: Array, gates: Gates
) -> int:
    """Apply the gate to one component, with ``nis_ratio`` its NIS over the gate; return its status."""
    if nis_ratio <= 1:
        failing_since[kind, i] = math.inf
        return USED
    failing_since[kind, i] = min(failing_since[kind, i], now)
    persistent = now - failing_since[kind, i] >= gates.patience_s
    if persistent and bias_index(kind, i) >= 0:
        failing_since[kind, i] = math.inf
        return BIAS_STEPPED
    return INFLATED if persistent or nis_ratio <= _REJECT_FACTOR else REJECTED


@inner_kernel
def bias_index(kind: int, i: int) -> int:
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
