"""Compiled sensitivities of the filter: the effect of a perturbation within a step and on a reading.

A perturbation is another value of a parameter of the equations or of an instrument, an early or late command,
or a signal injected into a force, a target or a channel. The sensitivity is the derivative of the filter's
state at fixed gains. Each costs one more evaluation of the equations, not one more filter.
"""

from __future__ import annotations

import math

from backend.compilation import inner_kernel
from backend.sparse_product import multiply_sparse
from slam.core.arrays import Array
from slam.criticism.kalman.arrays import FilterRun
from slam.criticism.kalman.readings import FIRST_CHANNEL, IMU, MOVING, WIDTH, reading
from slam.criticism.kalman.transition import NOISES, POLE, split_state
from slam.simulation.dynamics import COMMAND, GUST_X, GUST_Y, PITCH, ROLL, UP, VX, YAW, rates, thrust

STICKS = len(COMMAND)

CLIMB, AHEAD, ASIDE = NOISES, NOISES + 1, NOISES + 2
ENTRIES = NOISES + 3
"""Entries of forces: the noises, the climb stick, wind ahead and wind to the left."""
_INJECTED = 1e-3
ON_CHANNEL = 100
"""Entries from here on are channels of instruments, not forces."""


@inner_kernel
def _inject(entry: int, size: float, yaw: float, noise: Array, command: Array) -> None:
    """Add a signal to the ``noise`` (8,) or the ``command`` (6,)."""
    if entry < NOISES:
        noise[entry] += size
    elif entry == CLIMB:
        command[UP] += size
    elif entry == AHEAD:
        noise[GUST_X] += size * math.cos(yaw)
        noise[GUST_Y] += size * math.sin(yaw)
    else:
        noise[GUST_X] -= size * math.sin(yaw)
        noise[GUST_Y] += size * math.cos(yaw)


@inner_kernel
def _rate_change(state: Array, noise: Array, command: Array, rate: Array, filtered: FilterRun) -> None:
    """Write the rate to ``rate`` (12,), and its change by a unit at each used entry to ``rate_change``."""
    perturbations, changes, scratch = filtered.perturbations, filtered.changes, filtered.scratch
    parameters = filtered.model.parameters
    c, s = math.cos(state[YAW]), math.sin(state[YAW])
    ahead, aside = thrust(state[ROLL], state[PITCH], parameters)
    other, forced, moved = scratch.nudged_rate, scratch.forced, scratch.stick
    rate_change, is_used = changes.rate_change, changes.is_used
    rates(state, c, s, ahead, aside, command, noise, parameters, rate)
    is_used[:] = False
    for d in range(len(perturbations.changes_motion)):
        entry = perturbations.inject_at[d]
        if perturbations.changes_motion[d] == 0 or entry < 0 or is_used[entry]:
            continue
        is_used[entry] = True
        for i in range(NOISES):
            forced[i] = noise[i]
        for i in range(STICKS):
            moved[i] = command[i]
        _inject(entry, _INJECTED, state[YAW], forced, moved)
        rates(state, c, s, ahead, aside, moved, forced, parameters, other)
        for i in range(MOVING):
            rate_change[entry, i] = (other[i] - rate[i]) / _INJECTED


@inner_kernel
def _change_over_step(h: float, slopes: Array, change: Array, moved: Array) -> None:
    """Write the change of the state over a step by a ``change`` (10,) of the rate to ``moved`` (10,)."""
    for i in range(MOVING):
        total = change[i]
        for k in range(MOVING):
            total += 0.5 * h * slopes[i, k] * change[k]
        moved[i] = h * total


@inner_kernel
def force(s: int, filtered: FilterRun) -> None:
    """Add the direct effects of the perturbations within step ``s`` to the sensitivities."""
    command, model, perturbations = filtered.command, filtered.model, filtered.perturbations
    step, changes, scratch = filtered.step, filtered.changes, filtered.scratch
    sensitivity, h = filtered.estimate.sensitivity, filtered.events.step_s[s]
    slopes, middle, noise = step.slopes, step.middle, step.middle_noise
    added, change, rate, other = scratch.total, scratch.change, scratch.rate, scratch.other
    _rate_change(middle, noise, command.over_steps[0, s], rate, filtered)
    for entry in range(ENTRIES):
        if changes.is_used[entry]:
            _change_over_step(h, slopes, changes.rate_change[entry], changes.state_change[entry])
    c_yaw, s_yaw = math.cos(middle[YAW]), math.sin(middle[YAW])
    ahead, aside = thrust(middle[ROLL], middle[PITCH], model.parameters)
    for d in range(sensitivity.shape[1]):
        if perturbations.changes_motion[d] == 0:
            continue
        entry = perturbations.inject_at[d]
        if entry >= 0:
            signal = perturbations.step_signals[perturbations.signal_of[d], s]
            for i in range(MOVING):
                sensitivity[i, d] += changes.state_change[entry, i] * signal
        else:
            stick = command.over_steps[perturbations.stick_of[d], s]
            rates(middle, c_yaw, s_yaw, ahead, aside, stick, noise, perturbations.parameters_of[d], other)
            for i in range(MOVING):
                change[i] = (other[i] - rate[i]) * perturbations.scale[d]
            _change_over_step(h, slopes, change, added)
            for i in range(MOVING):
                sensitivity[i, d] += added[i]


