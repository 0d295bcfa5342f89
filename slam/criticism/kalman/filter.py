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

from slam.criticism.kalman.coloured import Coloured, heard, learn, sample, step
from slam.criticism.kalman.compiled import kernel
from slam.criticism.kalman.readings import FIRST_CHANNEL, IMU, MOVING, RANGE_LAG, SONAR, TARGET, WIDTH
from slam.criticism.kalman.sensitivity import ENTRIES, carry, direct_change, force, tell
from slam.criticism.kalman.steps import (
    correct,
    is_outlier,
    judged,
    measurement,
    miss_of,
    predict,
    spread_along,
)
from slam.criticism.kalman.transition import POLE, decay, jacobian, kicks, spread
from slam.simulation.dynamics import derivative

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

USED, OUTLIER, IGNORED = 1, 2, 0
ROLL, PITCH = 6, 7
"""Entries of the state."""
SHORT_S = 1e-5
OWN_SHARE = 0.25
"""Of a stamp's standard deviation times the kicks: a third of E |t|, as the next reading shows the rest. With
none of it gyros whose stamps are off by 7 ms scatter more about the axes that tilt than about yaw."""


@kernel
def _ahead(
    begin: int, end: int, state: Array, p: Array, tangents: Array, sticks: Array, jolts: Array,
    late_var: float, lengths: Array, parameters: Array, hold: Array,
    acts: Ints, stick_of: Ints, parameters_of: Array, inject_at: Ints, signal_of: Ints, signals: Array,
    scale: Array, slopes: Array, matrix: Array, q: Array, work: Array, rate: Array, middle: Array,
    middle_noise: Array, moved: Array, felt: Array, added: Array, coloured: Coloured | None,
) -> None:  # fmt: skip
    """State, covariance and tangents over the steps ``begin`` to ``end``, in place.

    From ``slopes`` to ``added`` arguments are room to work; ``slopes`` (10, n) is left as of the last step.
    """
    for s in range(begin, end):
        h = lengths[s]
        predict(
            state, p, sticks[0, s], jolts[s], late_var, parameters, hold, h, slopes, matrix, q, work,
            rate, middle, middle_noise,
        )  # fmt: skip
        if coloured is not None:
            step(coloured, matrix)
        if tangents.shape[1] > 0:
            carry(matrix, tangents, moved)
            force(
                tangents, slopes, h, middle, middle_noise, s, parameters, sticks, acts, stick_of,
                parameters_of, inject_at, signal_of, signals, scale, felt, added,
            )  # fmt: skip


@kernel
def _spread_by_stamp(row: Array, rate: Array, rough: Array, jitter_s: float) -> float:
    """Variance of a reading with row ``row`` (n,) from its stamp, off by t of a deviation ``jitter_s``.

    It is off by t times its own rate, and by what the noises did in between: their kicks ``rough`` (n,) a
    second, of which the next reading shows most as well.
    """
    if jitter_s <= 0.0:
        return 0.0
    slope, kicked = 0.0, 0.0
    for i in range(MOVING):
        slope += row[i] * rate[i]
    for i in range(TARGET, row.shape[0]):
        kicked += row[i] * row[i] * rough[i]
    return jitter_s * jitter_s * slope * slope + OWN_SHARE * jitter_s * kicked


@kernel
def _roughness(hold: Array, n: int) -> Array:
    """(n,) growth of each noise's variance by its kicks, a second."""
    matrix, q = np.zeros((n, n)), np.zeros((n, n))
    decay(hold, SHORT_S, matrix)
    kicks(hold, matrix, q)
    return np.diag(q) / SHORT_S


@kernel
def _turn_within_lag(event: int, times: Array, states: Array, lag_s: float, rate: Array) -> None:
    """Put the mean rates of roll and pitch over a sonar's lag before an event in place of its moment's own.

    Tilts begin and end within a lag: the tilt then is not the tilt now less the lag times its rate.
    """
    then = times[event] - lag_s
    e = event
    while e > 0 and times[e] > then:
        e -= 1
    if e == event or times[e] > then:
        return
    part = (then - times[e]) / (times[e + 1] - times[e])
    for i in (ROLL, PITCH):
        rate[i] = (states[event, i] - states[e, i] - part * (states[e + 1, i] - states[e, i])) / lag_s


