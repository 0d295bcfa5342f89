"""What filter and smoother do alike, compiled: one step ahead, and what to make of one reading.

Readings are scalars, taken one after the other: P h' is (n,), the innovation's variance a number.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.compiled import kernel
from slam.criticism.kalman.readings import ATTITUDE, BEFORE, BEHIND, IMU, MOVING, SONAR, WIDTH, reading
from slam.criticism.kalman.transition import covariance_step, jacobian, kicks, mean_step, transition
from slam.simulation.dynamics import GEAR, derivative, noise_share

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

GATE = 6.0
"""An innovation beyond so many standard deviations is an outlier: it is kept out of the state."""
STREAK = 2
"""So many outliers of a channel in a row are none: then the model is wrong, not the reading."""
CONTACT_M = 0.03
CONTACT_NOISE = 0.3
"""Process noise of the velocity while the gear settles, m/s/sqrt(s): its bounce differs between vehicles."""
STANDS_M_S = 0.05
"""Who stands on the floor is no faster up or down."""
UP = 2
"""Entry of the stick."""
SONAR_MARGIN = 4.0
"""Ranges due so many standard deviations from the limits, and beyond, are not judged: half are missing."""


_NUDGE = 1e-6
_NONE = -1
RATES_READ = (
    (3, 4, 5, 6, 7, 8), (6, 7, 8, _NONE, _NONE, _NONE), (0, 1, 3, 4, 6, 7), (0, 1, 2, 5, 6, 7),
)  # fmt: skip
"""For each kind of event, entries of the state's rate that its reading may depend on, ..."""
STATES_READ = (
    (6, 7, 8, _NONE, _NONE, _NONE), (6, 7, 8, _NONE, _NONE, _NONE), (2, 8, _NONE, _NONE, _NONE, _NONE),
    (0, 1, 2, 6, 7, 8),
)  # fmt: skip
"""... and of the state itself, the noise's acceleration aside."""


@kernel
def settling(state: Array, p: Array, stick: Array, parameters: Array) -> bool:
    """Whether the gear may hit the floor, or just did. Who stands there, or is told to climb, is not shaken
    by it: there the height is known."""
    if stick[UP] > 0.0 or abs(state[5]) < STANDS_M_S:
        return False
    return bool(state[2] - parameters[GEAR] < CONTACT_M + 3.0 * math.sqrt(p[2, 2]))


@kernel
def predict(
    state: Array, p: Array, stick: Array, jolt: Array, late_var: float, parameters: Array, hold: Array,
    h: float, slopes: Array, matrix: Array, q: Array, work: Array, rate: Array, middle: Array,
    middle_noise: Array,
) -> None:  # fmt: skip
    """State (n,) and covariance (n, n) ahead by h, in place. Written: ``slopes`` (10, n) and the transition
    ``matrix`` (n, n) of the step, ``middle`` (12,) and ``middle_noise`` (8,) half-way.

    ``jolt`` (6,) is how far the stick jumps within the step, at a moment of the variance ``late_var``.
    """
    jacobian(state, stick, parameters, rate, slopes)
    transition(slopes, hold, h, matrix)
    kicks(hold, matrix, q)
    mean_step(state, stick, hold, matrix, parameters, h, rate, middle, middle_noise)
    covariance_step(matrix, q, slopes, h, p, work)
    if late_var > 0.0:
        _unsure(state, p, stick, jolt, late_var, parameters, rate, middle_noise)
    if settling(state, p, stick, parameters):
        for i in range(3, 6):
            p[i, i] += CONTACT_NOISE**2 * h


@kernel
def _unsure(
    state: Array, p: Array, stick: Array, jolt: Array, late_var: float, parameters: Array, rate: Array,
    noise: Array,
) -> None:  # fmt: skip
    """A jump that comes t late leaves the state off by t times the jump of its rate."""
    if not jolt[:5].any():
        return
    full, other = np.empty(12), np.empty(12)
    for i in range(MOVING):
        full[i] = state[i]
    full[10], full[11] = state[0], state[1]
    derivative(full, stick, noise, parameters, rate)
    derivative(full, stick + jolt, noise, parameters, other)
    for i in range(MOVING):
        for j in range(MOVING):
            p[i, j] += late_var * (other[i] - rate[i]) * (other[j] - rate[j])


