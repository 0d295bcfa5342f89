"""One compiled step of the filter between two events: mean, transition matrix and process noise.

The equations are the simulator's own ``derivative``. The noises are linear and discretised exactly. They are
Ornstein-Uhlenbeck processes; that of the velocity passes through one more pole.
"""

from __future__ import annotations

import math

from backend.compilation import inner_kernel, kernel
from slam.core.arrays import Array
from slam.criticism.kalman.arrays import ModelArrays, Scratch, StepBuffers
from slam.criticism.kalman.readings import AR1, BEFORE, BEHIND, GUST, MOVING, TARGET
from slam.simulation.dynamics import (
    FADE,
    GEAR,
    GUST_X,
    GUST_Y,
    HOLD_X,
    HOLD_Y,
    NOISE,
    PITCH,
    ROLL,
    ROLL_NOISE,
    ROTOR_RADIUS,
    SMALL_ANGLE,
    STATE,
    VX,
    VY,
    VZ,
    WX,
    YAW,
    YAW_RATE,
    X,
    Y,
    Z,
    derivative,
    rates,
    thrust,
)

HOLD = (
    "tilt_std_rad", "tilt_time_s", "yaw_rate_std_rad_s", "yaw_rate_time_s",
    "velocity_std_m_s", "velocity_time_s", "velocity_up_std_m_s", "pole_s", "gust_std_m_s", "gust_time_s",
)  # fmt: skip
"""Entries of the hold noise's vector."""
(TILT_STD, TILT_TIME, TURN_STD, TURN_TIME, W_STD, W_TIME, W_UP_STD, POLE, GUST_STD, GUST_TIME) = range(10)

FULL, NOISES = len(STATE), len(NOISE)
"""Entries of the state and the noise that the equations take."""
CLEAR_M = 0.2
"""This far above the floor's influence only terms with a rotor radius depend on the height."""
NEARLY = 1e-4
"""Two time constants with a smaller relative difference count as equal."""
NUDGE = 1e-6
"""Step of the differences that make the Jacobian: the equations are smooth and in SI."""


@inner_kernel
def split_state(state: Array, full: Array, noise: Array) -> None:
    """Split the filter's state into the state and the noise that ``derivative`` takes."""
    for i in range(MOVING):
        full[i] = state[i]
    full[HOLD_X], full[HOLD_Y] = state[X], state[Y]
    for i in range(3):
        noise[ROLL_NOISE + i] = state[TARGET + i]
        noise[WX + i] = state[BEHIND + i]
    noise[GUST_X] = state[GUST] if state.shape[0] > GUST else 0.0
    noise[GUST_Y] = state[GUST + 1] if state.shape[0] > GUST else 0.0


@inner_kernel
def _thrust_slopes(pitch: float, ahead: float, aside: float, parameters: Array) -> tuple[float, float, float]:
    """Return the derivatives of the thrust to the side by roll, and of that ahead and aside by pitch."""
    if parameters[SMALL_ANGLE] >= 0.5:
        return -1.0, 1.0, 0.0
    cosine = math.cos(pitch)
    return -(1.0 / cosine + aside * aside * cosine), 1.0 + ahead * ahead, aside * ahead