@inner_kernel
def _read_by_imu(by_rate: Array, change: Array, read: Array) -> None:
    """Write the linear change of an IMU's readings by a ``change`` (10,) of the rate to ``read`` (6,)."""
    for c in range(WIDTH[IMU]):
        total = 0.0
        for i in range(VX, YAW + 1):
            total += by_rate[c, i] * change[i]
        read[c] = total


@inner_kernel
def direct_change(event: int, filtered: FilterRun) -> None:
    """Write the direct change of a reading by each perturbation to ``changes.direct``."""
    events, command, model = filtered.events, filtered.command, filtered.model
    perturbations, expected, changes = filtered.perturbations, filtered.expected, filtered.changes
    state, scratch = filtered.estimate.state, filtered.scratch
    kind, rate, pole_s = events.kinds[event], expected.rate, filtered.noise.hold[0, POLE]
    direct, full, noise, other = changes.direct, scratch.full, scratch.noise, scratch.other
    out, change = scratch.reading, scratch.change
    split_state(state, full, noise)
    c_yaw, s_yaw = math.cos(state[YAW]), math.sin(state[YAW])
    ahead, aside = thrust(state[ROLL], state[PITCH], model.parameters)
    if kind == IMU:
        _rate_change(full, noise, command.at_events[0, event], other, filtered)
        for entry in range(ENTRIES):
            if changes.is_used[entry]:
                _read_by_imu(expected.by_rate, changes.rate_change[entry], changes.imu_change[entry])
    for d in range(direct.shape[1]):
        for c in range(WIDTH[kind]):
            direct[c, d] = 0.0
        entry = perturbations.inject_at[d]
        if entry >= ON_CHANNEL:
            c = entry - ON_CHANNEL - FIRST_CHANNEL[kind]
            if 0 <= c < WIDTH[kind]:
                direct[c, d] = perturbations.event_signals[perturbations.signal_of[d], event]
        elif perturbations.changes_motion[d] == 1 and kind == IMU:
            if entry >= 0:
                signal = perturbations.event_signals[perturbations.signal_of[d], event]
                for c in range(WIDTH[kind]):
                    direct[c, d] = changes.imu_change[entry, c] * signal
            else:
                stick = command.at_events[perturbations.stick_of[d], event]
                rates(full, c_yaw, s_yaw, ahead, aside, stick, noise, perturbations.parameters_of[d], other)
                for i in range(MOVING):
                    change[i] = (other[i] - rate[i]) * perturbations.scale[d]
                _read_by_imu(expected.by_rate, change, out)
                for c in range(WIDTH[kind]):
                    direct[c, d] = out[c]
        elif (perturbations.instrument_mask[d] >> kind) & 1:
            sensor, parameters = perturbations.sensor_of[d], perturbations.parameters_of[d]
            reading(kind, state, rate, sensor, parameters, pole_s, events.elapsed[event], out)
            for c in range(WIDTH[kind]):
                direct[c, d] = (out[c] - expected.reading[c]) * perturbations.scale[d]


@inner_kernel
def carry(matrix: Array, sensitivity: Array, moved: Array) -> None:
    """Propagate sensitivities (n, m) over a step in place; ``moved`` (n, >= m) is a buffer."""
    n, m = sensitivity.shape
    multiply_sparse(matrix, sensitivity, n, m, moved)
    for i in range(n):
        for d in range(m):
            sensitivity[i, d] = moved[i, d]


@inner_kernel
def add_multiple(factor: float, row: Array, target: Array) -> None:
    """Add ``factor`` times ``row`` to the equally long ``target``, in place."""
    for d in range(len(target)):
        target[d] += factor * row[d]


@inner_kernel
def correct_sensitivity(
    h: Array, direct: Array, ph: Array, s_var: float, sensitivity: Array, change: Array
) -> None:
    """Write the change of the prediction of a reading with row ``h`` (n,) to ``change`` (m,).

    Then correct the sensitivities by the reading, with the gain of the state."""
    for d in range(len(change)):
        change[d] = direct[d]
    for k in range(len(h)):
        if h[k] != 0.0:
            add_multiple(h[k], sensitivity[k], change)
    for i in range(len(ph)):
        add_multiple(-ph[i] / s_var, change, sensitivity[i])
