"""Tangents through the filter, compiled: what a perturbation does within a step, and to a reading.

A perturbation is another value of a parameter of the equations or of an instrument, an early or late command,
or a signal injected into a force, a target or a channel. Its tangent is how the filter's state changes with
it while the gains stay; each costs one more evaluation of the equations, not one more filter.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.compiled import kernel
from slam.criticism.kalman.readings import BEFORE, BEHIND, FIRST_CHANNEL, GUST, IMU, MOVING, WIDTH, reading
from slam.criticism.kalman.transition import spread
from slam.simulation.dynamics import rates, thrust

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

ENTRIES = 11
"""Places that a force may go in at (``_inject``)."""
_INJECTED = 1e-3
ON_CHANNEL = 100
"""Entries from here on are channels of instruments, not forces."""


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
    seen = np.zeros(ENTRIES, dtype=np.bool_)
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
def force(
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
def direct_change(
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
        if inject_at[d] >= ON_CHANNEL:
            c = inject_at[d] - ON_CHANNEL - FIRST_CHANNEL[kind]
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
def carry(matrix: Array, tangents: Array, moved: Array) -> None:
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
def tell(h: Array, direct: Array, ph: Array, s_var: float, tangents: Array, told: Array) -> None:
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
