"""Extended Kalman filter over the simulator's equations, with sensitivities; compiled.

The filter processes the readings in order of time, one scalar at a time. Under the model each innovation
over its standard deviation is white with variance 1. Their product is the exact likelihood of the flight, up
to the linearisation. The filter also computes sensitivities: the derivatives of the mean and of each
innovation with respect to perturbations (see ``kernel_inputs.Perturbation``) at fixed gains. They are the
exact linear sensitivity of the whitened innovations, with the effect of the filter.
"""

from __future__ import annotations

import math

from backend.compilation import inner_kernel, kernel
from slam.core.arrays import Array
from slam.criticism.kalman.arrays import FilterRun, KalmanState
from slam.criticism.kalman.noise import (
    WHITE,
    correct_changes,
    correct_noise,
    covariance_with_reading,
    noise_of,
    predict_changes,
    sample,
    spread_by_stamp,
)
from slam.criticism.kalman.readings import FIRST_CHANNEL, IMU, MOMENT, MOVING, RANGE_LAG, SONAR, WIDTH
from slam.criticism.kalman.sensitivity import carry, correct_sensitivity, direct_change, force
from slam.criticism.kalman.steps import (
    correct,
    innovation_of,
    innovation_variance,
    is_outlier,
    judged,
    measurement,
    predict,
)
from slam.criticism.kalman.transition import jacobian, split_state
from slam.simulation.dynamics import PITCH, ROLL, Z, derivative

USED, OUTLIER, IGNORED = 1, 2, 0
Z_STD = MOVING
"""Column of the recorded states that holds the standard deviation of z; it follows the moving state."""


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
    """Update the estimate with the channels of one event, one after the other."""
    given, estimate, _, expected, changes, _, written, coloured, others, _ = filtered
    events, model = given.events, given.model
    kind, ph, change = events.kinds[event], expected.ph, changes.predicted_change
    expected.correction[:] = 0.0
    changed = others.p.shape[0] > 0
    for k in range(others.p.shape[0]):
        sample(noise_of(k, others), event, kind)
    sample(coloured, event, kind)
    for c in range(WIDTH[kind]):
        written.status[event, c] = IGNORED
        if not judged(event, c, given, expected):
            continue
        channel, value, row = FIRST_CHANNEL[kind] + c, events.values[event, c], expected.rows[c]
        own_var, slot = model.variance[channel], coloured.slot[channel]
        if slot != WHITE:
            own_var = 0.0
            value -= coloured.mean[slot]
        own_var += spread_by_stamp(row, expected.rate, model.jitter_s, model.diffusion)
        s_var = own_var + innovation_variance(estimate.p, row, ph)
        s_var += covariance_with_reading(coloured, slot, row, ph)
        miss, std = innovation_of(kind, c, value, expected), math.sqrt(s_var)
        written.innovation[event, c] = miss / std
        written.log_variance[event, c] = math.log(s_var)
        if is_outlier(miss, std, channel, estimate.outlier_streak):
            written.status[event, c] = OUTLIER
            continue
        written.status[event, c] = USED
        if estimate.sensitivity.shape[1] > 0:
            if slot != WHITE:
                for d in range(change.shape[0]):
                    changes.direct[c, d] += coloured.sensitivity[slot, d]
            correct_sensitivity(row, changes.direct[c], ph, s_var, estimate.sensitivity, change)
            for d in range(change.shape[0]):
                written.sensitivity[written.rows[0], d] = change[d] / std
        if changed:
            correct_changes(event, c, miss, s_var, filtered)
        written.rows[0] += 1
        correct_noise(coloured, ph, s_var, miss, change)
        correct(miss, s_var, estimate, expected)


@inner_kernel
def _keep(estimate: KalmanState, x: Array, p: Array, t: Array) -> None:
    """Write mean, covariance and sensitivities of an estimate into arrays."""
    for i in range(len(x)):
        x[i] = estimate.state[i]
        for j in range(len(x)):
            p[i, j] = estimate.p[i, j]
        for d in range(t.shape[1]):
            t[i, d] = estimate.sensitivity[i, d]


@inner_kernel
def _take_reading(e: int, filtered: FilterRun) -> None:
    """Predict the reading of an event, and update the estimate with it."""
    given, estimate, step, expected, _, scratch, written, _, _, _ = filtered
    events, model, state = given.events, given.model, estimate.state
    kind, stick = events.kinds[e], given.command.at_events[0, e]
    if kind == IMU or events.first_step[e] == events.first_step[e + 1]:
        # Only rates of tilt and speed jump with the stick; other readings use the last Jacobian.
        jacobian(state, stick, model.parameters, expected.rate, step.slopes, scratch)
    else:
        split_state(state, step.middle, step.middle_noise)
        derivative(step.middle, stick, step.middle_noise, model.parameters, expected.rate)
    if kind == SONAR and model.sensor[RANGE_LAG] > 0.0:
        _turn_within_lag(e, events.times_s, written.states, model.sensor[RANGE_LAG], expected.rate)
    measurement(e, filtered)
    if estimate.sensitivity.shape[1] > 0:
        direct_change(e, filtered)
    update(e, filtered)


@kernel
def run(begin: int, end: int, filtered: FilterRun) -> None:
    """Filter the events ``begin`` to ``end``; rows of sensitivities start at 0."""
    given, estimate, step, _, changes, _, written, coloured, others, history = filtered
    events = given.events
    state, p, sensitivity = estimate.state, estimate.p, estimate.sensitivity
    traced, changed = sensitivity.shape[1] > 0, others.p.shape[0] > 0
    kept = history.x_before.shape[0] > 0
    written.rows[0] = 0
    for e in range(begin, end):
        for s in range(events.first_step[e], events.first_step[e + 1]):
            if changed:
                for i in range(len(state)):
                    others.before[i] = state[i]
            predict(s, filtered)
            if changed:
                predict_changes(events.step_s[s], step, others)
            if coloured.cross.shape[1] > 0:
                carry(step.matrix, coloured.cross, coloured.work)
            if kept:
                carry(step.matrix, history.moves[e], step.work)
            if traced:
                carry(step.matrix, sensitivity, changes.work)
                force(s, filtered)
        for i in range(MOVING):
            written.states[e, i] = state[i]
        written.states[e, Z_STD] = math.sqrt(p[Z, Z])
        if kept:
            _keep(estimate, history.x_before[e], history.p_before[e], history.t_before[e])
        if events.kinds[e] != MOMENT:
            _take_reading(e, filtered)
        if kept:
            _keep(estimate, history.x_after[e], history.p_after[e], history.t_after[e])
