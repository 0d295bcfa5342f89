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
from slam.criticism.kalman.readings import ATTITUDE, FIRST_CHANNEL, IMU, MOVING, SONAR, TARGET, WIDTH, reading
from slam.criticism.kalman.transition import (
    POLE,
    covariance_step,
    decay,
    jacobian,
    kicks,
    mean_step,
    spread,
    transition,
)
from slam.simulation.dynamics import GEAR, derivative

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

GATE = 6.0
"""An innovation beyond so many standard deviations is an outlier: it is kept out of the state."""
STREAK = 2
"""So many outliers of a channel in a row are none: then the model is wrong, not the reading."""
CONTACT_S = 0.3
"""The landing gear's bounce differs from vehicle to vehicle: so long after it, speed is not judged."""
CONTACT_M = 0.03
CONTACT_NOISE = 0.3
"""Process noise of the velocity near the floor, m/s/sqrt(s)."""
USED, OUTLIER, IGNORED = 1, 2, 0


@kernel
def _measurement(
    kind: int, state: Array, rate: Array, slopes: Array, sensor: Array, parameters: Array,
    pole_s: float, elapsed: float, predicted: Array, matrix: Array,
) -> None:  # fmt: skip
    """What is read, and its Jacobian (6, n) in the state: through the state and through its rate."""
    n = state.shape[0]
    reading(kind, state, rate, sensor, parameters, pole_s, elapsed, predicted)
    beside, nudged, moved = np.empty(6), state.copy(), rate.copy()
    if kind == ATTITUDE:
        h_first, h_last = 6, 9
    else:
        h_first, h_last = 0, n
    matrix[:] = 0.0
    for j in range(h_first, h_last):
        nudged[j] = state[j] + 1e-6
        for i in range(MOVING):
            moved[i] = rate[i] + 1e-6 * slopes[i, j]
        reading(kind, nudged, moved, sensor, parameters, pole_s, elapsed, beside)
        for c in range(WIDTH[kind]):
            matrix[c, j] = (beside[c] - predicted[c]) / 1e-6
        nudged[j] = state[j]


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
def _force(
    tangents: Array, slopes: Array, h: float, middle: Array, middle_noise: Array, step: int,
    parameters: Array, sticks: Array, acts: Ints, stick_of: Ints, parameters_of: Array,
    inject_at: Ints, signal_of: Ints, signals: Array, scale: Array, added: Array,
) -> None:  # fmt: skip
    """Add to the tangents (n, m) what their perturbation does within the step."""
    rate, other, noise, command = np.empty(12), np.empty(12), np.empty(8), np.empty(6)
    derivative(middle, sticks[0, step], middle_noise, parameters, rate)
    for d in range(tangents.shape[1]):
        if acts[d] == 0:
            continue
        noise[:] = middle_noise
        command[:] = sticks[stick_of[d], step]
        if inject_at[d] >= 0:
            _inject(inject_at[d], signals[signal_of[d], step] / scale[d], middle[8], noise, command)
        derivative(middle, command, noise, parameters_of[d], other)
        for i in range(MOVING):
            added[i] = h * (other[i] - rate[i]) * scale[d]
        for i in range(MOVING):
            total = added[i]
            for k in range(MOVING):
                total += 0.5 * h * slopes[i, k] * added[k]
            tangents[i, d] += total


@kernel
def _direct(
    kind: int, event: int, state: Array, rate: Array, elapsed: float, sensor: Array, parameters: Array,
    pole_s: float, predicted: Array, commands: Array, acts: Ints, reads: Ints, stick_of: Ints,
    parameters_of: Array, sensor_of: Array, inject_at: Ints, signal_of: Ints, signals: Array, scale: Array,
    direct: Array,
) -> None:  # fmt: skip
    """What each perturbation changes in a reading by itself, the state left alone: (6, m)."""
    full, noise, plain = np.empty(12), np.empty(8), np.empty(8)
    other, out, command = np.empty(12), np.empty(6), np.empty(6)
    spread(state, full, plain)
    for d in range(direct.shape[1]):
        for c in range(WIDTH[kind]):
            direct[c, d] = 0.0
        if inject_at[d] >= 100:
            c = inject_at[d] - 100 - FIRST_CHANNEL[kind]
            if 0 <= c < WIDTH[kind]:
                direct[c, d] = signals[signal_of[d], event]
            continue
        felt = acts[d] == 1 and kind == IMU
        if not (felt or (reads[d] >> kind) & 1):
            continue
        if felt:
            noise[:] = plain
            command[:] = commands[stick_of[d], event]
            if inject_at[d] >= 0:
                _inject(inject_at[d], signals[signal_of[d], event] / scale[d], state[8], noise, command)
            derivative(full, command, noise, parameters_of[d], other)
        else:
            other[:] = rate
        reading(kind, state, other, sensor_of[d], parameters_of[d], pole_s, elapsed, out)
        for c in range(WIDTH[kind]):
            direct[c, d] = (out[c] - predicted[c]) * scale[d]


