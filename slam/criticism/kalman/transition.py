"""One step of the filter between two events, compiled: mean, transition matrix and process noise.

The equations are the simulator's own ``derivative``. The noises are linear and discretised exactly:
Ornstein-Uhlenbeck processes, and for the velocity one more pole behind them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.compiled import kernel
from slam.criticism.kalman.readings import BEFORE, BEHIND, GUST, MOVING, STATES_WITH_GUSTS, TARGET
from slam.simulation.dynamics import ROTOR_RADIUS, derivative

Array = NDArray[np.float64]

HOLD = (
    "tilt_std_rad", "tilt_time_s", "yaw_rate_std_rad_s", "yaw_rate_time_s",
    "velocity_std_m_s", "velocity_time_s", "velocity_up_std_m_s", "pole_s", "gust_std_m_s", "gust_time_s",
)  # fmt: skip
"""Entries of the hold noise's vector."""
(TILT_STD, TILT_TIME, TURN_STD, TURN_TIME, W_STD, W_TIME, W_UP_STD, POLE, GUST_STD, GUST_TIME) = range(10)

HIGH_M = 2.0
"""Above this nothing depends on the height but what has a rotor radius."""
_NUDGE = 1e-6
"""Step of the differences that make the Jacobian: the equations are smooth and in SI."""


@kernel
def spread(state: Array, full: Array, noise: Array) -> None:
    """State of the filter to the state and noise that ``derivative`` takes."""
    for i in range(MOVING):
        full[i] = state[i]
    full[10], full[11] = state[0], state[1]
    for i in range(3):
        noise[i] = state[TARGET + i]
        noise[3 + i] = state[BEHIND + i]
    noise[6] = state[GUST] if state.shape[0] > GUST else 0.0
    noise[7] = state[GUST + 1] if state.shape[0] > GUST else 0.0


@kernel
def jacobian(state: Array, command: Array, parameters: Array, rate: Array, matrix: Array) -> None:
    """Rate (12,) and its Jacobian (10, n) in the filter's state, by differences.

    Entries that push different rates are nudged together. Columns of o are 0: they act through w.
    """
    n = state.shape[0]
    full, noise, beside = np.empty(12), np.empty(8), np.empty(12)
    spread(state, full, noise)
    derivative(full, command, noise, parameters, rate)
    matrix[:] = 0.0
    for j in range(2, 9):
        if j == 2 and state[2] > HIGH_M and parameters[ROTOR_RADIUS] == 0.0:
            continue
        full[j] += _NUDGE
        if j == 5:
            full[9] += _NUDGE
        derivative(full, command, noise, parameters, beside)
        for i in range(MOVING):
            matrix[i, j] = (beside[i] - rate[i]) / _NUDGE
        full[j] = state[j]
        if j == 5:
            full[9] = state[9]
            matrix[8, 9], matrix[9, 9] = matrix[8, 5], matrix[9, 5]
            matrix[8, 5] = matrix[9, 5] = 0.0
    for i in range(6):
        noise[i] += _NUDGE
    derivative(full, command, noise, parameters, beside)
    matrix[6, TARGET] = (beside[6] - rate[6]) / _NUDGE
    matrix[7, TARGET + 1] = (beside[7] - rate[7]) / _NUDGE
    matrix[9, TARGET + 2] = (beside[9] - rate[9]) / _NUDGE
    for i in range(3):
        matrix[i, BEHIND + i] = (beside[i] - rate[i]) / _NUDGE
        matrix[3 + i, BEHIND + i] = (beside[3 + i] - rate[3 + i]) / _NUDGE
        noise[i], noise[3 + i] = state[TARGET + i], state[BEHIND + i]
    for j in range(GUST, n):
        noise[6 + j - GUST] += _NUDGE
        derivative(full, command, noise, parameters, beside)
        for i in range(MOVING):
            matrix[i, j] = (beside[i] - rate[i]) / _NUDGE
        noise[6 + j - GUST] = state[j]


@kernel
def decay(hold: Array, h: float, matrix: Array) -> None:
    """Rows of the noises in the transition matrix over h, exact."""
    for i in range(TARGET, matrix.shape[0]):
        matrix[i, :] = 0.0
    for i in range(3):
        time = hold[TILT_TIME] if i < 2 else hold[TURN_TIME]
        matrix[TARGET + i, TARGET + i] = math.exp(-h / time)
        before, behind = math.exp(-h / hold[W_TIME]), math.exp(-h / hold[POLE])
        matrix[BEFORE + i, BEFORE + i] = before
        matrix[BEHIND + i, BEHIND + i] = behind
        matrix[BEHIND + i, BEFORE + i] = (before - behind) * hold[W_TIME] / (hold[W_TIME] - hold[POLE])
    for i in range(GUST, matrix.shape[0]):
        matrix[i, i] = math.exp(-h / hold[GUST_TIME])


@kernel
def stationary(hold: Array, axis: int) -> tuple[float, float]:
    """Variance of o, and of w (which is also their covariance), on an axis."""
    std = hold[W_UP_STD] if axis == 2 else hold[W_STD]
    return std * std * (hold[W_TIME] + hold[POLE]) / hold[W_TIME], std * std


