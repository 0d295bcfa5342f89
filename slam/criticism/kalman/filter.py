"""Extended Kalman filter over the simulator's equations, with sensitivities; compiled.

The filter processes the readings in order of time, one scalar at a time. Under the model each innovation
over its standard deviation is white with variance 1. Their product is the exact likelihood of the flight, up
to the linearisation. The filter also computes sensitivities: the derivatives of the mean and of each
innovation with respect to perturbations (see ``kernel_inputs.Perturbation``) at fixed gains. They are the
exact linear sensitivity of the whitened innovations, with the effect of the filter.
"""

from __future__ import annotations

import math

from backend.compilation import inlined_kernel, inner_kernel, kernel
from slam.core.arrays import Array
from slam.criticism.kalman.arrays import FilterRun
from slam.criticism.kalman.noise import (
    WHITE,
    correct_changes,
    correct_covariance,
    predict_covariance,
    predict_shift,
    sample,
    variance_of,
)
from slam.criticism.kalman.readings import (
    ATTITUDE,
    BEFORE,
    BEHIND,
    FIRST_CHANNEL,
    IMU,
    MOMENT,
    MOVING,
    RANGE_LAG,
    RATES_READ,
    SONAR,
    STATES_READ,
    WIDTH,
    reading,
)
from slam.criticism.kalman.sensitivity import carry, correct_sensitivity, direct_change, force
from slam.criticism.kalman.transition import (
    NUDGE,
    POLE,
    add_shocks,
    jacobian,
    mean_step,
    split_state,
    transition,
)
from slam.simulation.dynamics import DISCHARGE, GEAR, PITCH, ROLL, UP, VX, VZ, Z, derivative, noise_share

USED, OUTLIER, IGNORED = 1, 2, 0
Z_STD = MOVING
"""Column of the recorded states that holds the standard deviation of z; it follows the moving state."""
GATE = 6.0
"""An innovation beyond so many standard deviations is an outlier and does not update the state."""
STREAK = 2
"""Number of successive outliers of a channel after which readings are used again: the model is wrong then."""
CONTACT_M = 0.03
CONTACT_NOISE = 0.3
"""Process noise of the velocity while the gear settles, m/s/sqrt(s): its bounce differs between vehicles."""
STANDS_M_S = 0.05
"""Greatest vertical speed of a vehicle that stands on the floor, in m/s."""
SONAR_MARGIN = 4.0
"""Ranges predicted within so many standard deviations of the limits are ignored: half of them are missing."""


@inlined_kernel
def predict(s: int, filtered: FilterRun) -> None:
    """Predict mean and covariances over step ``s``, and write the step's matrices into ``filtered.step``."""
    command, model, step, scratch = filtered.command, filtered.model, filtered.step, filtered.scratch
    state, p, h = filtered.estimate.state, filtered.estimate.p, filtered.events.step_s[s]
    for i in range(len(state)):
        step.before[i] = state[i]
    stick, jump, late_s = command.over_steps[0, s], command.stick_jumps[s], math.sqrt(command.late_var_s2)
    jacobian(state, stick, model.parameters, step.rate, step.slopes, scratch)
    transition(step.slopes, filtered.noise.hold[0], h, step.matrix)
    mean_step(h, state, stick, model, step, scratch)
    step.late_stick_noise[:], step.contact_variance[:] = 0.0, 0.0
    size = 0.0
    for i in range(DISCHARGE):  # the share of the charge changes steadily
        size += abs(jump[i])
    if late_s * size > 0.0:
        # A jump of the stick that is t late shifts the state by t times the jump of its rate.
        full, other, moved, late = scratch.full, scratch.nudged_rate, scratch.stick, step.late_stick_noise
        for i in range(len(stick)):
            moved[i] = stick[i] + jump[i]
        split_state(state, full, scratch.noise)
        derivative(full, stick, step.middle_noise, model.parameters, step.rate)
        derivative(full, moved, step.middle_noise, model.parameters, other)
        for i in range(MOVING):
            late[i] = late_s * (other[i] - step.rate[i])
    # The gear may be hitting the floor: not while standing, or while commanded to climb.
    sinks = stick[UP] <= 0.0 and abs(state[VZ]) >= STANDS_M_S
    above_m = state[Z] - model.parameters[GEAR] - CONTACT_M
    for c in range(len(p)):
        predict_covariance(c, h, filtered)
        if c == 0 and sinks and above_m < 3.0 * math.sqrt(p[0, Z, Z]):
            for i in range(VX, VZ + 1):
                step.contact_variance[i] = CONTACT_NOISE**2 * h
        add_shocks(step, p[c])
    predict_shift(filtered)