@kernel
def _take(
    event: int, kind: int, read: Array, landing: bool, jump: int, predicted: Array, rows: Array, rate: Array,
    noise_var: Array, rough: Array, jitter_s: float, limits: Array, state: Array, p: Array, memory: Array,
    tangents: Array, direct: Array, innovation: Array, log_variance: Array, status: Ints, traces: Array,
    row: int, ph: Array, told: Array, done: Array, coloured: Coloured | None,
) -> int:  # fmt: skip
    """Take the channels of one event, one after the other, into state, covariance and tangents.

    ``read`` and ``predicted`` (6,), ``rows`` (6, n); the traces are written from ``row`` on. Returns the row
    after the last.
    """
    done[:] = 0.0
    if coloured is not None:
        sample(coloured, event, kind)
    for c in range(WIDTH[kind]):
        status[event, c] = IGNORED
        channel = FIRST_CHANNEL[kind] + c
        noise = noise_var[channel]
        if not judged(kind, channel, read[c], predicted[c], noise, landing, jump, limits):
            continue
        value = read[c]
        if coloured is not None and coloured.slot[channel] >= 0:
            noise = 0.0
            value -= coloured.mean[coloured.slot[channel]]
        noise += _spread_by_stamp(rows[c], rate, rough, jitter_s)
        s_var = noise + spread_along(p, rows[c], ph)
        if coloured is not None:
            s_var += heard(coloured, coloured.slot[channel], rows[c], ph)
        miss = miss_of(kind, c, value, predicted[c], rows[c], done)
        std = math.sqrt(s_var)
        innovation[event, c] = miss / std
        log_variance[event, c] = math.log(s_var)
        if is_outlier(miss, std, channel, memory):
            status[event, c] = OUTLIER
            continue
        status[event, c] = USED
        if tangents.shape[1] > 0:
            if coloured is not None and coloured.slot[channel] >= 0:
                direct[c] += coloured.tangents[coloured.slot[channel]]
            tell(rows[c], direct[c], ph, s_var, tangents, told)
            for d in range(tangents.shape[1]):
                traces[row, d] = told[d] / std
        row += 1
        if coloured is not None:
            learn(coloured, ph, s_var, miss, told)
        correct(state, p, ph, s_var, miss, done)
    return row


@kernel
def run(
    begin: int, end: int, times: Array, kinds: Ints, values: Array, elapsed: Array, landing: Flags,
    jumps: Ints, first_step: Ints, lengths: Array, sticks: Array, jolts: Array, late_var: float,
    commands: Array, parameters: Array, sensor: Array, hold: Array,
    noise_var: Array, jitter_s: float, limits: Array, state: Array, p: Array, memory: Array,
    acts: Ints, reads: Ints, stick_of: Ints, parameters_of: Array, sensor_of: Array, inject_at: Ints,
    signal_of: Ints, step_signals: Array, event_signals: Array, scale: Array, tangents: Array,
    innovation: Array, log_variance: Array, status: Ints, traces: Array, states: Array, keep: Ints,
    coloured: Coloured | None,
) -> None:  # fmt: skip
    """Filter events ``begin`` to ``end``; ``state`` (n,), ``p`` (n, n), ``tangents`` (n, m), ``memory`` and
    the ``coloured`` noises, where there are any, carry on.

    ``times``, ``kinds``, ``elapsed``, ``landing``, ``jumps`` (events,), ``values`` (events, 6) with NaN for
    what is missing; the first ``jumps`` channels of the IMU are not judged. Event e is reached by steps
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
    by_rate, felt = np.zeros((6, MOVING)), np.zeros((ENTRIES, MOVING))
    moved, ph, told, done = np.empty((MOVING, m)), np.empty(n), np.empty(m), np.empty(n)
    rough = _roughness(hold, n)
    row = 0
    for e in range(begin, end):
        _ahead(
            first_step[e], first_step[e + 1], state, p, tangents, sticks, jolts, late_var, lengths,
            parameters, hold, acts, stick_of, parameters_of, inject_at, signal_of, step_signals, scale,
            slopes, matrix, q, work, rate, middle, middle_noise, moved, felt, added, coloured,
        )  # fmt: skip
        kind = kinds[e]
        for i in range(MOVING):
            states[e, i] = state[i]
        states[e, 10] = math.sqrt(p[2, 2])
        if kind == IMU or first_step[e + 1] == first_step[e]:
            # Only rates of tilt and speed jump with the stick: all else may use the last step's slopes.
            jacobian(state, commands[0, e], parameters, rate, slopes)
        else:
            spread(state, middle, middle_noise)
            derivative(middle, commands[0, e], middle_noise, parameters, rate)
        if kind == SONAR and sensor[RANGE_LAG] > 0.0:
            _turn_within_lag(e, times, states, sensor[RANGE_LAG], rate)
        measurement(
            kind, state, rate, slopes, sensor, parameters, hold[POLE], elapsed[e], predicted, by_rate,
            h_matrix,
        )  # fmt: skip
        if m > 0:
            direct_change(
                kind, e, state, rate, elapsed[e], parameters, hold[POLE], predicted, by_rate, commands,
                acts, reads, stick_of, parameters_of, sensor_of, inject_at, signal_of, event_signals, scale,
                felt, direct,
            )  # fmt: skip
        row = _take(
            e, kind, values[e], landing[e], jumps[e], predicted, h_matrix, rate, noise_var, rough, jitter_s,
            limits, state, p, memory, tangents, direct, innovation, log_variance, status, traces, row, ph,
            told, done, coloured,
        )  # fmt: skip
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
