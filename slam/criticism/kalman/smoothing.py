"""Where the vehicle was at given moments, from all readings before and after, and how well that is known.

A Kalman filter over the simulator's equations, then Rauch's smoother backwards. The error of the smoothed
path is independent of the filter's innovations, so what another instrument (a camera) says about the path
multiplies the likelihood of the readings. Going back in time that error is a Markov chain,
e_i = A_i e_(i+1) + white, which gives the covariance between any two moments.
Source: Rauch, Tung and Striebel 1965.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.compiled import kernel
from slam.criticism.kalman.filter import start_noise
from slam.criticism.kalman.readings import (
    ATTITUDE,
    CHANNELS,
    FIRST_CHANNEL,
    INSTRUMENT_OF,
    MOVING,
    SONAR,
    STATES,
    WIDTH,
    reading,
)
from slam.criticism.kalman.record import Record, steps_between
from slam.criticism.kalman.setting import Setting
from slam.criticism.kalman.steps import (
    correct,
    is_outlier,
    judged,
    measurement,
    miss_of,
    predict,
    spread_along,
)
from slam.criticism.kalman.tangents import Direction, tangents_for
from slam.criticism.kalman.transition import POLE, jacobian

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

POSE = (0, 1, 2, 6, 7, 8)
"""Entries of the state that place a camera: x, y, z, roll, pitch, yaw."""
LEAST_HALF_S = 0.004
_TINY = 1e-13
"""Variance added before an inverse: the start is known exactly in some axes."""


@dataclass(frozen=True)
class Path:
    """The smoothed path at some moments of a flight."""

    times_s: Array
    """(n,)."""
    poses: Array
    """(n, 6) x, y, z, roll, pitch, yaw."""
    rates: Array
    """(n, 6) of these."""
    bends: Array
    """(n, 6) of the rates."""
    covariance: Array
    """(6 n, 6 n) of all poses together."""
    traces: Array
    """(6 n, directions): change of the smoothed poses with each direction."""


def smoothed(
    record: Record,
    setting: Setting,
    times_s: Array,
    directions: Sequence[Direction] = (),
    half_s: float = 0.0,
) -> Path:
    """The path at ``times_s`` within the record's time, with the traces of directions of the instruments.

    Rates and bends make a parabola through where the vehicle was ``half_s`` before and after each moment.
    """
    half_s = max(half_s, LEAST_HALF_S)
    record = _with_moments(record, (times_s[:, None] + half_s * np.array([-1.0, 0.0, 1.0])).ravel())
    table = tangents_for(record, setting, directions, {})
    start = np.zeros(STATES)
    start[:10] = record.start
    p = np.zeros((STATES, STATES))
    p[np.arange(10), np.arange(10)] = record.start_std**2
    start_noise(setting.hold, p)
    # Coloured noise counts as the white noise that averages out as slowly.
    colour = setting.colour[list(INSTRUMENT_OF)]
    noise_var = (record.noise_std * setting.noise_factor) ** 2 * (1.0 + colour) / (1.0 - colour)
    forward = _forward(
        record.times_s, record.kinds, record.values, record.elapsed, record.landing, table.jumps,
        record.first_step, record.step_s, table.sticks[0], table.jolts, setting.late_std_s**2,
        table.commands[0],
        setting.parameters, setting.sensor, setting.hold, noise_var, record.range_limits, start, p,
        np.zeros(len(CHANNELS)),
        table.reads, table.sensor_of, table.scale,
    )  # fmt: skip
    at = np.flatnonzero(record.kinds == _MOMENT)
    states, chain, spreads, traces = _backward(*forward, at)
    before, poses, after = (states[k::3, POSE] for k in range(3))
    between = chain[1:-2:3] @ chain[2:-1:3] @ chain[3::3]
    return Path(
        times_s,
        poses,
        (after - before) / (2 * half_s),
        (after + before - 2 * poses) / half_s**2,
        _joint(between, spreads[1::3]),
        traces[1::3, POSE].reshape(len(times_s) * 6, len(directions)),
    )


_MOMENT = ATTITUDE + 100
"""Kind of an event at which nothing is read."""


def _with_moments(record: Record, times_s: Array) -> Record:
    """The record with events at which nothing is read."""
    times = np.concatenate([record.times_s, times_s])
    order = np.argsort(times, kind="stable")
    times = times[order]
    kinds = np.concatenate([record.kinds, np.full(len(times_s), _MOMENT)])[order]
    values = np.concatenate([record.values, np.full((len(times_s), 6), np.nan)])[order]
    landing = np.concatenate([record.landing, np.zeros(len(times_s), dtype=bool)])[order]
    first_step, begin, lengths = steps_between(times)
    return replace(
        record, times_s=times, kinds=kinds, values=values, landing=landing,
        elapsed=np.clip(times / times[-1], 0.0, 1.0), first_step=first_step, step_begin_s=begin,
        step_s=lengths,
    )  # fmt: skip


@kernel
def _forward(  # type: ignore[no-untyped-def]
    times: Array, kinds: Ints, values: Array, elapsed: Array, landing: Flags, jumps: Ints, first_step: Ints,
    lengths: Array, sticks: Array, jolts: Array, late_var: float, commands: Array, parameters: Array,
    sensor: Array, hold: Array, noise_var: Array, limits: Array, start: Array, p: Array, memory: Array,
    reads: Ints, sensor_of: Array, scale: Array,
):  # fmt: skip
    """Before and after each event: mean, covariance and tangents; and the transition to it from the last."""
    n, m, events = start.shape[0], reads.shape[0], len(times)
    state, tangents = start.copy(), np.zeros((n, m))
    x_before, x_after = np.empty((events, n)), np.empty((events, n))
    p_before, p_after = np.empty((events, n, n)), np.empty((events, n, n))
    t_before, t_after = np.empty((events, n, m)), np.empty((events, n, m))
    moves = np.empty((events, n, n))
    slopes, matrix, q, work = np.empty((MOVING, n)), np.zeros((n, n)), np.zeros((n, n)), np.empty((n, n))
    rate, middle, middle_noise = np.empty(12), np.empty(12), np.empty(8)
    predicted, h_matrix, direct = np.empty(6), np.zeros((6, n)), np.zeros((6, m))
    by_rate = np.zeros((6, MOVING))
    out, ph, done, moved = np.empty(6), np.empty(n), np.empty(n), np.eye(n)
    for e in range(events):
        total = np.eye(n)
        for s in range(first_step[e], first_step[e + 1]):
            predict(
                state, p, sticks[s], jolts[s], late_var, parameters, hold, lengths[s], slopes, matrix, q,
                work, rate, middle, middle_noise,
            )  # fmt: skip
            moved[:] = np.dot(matrix, total)
            total[:] = moved
        tangents = np.dot(total, tangents)
        moves[e], x_before[e], p_before[e], t_before[e] = total, state, p, tangents
        kind = kinds[e]
        if kind <= SONAR:
            jacobian(state, commands[e], parameters, rate, slopes)
            measurement(
                kind, state, rate, slopes, sensor, parameters, hold[POLE], elapsed[e], predicted,
                by_rate, h_matrix,
            )  # fmt: skip
            for d in range(m):
                direct[:, d] = 0.0
                if (reads[d] >> kind) & 1:
                    reading(kind, state, rate, sensor_of[d], parameters, hold[POLE], elapsed[e], out)
                    for c in range(WIDTH[kind]):
                        direct[c, d] = (out[c] - predicted[c]) * scale[d]
            done[:] = 0.0
            for c in range(WIDTH[kind]):
                channel = FIRST_CHANNEL[kind] + c
                noise = noise_var[channel]
                if not judged(kind, channel, values[e, c], predicted[c], noise, landing[e], jumps[e], limits):
                    continue
                s_var = noise + spread_along(p, h_matrix[c], ph)
                miss = miss_of(kind, c, values[e, c], predicted[c], h_matrix[c], done)
                if is_outlier(miss, math.sqrt(s_var), channel, memory):
                    continue
                for d in range(m):
                    a = direct[c, d]
                    for k in range(n):
                        a += h_matrix[c, k] * tangents[k, d]
                    for k in range(n):
                        tangents[k, d] -= ph[k] / s_var * a
                correct(state, p, ph, s_var, miss, done)
        x_after[e], p_after[e], t_after[e] = state, p, tangents
    return x_before, x_after, p_before, p_after, t_before, t_after, moves


@kernel
def _backward(  # type: ignore[no-untyped-def]
    x_before: Array, x_after: Array, p_before: Array, p_after: Array, t_before: Array, t_after: Array,
    moves: Array, at: Ints,
):  # fmt: skip
    """At the events ``at``: states (k, n), A to the next (k, n, n), covariances, tangents (k, n, m)."""
    events, n = x_before.shape
    m, count = t_before.shape[2], len(at)
    states, traces = np.empty((count, n)), np.empty((count, n, m))
    chain, spreads = np.zeros((count, n, n)), np.empty((count, n, n))
    x, p, t, a = x_after[-1].copy(), p_after[-1].copy(), t_after[-1].copy(), np.eye(n)
    k = count - 1
    for e in range(events - 1, -1, -1):
        if e < events - 1:
            before = p_before[e + 1] + _TINY * np.eye(n)
            gain = np.linalg.solve(before, np.dot(moves[e + 1], p_after[e])).T.copy()
            x = x_after[e] + np.dot(gain, x - x_before[e + 1])
            p = p_after[e] + np.dot(np.dot(gain, p - p_before[e + 1]), gain.T)
            t = t_after[e] + np.dot(gain, t - t_before[e + 1])
            a = np.dot(gain, a)
        if k >= 0 and at[k] == e:
            states[k], spreads[k], traces[k], chain[k] = x, 0.5 * (p + p.T), t, a
            a = np.eye(n)
            k -= 1
    return states, chain, spreads, traces


def _joint(chain: Array, spreads: Array) -> Array:
    """(6 n, 6 n) covariance of the poses from the backward chain of the whole state."""
    n = len(spreads)
    joint = np.empty((n, 6, n, 6))
    for j in range(n):
        cross = spreads[j]
        joint[j, :, j] = cross[np.ix_(POSE, POSE)]
        for i in range(j - 1, -1, -1):
            cross = chain[i] @ cross
            joint[i, :, j] = cross[np.ix_(POSE, POSE)]
            joint[j, :, i] = joint[i, :, j].T
    return joint.reshape(6 * n, 6 * n)