@inner_kernel
def measurement(event: int, filtered: FilterRun) -> None:
    """Predict the reading of an event without AR(1) noise, and its Jacobians in the rate and in the state,
    the latter with the path through the rate."""
    events, model, expected, scratch = filtered.events, filtered.model, filtered.expected, filtered.scratch
    kind, elapsed, state = events.kinds[event], events.elapsed[event], filtered.estimate.state
    sensor, parameters, pole_s = model.sensor, model.parameters, filtered.noise.hold[0, POLE]
    rate, predicted, rows, by_rate = expected.rate, expected.reading, expected.rows, expected.by_rate
    reading(kind, state, rate, sensor, parameters, pole_s, elapsed, predicted)
    beside, nudged, moved = scratch.reading, scratch.nudged, scratch.rate
    for i in range(len(state)):
        nudged[i] = state[i]
    for i in range(len(rate)):
        moved[i] = rate[i]
    width = WIDTH[kind]
    rows[:], by_rate[:] = 0.0, 0.0
    for j in RATES_READ[kind]:
        if j < 0:
            break
        moved[j] += NUDGE
        reading(kind, state, moved, sensor, parameters, pole_s, elapsed, beside)
        moved[j] = rate[j]
        for c in range(width):
            x = (beside[c] - predicted[c]) / NUDGE
            by_rate[c, j] = x
            if x != 0.0:
                for i in range(state.shape[0]):
                    rows[c, i] += x * filtered.step.slopes[j, i]
    for j in STATES_READ[kind]:
        if j < 0:
            break
        nudged[j] += NUDGE
        reading(kind, nudged, rate, sensor, parameters, pole_s, elapsed, beside)
        nudged[j] = state[j]
        for c in range(width):
            rows[c, j] += (beside[c] - predicted[c]) / NUDGE
    if kind == IMU:
        # The IMU reads the acceleration of the noise like any other.
        fast = noise_share(state[Z], parameters) / pole_s
        for c in range(3, 6):
            for i in range(3):
                rows[c, BEFORE + i] += fast * by_rate[c, VX + i]
                rows[c, BEHIND + i] -= fast * by_rate[c, VX + i]
    for c in range(width):
        noise = model.ar1_state[FIRST_CHANNEL[kind] + c]
        if noise != WHITE:
            rows[c, noise] = 1.0


@inner_kernel
def judged(event: int, c: int, filtered: FilterRun) -> bool:
    """Return whether channel c of an event is used.

    It is not if it is missing, may be spoilt by a jump of the stick, or is a range near the sonar's limits.
    During a landing only ranges are used: the floor levels and holds the vehicle. A small error of the
    contact time would otherwise outweigh the rest of the flight.
    """
    events, model = filtered.events, filtered.model
    kind = events.kinds[event]
    channel = FIRST_CHANNEL[kind] + c
    spoilt = (events.landing[event] and kind != SONAR) or channel < filtered.noise.spoilt_channels[0, event]
    if spoilt or math.isnan(events.values[event, c]):
        return False
    if kind == SONAR:
        margin = SONAR_MARGIN * math.sqrt(filtered.noise.variance[0, channel])
        least, greatest = model.range_limits_m[0] + margin, model.range_limits_m[1] - margin
        return bool(least <= filtered.expected.reading[c] <= greatest)
    return True