@kernel
def jacobian(
    state: Array, command: Array, parameters: Array, rate: Array, matrix: Array, scratch: Scratch
) -> None:
    """Write the rate (12,) and its Jacobian (10, n) in the filter's state, by finite differences.

    Entries that change different rates are nudged together. The changes of sines and tangents follow from
    their derivatives. The columns of o are 0, since o acts through w.
    """
    n = state.shape[0]
    full, noise, beside = scratch.full, scratch.noise, scratch.nudged_rate
    split_state(state, full, noise)
    c, s = math.cos(state[YAW]), math.sin(state[YAW])
    ahead, aside = thrust(state[ROLL], state[PITCH], parameters)
    rates(full, c, s, ahead, aside, command, noise, parameters, rate)
    matrix[:] = 0.0
    by_roll, ahead_by_pitch, aside_by_pitch = _thrust_slopes(state[PITCH], ahead, aside, parameters)
    clear = state[Z] > parameters[GEAR] + parameters[FADE] + CLEAR_M and parameters[ROTOR_RADIUS] == 0.0
    for j in (Z, VX, VY, ROLL, PITCH, YAW):
        if j == Z and clear:
            continue
        full[j] += NUDGE
        turned_c, turned_s, tilted_ahead, tilted_aside = c, s, ahead, aside
        if j == VX:
            full[VZ] += NUDGE
            full[YAW_RATE] += NUDGE
        elif j == ROLL:
            tilted_aside += by_roll * NUDGE
        elif j == PITCH:
            tilted_ahead += ahead_by_pitch * NUDGE
            tilted_aside += aside_by_pitch * NUDGE
        elif j == YAW:
            turned_c, turned_s = c - s * NUDGE, s + c * NUDGE
        rates(full, turned_c, turned_s, tilted_ahead, tilted_aside, command, noise, parameters, beside)
        full[j], full[VZ], full[YAW_RATE] = state[j], state[VZ], state[YAW_RATE]
        for i in range(MOVING):
            # The share of hold noise that remains near the floor must not serve to measure the height.
            if j != Z or i == VZ:
                matrix[i, j] = (beside[i] - rate[i]) / NUDGE
    for i in (Z, VZ):
        matrix[i, VZ], matrix[i, VX] = matrix[i, VX], 0.0
    for i in (YAW, YAW_RATE):
        matrix[i, YAW_RATE], matrix[i, VX] = matrix[i, VX], 0.0
    for i in range(GUST_X):
        noise[i] += NUDGE
    rates(full, c, s, ahead, aside, command, noise, parameters, beside)
    for i in range(3):
        matrix[i, BEHIND + i] = (beside[i] - rate[i]) / NUDGE
        matrix[VX + i, BEHIND + i] = (beside[VX + i] - rate[VX + i]) / NUDGE
        is_used = YAW_RATE if i == 2 else ROLL + i
        matrix[is_used, TARGET + i] = (beside[is_used] - rate[is_used]) / NUDGE
        noise[ROLL_NOISE + i], noise[WX + i] = state[TARGET + i], state[BEHIND + i]
    for j in range(GUST, min(n, AR1)):
        noise[GUST_X + j - GUST] += NUDGE
        rates(full, c, s, ahead, aside, command, noise, parameters, beside)
        for i in range(MOVING):
            matrix[i, j] = (beside[i] - rate[i]) / NUDGE
        noise[GUST_X + j - GUST] = state[j]


@kernel
def decay(hold: Array, h: float, matrix: Array) -> None:
    """Write the exact rows of the noises in the transition matrix over h seconds."""
    for i in range(TARGET, matrix.shape[0]):
        matrix[i, :] = 0.0
    for i in range(3):
        time = hold[TILT_TIME] if i < 2 else hold[TURN_TIME]
        matrix[TARGET + i, TARGET + i] = math.exp(-h / time)
        before, behind = math.exp(-h / hold[W_TIME]), math.exp(-h / hold[POLE])
        matrix[BEFORE + i, BEFORE + i] = before
        matrix[BEHIND + i, BEHIND + i] = behind
        apart = hold[W_TIME] - hold[POLE]
        if abs(apart) < NEARLY * hold[POLE]:
            matrix[BEHIND + i, BEFORE + i] = h / hold[POLE] * behind
        else:
            matrix[BEHIND + i, BEFORE + i] = (before - behind) * hold[W_TIME] / apart
    for i in range(GUST, matrix.shape[0]):
        # AR(1) noises change from sample to sample only.
        matrix[i, i] = math.exp(-h / hold[GUST_TIME]) if i < AR1 else 1.0


@kernel
def process_noise(hold: Array, matrix: Array, q: Array) -> None:
    """Write the process noise (n, n) that keeps the noises stationary under the transition ``matrix``."""
    q[:] = 0.0
    for i in range(3):
        std = hold[TILT_STD] if i < 2 else hold[TURN_STD]
        k = matrix[TARGET + i, TARGET + i]
        q[TARGET + i, TARGET + i] = std * std * (1.0 - k * k)
        o, w = BEFORE + i, BEHIND + i
        # The stationary variances of o and of w; that of w is also their covariance.
        v_w = (hold[W_UP_STD] if i == 2 else hold[W_STD]) ** 2
        v_o = v_w * (hold[W_TIME] + hold[POLE]) / hold[W_TIME]
        a, b, c = matrix[o, o], matrix[w, w], matrix[w, o]
        q[o, o] = v_o * (1.0 - a * a)
        q[o, w] = q[w, o] = v_w - a * (c * v_o + b * v_w)
        q[w, w] = v_w - (c * c * v_o + 2.0 * b * c * v_w + b * b * v_w)
    for i in range(GUST, min(matrix.shape[0], AR1)):
        q[i, i] = hold[GUST_STD] ** 2 * (1.0 - matrix[i, i] ** 2)


