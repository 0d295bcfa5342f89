"""The filter, compiled: an extended Kalman filter over the simulator's equations, with tangents.

Readings come in their order of time, one scalar at a time, so that each innovation over its own standard
deviation is white with variance 1 under the model: the exact likelihood of the flight (to the linearisation).
Beside the mean run tangents: how the mean and with it each innovation would change with a parameter of the
equations or of an instrument, an early or late command, or any signal injected into either, while the gains
stay. That is the exact linear sensitivity of the whitened innovations, filter included.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.compiled import kernel
from slam.criticism.kalman.readings import (
    BEFORE,
    BEHIND,
    FIRST_CHANNEL,
    GUST,
    IMU,
    MOVING,
    TARGET,
    WIDTH,
    reading,
)
from slam.criticism.kalman.steps import (
    after_contact,
    correct,
    is_outlier,
    judged,
    measurement,
    miss_of,
    predict,
    spread_along,
)
from slam.criticism.kalman.transition import POLE, decay, jacobian, kicks, spread
from slam.simulation.dynamics import derivative, rates, thrust

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

USED, OUTLIER, IGNORED = 1, 2, 0
_ENTRIES = 11
"""Places that a force may go in at (``_inject``)."""
_INJECTED = 1e-3


@kernel
def _inject(entry: int, size: float, yaw: float, noise: Array, command: Array) -> None:
    """Add a signal to a noise (0 to 7), to the climb stick (8), or as wind ahead (9) or to the left (10)."""
    if entry < 8:
        noise[entry] += size
    elif entry == 8:
        command[2] += size
    elif entry == 9:
        noise[6] += size * math.cos(yaw)
        noise[7] += size * math.sin(yaw)
    else:
        noise[6] -= size * math.sin(yaw)
        noise[7] += size * math.cos(yaw)


@kernel
def _felt(
    state: Array, noise: Array, command: Array, parameters: Array, rate: Array, inject_at: Ints, acts: Ints,
    felt: Array,
) -> None:  # fmt: skip
    """Change of the state's rate with a unit injected at each entry that is used: ``felt`` (entries, 10)."""
    c, s = math.cos(state[8]), math.sin(state[8])
    ahead, aside = thrust(state[6], state[7], parameters)
    other, pushed, moved = np.empty(12), np.empty(8), np.empty(6)
    rates(state, c, s, ahead, aside, command, noise, parameters, rate)
    seen = np.zeros(_ENTRIES, dtype=np.bool_)
    for d in range(len(acts)):
        entry = inject_at[d]
        if acts[d] == 0 or entry < 0 or seen[entry]:
            continue
        seen[entry] = True
        pushed[:], moved[:] = noise, command
        _inject(entry, _INJECTED, state[8], pushed, moved)
        rates(state, c, s, ahead, aside, moved, pushed, parameters, other)
        for i in range(MOVING):
            felt[entry, i] = (other[i] - rate[i]) / _INJECTED


@kernel
def _force(
    tangents: Array, slopes: Array, h: float, middle: Array, middle_noise: Array, step: int,
    parameters: Array, sticks: Array, acts: Ints, stick_of: Ints, parameters_of: Array,
    inject_at: Ints, signal_of: Ints, signals: Array, scale: Array, felt: Array, added: Array,
) -> None:  # fmt: skip
    """Add to the tangents (n, m) what their perturbation does within the step."""
    rate, other = np.empty(12), np.empty(12)
    _felt(middle, middle_noise, sticks[0, step], parameters, rate, inject_at, acts, felt)
    c, s = math.cos(middle[8]), math.sin(middle[8])
    ahead, aside = thrust(middle[6], middle[7], parameters)
    for d in range(tangents.shape[1]):
        if acts[d] == 0:
            continue
        if inject_at[d] >= 0:
            for i in range(MOVING):
                added[i] = h * felt[inject_at[d], i] * signals[signal_of[d], step]
        else:
            rates(
                middle, c, s, ahead, aside, sticks[stick_of[d], step], middle_noise, parameters_of[d], other
            )
            for i in range(MOVING):
                added[i] = h * (other[i] - rate[i]) * scale[d]
        for i in range(MOVING):
            total = added[i]
            for k in range(MOVING):
                total += 0.5 * h * slopes[i, k] * added[k]
            tangents[i, d] += total