@inner_kernel
def _turn_within_lag(event: int, times: Array, states: Array, lag_s: float, rate: Array) -> None:
    """Replace the rates of roll and pitch at an event by their means over the sonar's lag before it.

    A tilt can begin and end within a lag; a linear extrapolation over the lag would then be wrong.
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


@inner_kernel
def update(event: int, filtered: FilterRun) -> None:
    """Update the estimate with the channels of one event, one scalar after the other.

    Each is compared with its prediction as the earlier ones have corrected it.
    """
    events, model, estimate = filtered.events, filtered.model, filtered.estimate
    expected, changes, written = filtered.expected, filtered.changes, filtered.written
    kind, ph, change = events.kinds[event], expected.ph, changes.predicted_change
    state, correction, streak = estimate.state, expected.correction, estimate.outlier_streak
    correction[:] = 0.0
    sample(event, filtered)
    for c in range(WIDTH[kind]):
        written.status[event, c] = IGNORED
        if not judged(event, c, filtered):
            continue
        channel, value, row = FIRST_CHANNEL[kind] + c, events.values[event, c], expected.rows[c]
        noise, s_var = model.ar1_state[channel], variance_of(0, channel, row, ph, filtered)
        if noise != WHITE:
            value -= state[noise] - correction[noise]
        miss, std = value - expected.reading[c], math.sqrt(s_var)
        for i in range(len(state)):
            miss -= row[i] * correction[i]
        if kind == ATTITUDE and c == 2:  # headings are wrapped
            miss -= 2.0 * math.pi * math.floor(miss / (2.0 * math.pi) + 0.5)
        written.innovation[event, c] = miss / std
        written.log_variance[event, c] = math.log(s_var)
        if abs(miss) > GATE * std and streak[channel] < STREAK:
            streak[channel] += 1.0
            written.status[event, c] = OUTLIER
            continue
        streak[channel] = 0.0
        written.status[event, c] = USED
        if estimate.sensitivity.shape[1] > 0:
            correct_sensitivity(row, changes.direct[c], ph, s_var, estimate.sensitivity, change)
            for d in range(change.shape[0]):
                written.sensitivity[written.rows[0], d] = change[d] / std
        correct_changes(event, c, miss, s_var, filtered)
        written.rows[0] += 1
        for i in range(len(state)):
            step = ph[i] / s_var * miss
            correction[i] += step
            state[i] += step
        correct_covariance(ph, s_var, estimate.p[0])


@inner_kernel
def _keep(side: int, e: int, filtered: FilterRun) -> None:
    """Write the estimate before (0) or after (1) an event into the history."""
    estimate, history = filtered.estimate, filtered.history
    for i in range(len(estimate.state)):
        history.x[side, e, i] = estimate.state[i]
        for j in range(len(estimate.state)):
            history.p[side, e, i, j] = estimate.p[0, i, j]
        for d in range(estimate.sensitivity.shape[1]):
            history.t[side, e, i, d] = estimate.sensitivity[i, d]


@inlined_kernel
def _take_reading(e: int, filtered: FilterRun) -> None:
    """Predict the reading of an event, and update the estimate with it."""
    events, model, step, rate = filtered.events, filtered.model, filtered.step, filtered.expected.rate
    kind, stick, state = events.kinds[e], filtered.command.at_events[0, e], filtered.estimate.state
    if kind == IMU or events.first_step[e] == events.first_step[e + 1]:
        # Only rates of tilt and speed jump with the stick; other readings use the last Jacobian.
        jacobian(state, stick, model.parameters, rate, step.slopes, filtered.scratch)
    else:
        split_state(state, step.middle, step.middle_noise)
        derivative(step.middle, stick, step.middle_noise, model.parameters, rate)
    if kind == SONAR and model.sensor[RANGE_LAG] > 0.0:
        _turn_within_lag(e, events.times_s, filtered.written.states, model.sensor[RANGE_LAG], rate)
    measurement(e, filtered)
    if filtered.estimate.sensitivity.shape[1] > 0:
        direct_change(e, filtered)
    update(e, filtered)


@kernel
def run(begin: int, end: int, filtered: FilterRun) -> None:
    """Filter the events ``begin`` to ``end``; rows of sensitivities start at 0."""
    events, estimate, step, written = filtered.events, filtered.estimate, filtered.step, filtered.written
    state, sensitivity, moves = estimate.state, estimate.sensitivity, filtered.history.moves
    traced, kept = sensitivity.shape[1] > 0, len(moves) > 0
    written.rows[0] = 0
    for e in range(begin, end):
        for s in range(events.first_step[e], events.first_step[e + 1]):
            predict(s, filtered)
            if kept:
                carry(step.matrix, moves[e], step.work)
            if traced:
                carry(step.matrix, sensitivity, step.work)
                force(s, filtered)
        for i in range(MOVING):
            written.states[e, i] = state[i]
        written.states[e, Z_STD] = math.sqrt(estimate.p[0, Z, Z])
        if kept:
            _keep(0, e, filtered)
        if events.kinds[e] != MOMENT:
            _take_reading(e, filtered)
        if kept:
            _keep(1, e, filtered)