@kernel
def run(
    begin: int, end: int, times: Array, kinds: Ints, values: Array, elapsed: Array, jumps: Ints,
    first_step: Ints, lengths: Array, sticks: Array, commands: Array,
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
    steps, 6) over each and ``commands`` (variants, events, 6) at the event. Written: ``innovation``
    (whitened), ``log_variance`` and ``status`` (events, 6); ``traces`` (rows kept, m), change of the
    prediction over its standard deviation; ``states`` (events, 11), the moving state before the event and
    the standard deviation of z; ``keep``, how many rows of ``traces``.
    """
    n, m = state.shape[0], tangents.shape[1]
    slopes, matrix, q = np.empty((MOVING, n)), np.zeros((n, n)), np.zeros((n, n))
    work, rate, added = np.empty((n, n)), np.empty(12), np.empty(MOVING)
    middle, middle_noise = np.empty(12), np.empty(8)
    predicted, h_matrix, direct = np.empty(6), np.zeros((6, n)), np.zeros((6, m))
    moved, gain, ph, a, done = np.empty((n, m)), np.empty(n), np.empty(n), np.empty(m), np.empty(n)
    row = 0
    for e in range(begin, end):
        for s in range(first_step[e], first_step[e + 1]):
            h = lengths[s]
            jacobian(state, sticks[0, s], parameters, rate, slopes)
            transition(slopes, hold, h, matrix)
            kicks(hold, matrix, q)
            mean_step(state, sticks[0, s], hold, matrix, parameters, h, rate, middle, middle_noise)
            covariance_step(matrix, q, slopes, h, p, work)
            if state[2] - parameters[GEAR] < CONTACT_M + 3.0 * math.sqrt(p[2, 2]):
                for i in range(3, 6):
                    p[i, i] += CONTACT_NOISE**2 * h
            if m > 0:
                for i in range(n):
                    for d in range(m):
                        moved[i, d] = 0.0
                    for k in range(n):
                        x = matrix[i, k]
                        if x != 0.0:
                            for d in range(m):
                                moved[i, d] += x * tangents[k, d]
                for i in range(n):
                    for d in range(m):
                        tangents[i, d] = moved[i, d]
                _force(
                    tangents, slopes, h, middle, middle_noise, s, parameters, sticks, acts, stick_of,
                    parameters_of, inject_at, signal_of, step_signals, scale, added,
                )  # fmt: skip
        kind = kinds[e]
        for i in range(MOVING):
            states[e, i] = state[i]
        states[e, 10] = math.sqrt(p[2, 2])
        if state[2] - parameters[GEAR] < CONTACT_M + 3.0 * states[e, 10]:
            memory[0] = times[e]
        near = times[e] - memory[0] < CONTACT_S
        if kind == IMU or first_step[e + 1] == first_step[e]:
            # Only rates of tilt and speed jump with the stick: all else may use the last step's slopes.
            jacobian(state, commands[0, e], parameters, rate, slopes)
        else:
            spread(state, middle, middle_noise)
            derivative(middle, commands[0, e], middle_noise, parameters, rate)
        _measurement(
            kind, state, rate, slopes, sensor, parameters, hold[POLE], elapsed[e], predicted, h_matrix
        )
        if m > 0:
            _direct(
                kind, e, state, rate, elapsed[e], sensor, parameters, hold[POLE], predicted, commands, acts,
                reads, stick_of, parameters_of, sensor_of, inject_at, signal_of, event_signals, scale, direct,
            )  # fmt: skip
        done[:] = 0.0
        for c in range(WIDTH[kind]):
            status[e, c] = IGNORED
            if math.isnan(values[e, c]):
                continue
            channel = FIRST_CHANNEL[kind] + c
            if near and (3 <= channel < 6 or 9 <= channel < 11):
                continue
            if jumps[e] and channel < 3:
                continue
            noise = noise_var[channel]
            expected = predicted[c]
            if kind == SONAR:
                margin = 4.0 * math.sqrt(noise)
                if expected < limits[0] + margin or expected > limits[1] - margin:
                    continue
            if jitter_var > 0.0:
                # A reading whose stamp is off by t is off by t times its own rate.
                slope = 0.0
                for i in range(MOVING):
                    slope += h_matrix[c, i] * rate[i]
                noise += jitter_var * slope * slope
            s_var = noise
            ph[:] = 0.0
            for k in range(n):
                x = h_matrix[c, k]
                if x != 0.0:
                    for i in range(n):
                        ph[i] += p[k, i] * x
            for i in range(n):
                s_var += h_matrix[c, i] * ph[i]
                expected += h_matrix[c, i] * done[i]
            miss = values[e, c] - expected
            if kind == ATTITUDE and c == 2:
                miss -= 2.0 * math.pi * math.floor(miss / (2.0 * math.pi) + 0.5)
            std = math.sqrt(s_var)
            innovation[e, c] = miss / std
            log_variance[e, c] = math.log(s_var)
            if abs(miss) > GATE * std and memory[1 + channel] < STREAK:
                memory[1 + channel] += 1.0
                status[e, c] = OUTLIER
                continue
            memory[1 + channel] = 0.0
            status[e, c] = USED
            for i in range(n):
                gain[i] = ph[i] / s_var
            if m > 0:
                for d in range(m):
                    a[d] = direct[c, d]
                for k in range(n):
                    x = h_matrix[c, k]
                    if x != 0.0:
                        for d in range(m):
                            a[d] += x * tangents[k, d]
                for d in range(m):
                    traces[row, d] = a[d] / std
                for i in range(n):
                    x = gain[i]
                    for d in range(m):
                        tangents[i, d] -= x * a[d]
            row += 1
            for i in range(n):
                step = gain[i] * miss
                done[i] += step
                state[i] += step
            for i in range(n):
                x = gain[i]
                for k in range(n):
                    p[i, k] -= x * ph[k]
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