@kernel
def _direct(
    kind: int, event: int, state: Array, rate: Array, elapsed: float, parameters: Array,
    pole_s: float, predicted: Array, by_rate: Array, commands: Array, acts: Ints, reads: Ints,
    stick_of: Ints, parameters_of: Array, sensor_of: Array, inject_at: Ints, signal_of: Ints, signals: Array,
    scale: Array, felt: Array, direct: Array,
) -> None:  # fmt: skip
    """What each perturbation changes in a reading by itself, the state left alone: (6, m)."""
    full, noise, other, out = np.empty(12), np.empty(8), np.empty(12), np.empty(6)
    change = np.empty(MOVING)
    spread(state, full, noise)
    c_yaw, s_yaw = math.cos(state[8]), math.sin(state[8])
    ahead, aside = thrust(state[6], state[7], parameters)
    if kind == IMU:
        _felt(full, noise, commands[0, event], parameters, other, inject_at, acts, felt)
    for d in range(direct.shape[1]):
        for c in range(WIDTH[kind]):
            direct[c, d] = 0.0
        if inject_at[d] >= 100:
            c = inject_at[d] - 100 - FIRST_CHANNEL[kind]
            if 0 <= c < WIDTH[kind]:
                direct[c, d] = signals[signal_of[d], event]
        elif acts[d] == 1 and kind == IMU:
            if inject_at[d] >= 0:
                for i in range(MOVING):
                    change[i] = felt[inject_at[d], i] * signals[signal_of[d], event]
            else:
                rates(
                    full, c_yaw, s_yaw, ahead, aside, commands[stick_of[d], event], noise, parameters_of[d],
                    other,
                )  # fmt: skip
                for i in range(MOVING):
                    change[i] = (other[i] - rate[i]) * scale[d]
            # The imu reads rates as they are: linear in them.
            for c in range(WIDTH[kind]):
                for i in range(3, 9):
                    direct[c, d] += by_rate[c, i] * change[i]
        elif (reads[d] >> kind) & 1:
            reading(kind, state, rate, sensor_of[d], parameters_of[d], pole_s, elapsed, out)
            for c in range(WIDTH[kind]):
                direct[c, d] = (out[c] - predicted[c]) * scale[d]


@kernel
def _carried(matrix: Array, tangents: Array, moved: Array) -> None:
    """Tangents (n, m) over a step by its transition matrix, in place; ``moved`` (10, m) is room to work."""
    n, m = tangents.shape
    for i in range(MOVING):
        for d in range(m):
            moved[i, d] = 0.0
        for k in range(n):
            x = matrix[i, k]
            if x != 0.0:
                for d in range(m):
                    moved[i, d] += x * tangents[k, d]
    for i in range(MOVING):
        for d in range(m):
            tangents[i, d] = moved[i, d]
    # Of the noises, w follows o, and all others only themselves.
    for i in range(n - 1, MOVING - 1, -1):
        x = matrix[i, i]
        for d in range(m):
            tangents[i, d] *= x
        if BEHIND <= i < GUST:
            x = matrix[i, i - BEHIND + BEFORE]
            for d in range(m):
                tangents[i, d] += x * tangents[i - BEHIND + BEFORE, d]


@kernel
def _told(h: Array, direct: Array, ph: Array, s_var: float, tangents: Array, told: Array) -> None:
    """``told`` (m,): how each tangent changes the prediction of a reading with row ``h`` (n,); the tangents
    are then corrected by the reading as the state is."""
    told[:] = direct
    for k in range(len(h)):
        x = h[k]
        if x != 0.0:
            for d in range(len(told)):
                told[d] += x * tangents[k, d]
    for i in range(len(ph)):
        x = ph[i] / s_var
        for d in range(len(told)):
            tangents[i, d] -= x * told[d]


