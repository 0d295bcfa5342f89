"""Open-loop roll-outs: predictions of the equations alone from a filtered state, against later measurements.

This is the simulator's error after half a second, two and ten.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backend.compilation import allocating_kernel
from frontend.cores import in_threads
from slam.core.arrays import Array, Ints
from slam.criticism.cause import ChannelError
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.readings import (
    ATTITUDE,
    BEYOND_IMU,
    CHANNEL_UNITS,
    CHANNELS,
    FIRST_CHANNEL,
    IMU,
    MOVING,
    STATES,
    WIDTH,
    reading,
)
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.sensitivity import STICKS
from slam.criticism.kalman.transition import FULL, NOISES, POLE
from slam.simulation.dynamics import derivative, integrate
from slam.simulation.replay.compare import HORIZONS_S

STEP_S = 0.01
START_EVERY_S = 2.0
SETTLE_S = 1.0
"""Time after which roll-outs start: in its first second the filter does not know the vehicle yet."""


def rollout_errors(
    records: Sequence[Record], before: Sequence[FilterParameters], after: Sequence[FilterParameters]
) -> tuple[ChannelError, ...]:
    """Return the errors of all channels but the imu's, pooled over the flights."""
    each_parameters = (*before, *after)
    flights = (*records, *records)
    states = in_threads(lambda k: whole(flights[k], each_parameters[k]).states, range(len(flights)))
    sides = slice(0, len(records)), slice(len(records), None)
    found = []
    for horizon in HORIZONS_S:
        pooled = [
            pooled_residuals(flights[side], states[side], each_parameters[side], horizon) for side in sides
        ]
        for channel in BEYOND_IMU:
            errors = [of[channel] for of in pooled]
            if len(errors[0]) and len(errors[1]):
                rms = [float(np.sqrt(np.mean(e**2))) for e in errors]
                found.append(ChannelError(CHANNELS[channel], CHANNEL_UNITS[channel], horizon, rms[0], rms[1]))
    return tuple(found)


def pooled_residuals(
    records: Sequence[Record],
    filtered: Sequence[Array],
    parameters: Sequence[FilterParameters],
    horizon_s: float,
    share: float = 0.25,
) -> dict[int, Array]:
    """Return channel -> ``rollout_residuals`` of all flights, of all channels but the imu's."""
    each = [
        rollout_residuals(*of, horizon_s, share) for of in zip(records, filtered, parameters, strict=True)
    ]
    return {c: np.concatenate([errors[c] for errors in each]) for c in BEYOND_IMU}


def rollout_residuals(
    record: Record, filtered: Array, parameters: FilterParameters, horizon_s: float, share: float = 0.25
) -> dict[int, Array]:
    """Return channel -> errors over the last share of the horizon, of roll-outs started every other second.

    ``filtered`` (events, >= 10) are their initial states.
    """
    states = filtered[:, :MOVING]
    first, last = record.times_s[0] + SETTLE_S, record.times_s[-1] - horizon_s
    begins = np.arange(first, last, START_EVERY_S)
    empty: dict[int, Array] = {c: np.zeros(0) for c in range(len(CHANNELS))}
    if len(begins) == 0:
        return empty
    start_at = np.searchsorted(record.times_s, begins)
    begins = record.times_s[start_at]
    steps = round(horizon_s / STEP_S)
    start = np.column_stack([states[start_at], states[start_at, :2]])
    nodes = begins[:, None] + STEP_S * np.arange(steps + 1)
    fast = 1.0 + parameters.drift
    command = record.stick.mean(
        nodes[:, :-1].ravel() / fast, nodes[:, 1:].ravel() / fast, parameters.latency_s
    )
    path = integrate(
        start, command.reshape(len(begins), steps, STICKS), np.zeros((1, steps + 1, NOISES)),
        np.tile(parameters.dynamics, (len(begins), 1)), STEP_S,
    )  # fmt: skip
    errors: dict[int, list[Array]] = {c: [] for c in range(len(CHANNELS))}
    for k, begin in enumerate(begins):
        judged = (record.times_s > begin + (1.0 - share) * horizon_s) & (record.times_s <= begin + horizon_s)
        judged &= record.kinds != IMU
        rows = np.flatnonzero(judged)
        at = np.column_stack([np.interp(record.times_s[rows], nodes[k], path[k, :, i]) for i in range(FULL)])
        commands = record.stick.at(record.times_s[rows] / fast, parameters.latency_s)
        own = parameters.dynamics, parameters.sensor, parameters.hold[POLE]
        predicted = _noise_free_readings(record.kinds[rows], at, commands, *own, record.elapsed[rows])
        for kind in np.unique(record.kinds[rows]):
            of_kind = record.kinds[rows] == kind
            for c in range(WIDTH[kind]):
                error = record.values[rows[of_kind], c] - predicted[of_kind, c]
                if kind == ATTITUDE and c == 2:
                    error = np.angle(np.exp(1j * error))
                if np.isfinite(error).any():
                    errors[FIRST_CHANNEL[kind] + c].append(error[np.isfinite(error)])
    return {c: np.concatenate(m) if m else np.zeros(0) for c, m in errors.items()}


@allocating_kernel
def _noise_free_readings(
    kinds: Ints, at: Array, commands: Array, parameters: Array, sensor: Array, pole_s: float, elapsed: Array
) -> Array:
    """Return (events, 6) noise-free readings in the states ``at`` (events, 12)."""
    predicted, rate = np.zeros((len(kinds), WIDTH[IMU])), np.zeros(FULL)
    state, noise = np.zeros(STATES), np.zeros(NOISES)
    for e in range(len(kinds)):
        derivative(at[e], commands[e], noise, parameters, rate)
        for i in range(MOVING):  # an assignment of a slice takes seconds to compile
            state[i] = at[e, i]
        reading(kinds[e], state, rate, sensor, parameters, pole_s, elapsed[e], predicted[e])
    return predicted