@inner_kernel
def transition(slopes: Array, hold: Array, h: float, matrix: Array) -> None:
    """Write the transition (n, n) over h: exact in noises, else to second order of ``slopes`` (10, n)."""
    n = matrix.shape[0]
    decay(hold, h, matrix)
    for i in range(MOVING):
        for j in range(n):
            matrix[i, j] = h * slopes[i, j]
        matrix[i, i] += 1.0
        for k in range(n):
            if slopes[i, k] == 0.0:
                continue
            if k < MOVING:
                x = 0.5 * h * h * slopes[i, k]
                for j in range(n):
                    matrix[i, j] += x * slopes[k, j]
            else:
                # The mean of a noise over the step: half its beginning, half its end.
                x = 0.5 * h * slopes[i, k]
                matrix[i, k] -= x
                for j in range(n):
                    matrix[i, j] += x * matrix[k, j]


@inner_kernel
def _times(matrix: Array, right: Array, product: Array, lower: bool) -> None:
    """Compute ``product`` = F ``right``, (n, n) all, or its lower triangle, for a sparse transition matrix F:
    each noise depends on itself alone, and w on o as well."""
    n = right.shape[0]
    for i in range(n):
        x, columns = matrix[i, i], i + 1 if lower else n
        for j in range(columns):
            product[i, j] = x * right[i, j]
        if i < MOVING:
            for k in range(n):
                x = matrix[i, k]
                if x != 0.0 and k != i:
                    for j in range(columns):
                        product[i, j] += x * right[k, j]
        elif BEHIND <= i < GUST:
            x = matrix[i, i - BEHIND + BEFORE]
            for j in range(columns):
                product[i, j] += x * right[i - BEHIND + BEFORE, j]


@inner_kernel
def add_shocks(step: StepBuffers, p: Array) -> None:
    """Add to a covariance (n, n) what a late jump of the stick and the gear's contact may do in a step."""
    late = step.late_stick_noise
    for i in range(MOVING):
        p[i, i] += step.contact_variance[i]
        if late[i] != 0.0:
            for j in range(MOVING):
                p[i, j] += late[i] * late[j]


@inner_kernel
def covariance_step(h: float, p: Array, slopes: Array, matrix: Array, q: Array, work: Array) -> None:
    """P <- F P F' + L Q L', in place; through L half a step of the noise acts on the driven states."""
    n = p.shape[0]
    for lower in (False, True):  # one call: with constants, the product would be compiled twice
        _times(matrix, p, work, lower)
        for i in range(n):
            for j in range(i + 1 if lower else n):
                if lower:
                    p[i, j] = work[i, j]
                else:
                    p[j, i] = work[i, j]
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


@inner_kernel
def mean_step(
    h: float, state: Array, command: Array, model: ModelArrays, step: StepBuffers, scratch: Scratch
) -> None:
    """Integrate the mean over h by RK4, in place, noises decaying exactly; write the middle into ``step``."""
    n, parameters, matrix = state.shape[0], model.parameters, step.matrix
    first, middle, middle_noise = step.rate, step.middle, step.middle_noise
    full, noise, ended, rate = scratch.full, scratch.noise, scratch.ended, scratch.rate
    total, after = scratch.total, scratch.nudged
    split_state(state, full, noise)
    for i in range(TARGET, n):
        after[i] = matrix[i, i] * state[i]
        if BEHIND <= i < GUST:
            after[i] += matrix[i, i - BEHIND + BEFORE] * state[i - BEHIND + BEFORE]
    split_state(after, scratch.nudged_rate, ended)
    for i in range(NOISES):
        middle_noise[i] = 0.5 * (noise[i] + ended[i])
    for i in range(FULL):
        total[i] = first[i]
        middle[i] = full[i] + 0.5 * h * first[i]
    derivative(middle, command, middle_noise, parameters, rate)
    for i in range(FULL):
        total[i] += 2.0 * rate[i]
        middle[i] = full[i] + 0.5 * h * rate[i]
    derivative(middle, command, middle_noise, parameters, rate)
    for i in range(FULL):
        total[i] += 2.0 * rate[i]
        full[i] += h * rate[i]
    derivative(full, command, ended, parameters, rate)
    for i in range(MOVING):
        state[i] += h / 6.0 * (total[i] + rate[i])
    for i in range(TARGET, n):
        state[i] = after[i]