@kernel
def run(
    begin: int, end: int, times: Array, kinds: Ints, values: Array, elapsed: Array, jumps: Ints,
    first_step: Ints, lengths: Array, sticks: Array, jolts: Array, late_var: float, commands: Array,
    parameters: Array, sensor: Array, hold: Array,
    noise_var: Array, jitter_var: float, limits: Array, state: Array, p: Array, memory: Array,
    acts: Ints, reads: Ints, stick_of: Ints, parameters_of: Array, sensor_of: Array, inject_at: Ints,
    signal_of: Ints, step_signals: Array, event_signals: Array, scale: Array, tangents: Array,
    innovation: Array, log_variance: Array, status: Ints, traces: Array, states: Array, keep: Ints,
) -> None:  # fmt: skip
    """Filter events ``begin`` to ``end``; ``state`` (n,), ``p`` (n, n), ``tangents`` (n, m) and ``memory``
    carry on.

    ``times``, ``kinds``, ``elapsed``, ``jumps`` (events,), ``values`` (events, 6) with NaN for what is
    missing; gyro readings where the stick jumps are not judged. Event e is reached by steps
    ``first_step[e]`` to ``first_step[e + 1]`` of ``lengths``, with the sticks' means ``sticks`` (variants,
    steps, 6) over each, jumps ``jolts`` (steps, 6) within, whose moments vary by ``late_var``, and
    ``commands`` (variants, events, 6) at the event. Written: ``innovation``
    (whitened), ``log_variance`` and ``status`` (events, 6); ``traces`` (rows kept, m), change of the
    prediction over its standard deviation; ``states`` (events, 11), the moving state before the event and
    the standard deviation of z; ``keep``, how many rows of ``traces``.
    """
    n, m = state.shape[0], tangents.shape[1]
    slopes, matrix, q = np.empty((MOVING, n)), np.zeros((n, n)), np.zeros((n, n))
    work, rate, added = np.empty((n, n)), np.empty(12), np.empty(MOVING)
    middle, middle_noise = np.empty(12), np.empty(8)
    predicted, h_matrix, direct = np.empty(6), np.zeros((6, n)), np.zeros((6, m))
    by_rate, felt = np.zeros((6, MOVING)), np.zeros((_ENTRIES, MOVING))
    moved, ph, a, done = np.empty((MOVING, m)), np.empty(n), np.empty(m), np.empty(n)
    row = 0
    for e in range(begin, end):
        for s in range(first_step[e], first_step[e + 1]):
            h = lengths[s]
            predict(
                state, p, sticks[0, s], jolts[s], late_var, parameters, hold, h, slopes, matrix, q, work,
                rate, middle, middle_noise,
            )  # fmt: skip
            if m > 0:
                _carried(matrix, tangents, moved)
                _force(
                    tangents, slopes, h, middle, middle_noise, s, parameters, sticks, acts, stick_of,
                    parameters_of, inject_at, signal_of, step_signals, scale, felt, added,
                )  # fmt: skip
        kind = kinds[e]
        for i in range(MOVING):
            states[e, i] = state[i]
        states[e, 10] = math.sqrt(p[2, 2])
        near = after_contact(times[e], state, p, parameters, memory)
        if kind == IMU or first_step[e + 1] == first_step[e]:
            # Only rates of tilt and speed jump with the stick: all else may use the last step's slopes.
            jacobian(state, commands[0, e], parameters, rate, slopes)
        else:
            spread(state, middle, middle_noise)
            derivative(middle, commands[0, e], middle_noise, parameters, rate)
        measurement(
            kind, state, rate, slopes, sensor, parameters, hold[POLE], elapsed[e], predicted, by_rate,
            h_matrix,
        )  # fmt: skip
        if m > 0:
            _direct(
                kind, e, state, rate, elapsed[e], parameters, hold[POLE], predicted, by_rate, commands,
                acts, reads, stick_of, parameters_of, sensor_of, inject_at, signal_of, event_signals, scale,
                felt, direct,
            )  # fmt: skip
        done[:] = 0.0
        for c in range(WIDTH[kind]):
            status[e, c] = IGNORED
            channel = FIRST_CHANNEL[kind] + c
            noise = noise_var[channel]
            if not judged(kind, channel, values[e, c], predicted[c], noise, near, jumps[e], limits):
                continue
            if jitter_var > 0.0:
                # A reading whose stamp is off by t is off by t times its own rate.
                slope = 0.0
                for i in range(MOVING):
                    slope += h_matrix[c, i] * rate[i]
                noise += jitter_var * slope * slope
            s_var = noise + spread_along(p, h_matrix[c], ph)
            miss = miss_of(kind, c, values[e, c], predicted[c], h_matrix[c], done)
            std = math.sqrt(s_var)
            innovation[e, c] = miss / std
            log_variance[e, c] = math.log(s_var)
            if is_outlier(miss, std, channel, memory):
                status[e, c] = OUTLIER
                continue
            status[e, c] = USED
            if m > 0:
                _told(h_matrix[c], direct[c], ph, s_var, tangents, a)
                for d in range(m):
                    traces[row, d] = a[d] / std
            row += 1
            correct(state, p, ph, s_var, miss, done)
    keep[0] = row


@kernel
def start_noise(hold: Array, p: Array) -> None:
    """Write the stationary covariance of the noises into ``p`` (n, n)."""
    n = p.shape[0]
    matrix, q = np.zeros((n, n)), np.zeros((n, n))
    # Over an endless step nothing of the past is left: its kicks are the stationary covariance.
    decay(hold, 1e6, matrix)
    kicks(hold, matrix, q)
    for i in range(TARGET, n):
        for j in range(TARGET, n):
            p[i, j] = q[i, j]