@kernel
def kicks(hold: Array, matrix: Array, q: Array) -> None:
    """Process noise (n, n) of the noises over a step: what keeps them stationary under ``matrix``."""
    q[:] = 0.0
    for i in range(3):
        std = hold[TILT_STD] if i < 2 else hold[TURN_STD]
        k = matrix[TARGET + i, TARGET + i]
        q[TARGET + i, TARGET + i] = std * std * (1.0 - k * k)
        o, w = BEFORE + i, BEHIND + i
        v_o, v_w = stationary(hold, i)
        a, b, c = matrix[o, o], matrix[w, w], matrix[w, o]
        q[o, o] = v_o * (1.0 - a * a)
        q[o, w] = q[w, o] = v_w - a * (c * v_o + b * v_w)
        q[w, w] = v_w - (c * c * v_o + 2.0 * b * c * v_w + b * b * v_w)
    for i in range(GUST, matrix.shape[0]):
        q[i, i] = hold[GUST_STD] ** 2 * (1.0 - matrix[i, i] ** 2)


@kernel
def transition(slopes: Array, hold: Array, h: float, matrix: Array) -> None:
    """Transition matrix (n, n) over h: exact in the noises, to second order of ``slopes`` (10, n) in the
    rest."""
    n = matrix.shape[0]
    decay(hold, h, matrix)
    for i in range(MOVING):
        for j in range(n):
            matrix[i, j] = h * slopes[i, j]
        matrix[i, i] += 1.0
        for k in range(MOVING):
            x = 0.5 * h * h * slopes[i, k]
            if x != 0.0:
                for j in range(n):
                    matrix[i, j] += x * slopes[k, j]
        for k in range(TARGET, n):
            if slopes[i, k] == 0.0:
                continue
            # The mean of a noise over the step: half its beginning, half its end.
            x = 0.5 * h * slopes[i, k]
            matrix[i, k] -= x
            for j in range(TARGET, n):
                matrix[i, j] += x * matrix[k, j]


@kernel
def covariance_step(matrix: Array, q: Array, slopes: Array, h: float, p: Array, work: Array) -> None:
    """P <- F P F' + L Q L', in place; L hands half a step of the noises' kicks to what they push."""
    n = p.shape[0]
    index = np.empty((n, n), dtype=np.int64)
    count = np.zeros(n, dtype=np.int64)
    for i in range(n):
        for j in range(n):
            if matrix[i, j] != 0.0:
                index[i, count[i]] = j
                count[i] += 1
    for i in range(n):
        for j in range(n):
            work[i, j] = 0.0
        for a in range(count[i]):
            k = index[i, a]
            x = matrix[i, k]
            for j in range(n):
                work[i, j] += x * p[k, j]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for a in range(count[j]):
                k = index[j, a]
                total += work[i, k] * matrix[j, k]
            p[i, j] = total
    for k in range(TARGET, n):
        for j in range(TARGET, n):
            x = q[k, j]
            if x == 0.0:
                continue
            if k >= j:
                p[k, j] += x
            for i in range(MOVING):
                if slopes[i, k] != 0.0:
                    s = 0.5 * h * slopes[i, k]
                    p[j, i] += s * x
                    for m in range(i + 1):
                        if slopes[m, j] != 0.0:
                            p[i, m] += s * x * 0.5 * h * slopes[m, j]
    for i in range(n):
        for j in range(i):
            p[j, i] = p[i, j]


@kernel
def mean_step(
    state: Array,
    command: Array,
    hold: Array,
    matrix: Array,
    parameters: Array,
    h: float,
    first: Array,
    middle: Array,
    middle_noise: Array,
) -> None:
    """RK4 over h with the noises' exact decay, in place. ``first`` (12,) is the rate at the beginning;
    ``middle`` (12,) and ``middle_noise`` (8,) receive the state and noise half-way."""
    n = state.shape[0]
    full, noise, ended, rate = np.empty(12), np.empty(8), np.empty(8), np.empty(12)
    total, after = np.empty(12), np.empty(STATES_WITH_GUSTS)
    spread(state, full, noise)
    for i in range(TARGET, n):
        after[i] = 0.0
        for j in range(TARGET, n):
            after[i] += matrix[i, j] * state[j]
    for i in range(3):
        ended[i], ended[3 + i] = after[TARGET + i], after[BEHIND + i]
    ended[6] = after[GUST] if n > GUST else 0.0
    ended[7] = after[GUST + 1] if n > GUST else 0.0
    for i in range(8):
        middle_noise[i] = 0.5 * (noise[i] + ended[i])
    for i in range(12):
        total[i] = first[i]
        middle[i] = full[i] + 0.5 * h * first[i]
    derivative(middle, command, middle_noise, parameters, rate)
    for i in range(12):
        total[i] += 2.0 * rate[i]
        middle[i] = full[i] + 0.5 * h * rate[i]
    derivative(middle, command, middle_noise, parameters, rate)
    for i in range(12):
        total[i] += 2.0 * rate[i]
        full[i] += h * rate[i]
    derivative(full, command, ended, parameters, rate)
    for i in range(MOVING):
        state[i] += h / 6.0 * (total[i] + rate[i])
    for i in range(TARGET, n):
        state[i] = after[i]