@kernel
def measurement(
    kind: int, state: Array, rate: Array, slopes: Array, sensor: Array, parameters: Array,
    pole_s: float, elapsed: float, predicted: Array, by_rate: Array, matrix: Array,
) -> None:  # fmt: skip
    """What is read, its Jacobian ``by_rate`` (6, 10) in the state's rate, and ``matrix`` (6, n) in the state:
    by itself and through its rate."""
    reading(kind, state, rate, sensor, parameters, pole_s, elapsed, predicted)
    beside, nudged, moved = np.empty(6), state.copy(), rate.copy()
    width = WIDTH[kind]
    matrix[:], by_rate[:] = 0.0, 0.0
    for j in RATES_READ[kind]:
        if j < 0:
            break
        moved[j] += _NUDGE
        reading(kind, state, moved, sensor, parameters, pole_s, elapsed, beside)
        moved[j] = rate[j]
        for c in range(width):
            x = (beside[c] - predicted[c]) / _NUDGE
            by_rate[c, j] = x
            if x != 0.0:
                for i in range(state.shape[0]):
                    matrix[c, i] += x * slopes[j, i]
    for j in STATES_READ[kind]:
        if j < 0:
            break
        nudged[j] += _NUDGE
        reading(kind, nudged, rate, sensor, parameters, pole_s, elapsed, beside)
        nudged[j] = state[j]
        for c in range(width):
            matrix[c, j] += (beside[c] - predicted[c]) / _NUDGE
    if kind == IMU:
        # The acceleration of the noise is read as any other is.
        fast = noise_share(state[2], parameters) / pole_s
        for c in range(3, 6):
            for i in range(3):
                matrix[c, BEFORE + i] += fast * by_rate[c, 3 + i]
                matrix[c, BEHIND + i] -= fast * by_rate[c, 3 + i]


@kernel
def judged(
    kind: int, channel: int, value: float, predicted: float, noise_var: float, landing: bool, jump: int,
    limits: Array,
) -> bool:  # fmt: skip
    """Whether a reading says anything: not a missing one, none but ranges while ``landing``, the first
    ``jump`` channels of the IMU beside a jump of the stick, or a range that may be cut.

    The floor turns what meets it level, and holds it. Believed to the moment, or of a vehicle that a cushion
    of air keeps just above it, that outweighs all that the rest of a flight says of an effect.
    """
    if math.isnan(value):
        return False
    if landing and kind != SONAR:
        return False
    if channel < jump:
        return False
    if kind == SONAR:
        margin = SONAR_MARGIN * math.sqrt(noise_var)
        return bool(limits[0] + margin <= predicted <= limits[1] - margin)
    return True


@kernel
def spread_along(p: Array, row: Array, ph: Array) -> float:
    """Write P h' into ``ph`` (n,) for a ``row`` h (n,) and return h P h'."""
    n = row.shape[0]
    for i in range(n):
        ph[i] = 0.0
    for k in range(n):
        x = row[k]
        if x != 0.0:
            for i in range(n):
                ph[i] += p[k, i] * x
    total = 0.0
    for i in range(n):
        total += row[i] * ph[i]
    return total


@kernel
def miss_of(kind: int, c: int, value: float, predicted: float, row: Array, done: Array) -> float:
    """Reading less prediction, with what earlier channels of the event did (``done``); a heading turned."""
    miss = value - predicted
    for i in range(row.shape[0]):
        miss -= row[i] * done[i]
    if kind == ATTITUDE and c == 2:
        miss -= 2.0 * math.pi * math.floor(miss / (2.0 * math.pi) + 0.5)
    return miss


@kernel
def is_outlier(miss: float, std: float, channel: int, memory: Array) -> bool:
    """Whether a reading is kept out; ``memory[channel]`` counts how many were in a row."""
    if abs(miss) > GATE * std and memory[channel] < STREAK:
        memory[channel] += 1.0
        return True
    memory[channel] = 0.0
    return False


@kernel
def correct(state: Array, p: Array, ph: Array, s_var: float, miss: float, done: Array) -> None:
    """Take a reading's miss, of variance ``s_var``, into state and covariance."""
    n = state.shape[0]
    for i in range(n):
        step = ph[i] / s_var * miss
        done[i] += step
        state[i] += step
    for i in range(n):
        x = ph[i] / s_var
        for k in range(n):
            p[i, k] -= x * ph[k]
