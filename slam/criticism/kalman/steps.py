"""Compiled steps that filter and smoother share: prediction, and update by one reading.

Readings are scalars, processed one after the other: P h' is (n,), the innovation's variance a number.
"""

from __future__ import annotations

import math

from backend.compilation import inner_kernel
from slam.core.arrays import Array
from slam.criticism.kalman.arrays import FilterRun, KalmanInputs, KalmanState, PredictedReading
from slam.criticism.kalman.readings import (
    ATTITUDE,
    BEFORE,
    BEHIND,
    FIRST_CHANNEL,
    IMU,
    MOVING,
    SONAR,
    WIDTH,
    reading,
)
from slam.criticism.kalman.transition import (
    POLE,
    covariance_step,
    jacobian,
    mean_step,
    process_noise,
    split_state,
    transition,
)
from slam.simulation.dynamics import GEAR, PITCH, ROLL, UP, VX, VY, VZ, YAW, X, Y, Z, derivative, noise_share

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
_NUDGE = 1e-6
_NONE = -1
RATES_READ = (
    (VX, VY, VZ, ROLL, PITCH, YAW), (ROLL, PITCH, YAW, _NONE, _NONE, _NONE), (X, Y, VX, VY, ROLL, PITCH),
    (X, Y, Z, VZ, ROLL, PITCH),
)  # fmt: skip
"""For each kind of event, entries of the state's rate that its reading may depend on, ..."""
STATES_READ = (
    (ROLL, PITCH, YAW, _NONE, _NONE, _NONE), (ROLL, PITCH, YAW, _NONE, _NONE, _NONE),
    (Z, YAW, _NONE, _NONE, _NONE, _NONE), (X, Y, Z, ROLL, PITCH, YAW),
)  # fmt: skip
"""... and of the state itself, the noise's acceleration aside."""


@inner_kernel
def predict(s: int, filtered: FilterRun) -> None:
    """Predict state and covariance over step ``s``, and write the step's matrices into ``filtered.step``."""
    given, estimate, step, _, _, scratch, _, _, _, _ = filtered
    state, p, model = estimate.state, estimate.p, given.model
    h, stick, jump = given.events.step_s[s], given.command.over_steps[0, s], given.command.stick_jumps[s]
    late_s = math.sqrt(given.command.late_var_s2)
    jacobian(state, stick, model.parameters, step.rate, step.slopes, scratch)
    transition(step.slopes, model.hold, h, step.matrix)
    process_noise(model.hold, step.matrix, step.q)
    mean_step(h, state, stick, model, step, scratch)
    covariance_step(h, p, step.slopes, step.matrix, step.q, step.work)
    step.late_stick_noise[:], step.contact_variance[:] = 0.0, 0.0
    if late_s > 0.0 and jump[:5].any():
        # A jump of the stick that is t late shifts the state by t times the jump of its rate.
        full, other, moved, late = scratch.full, scratch.nudged_rate, scratch.stick, step.late_stick_noise
        for i in range(len(stick)):
            moved[i] = stick[i] + jump[i]
        split_state(state, full, scratch.noise)
        derivative(full, stick, step.middle_noise, model.parameters, step.rate)
        derivative(full, moved, step.middle_noise, model.parameters, other)
        for i in range(MOVING):
            late[i] = late_s * (other[i] - step.rate[i])
        for i in range(MOVING):
            for j in range(MOVING):
                p[i, j] += late[i] * late[j]
    # The gear may be hitting the floor: not while standing, or while commanded to climb.
    sinks = stick[UP] <= 0.0 and abs(state[VZ]) >= STANDS_M_S
    if sinks and state[Z] - model.parameters[GEAR] < CONTACT_M + 3.0 * math.sqrt(p[Z, Z]):
        for i in range(VX, VZ + 1):
            step.contact_variance[i] = CONTACT_NOISE**2 * h
            p[i, i] += step.contact_variance[i]


@inner_kernel
def measurement(event: int, filtered: FilterRun) -> None:
    """Predict the reading of an event and its Jacobians in the rate and in the state, the latter with the
    path through the rate."""
    given, estimate, step, expected, _, scratch, _, _, _, _ = filtered
    events, model = given.events, given.model
    kind, elapsed, state = events.kinds[event], events.elapsed[event], estimate.state
    sensor, parameters, pole_s = model.sensor, model.parameters, model.hold[POLE]
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
        moved[j] += _NUDGE
        reading(kind, state, moved, sensor, parameters, pole_s, elapsed, beside)
        moved[j] = rate[j]
        for c in range(width):
            x = (beside[c] - predicted[c]) / _NUDGE
            by_rate[c, j] = x
            if x != 0.0:
                for i in range(state.shape[0]):
                    rows[c, i] += x * step.slopes[j, i]
    for j in STATES_READ[kind]:
        if j < 0:
            break
        nudged[j] += _NUDGE
        reading(kind, nudged, rate, sensor, parameters, pole_s, elapsed, beside)
        nudged[j] = state[j]
        for c in range(width):
            rows[c, j] += (beside[c] - predicted[c]) / _NUDGE
    if kind == IMU:
        # The IMU reads the acceleration of the noise like any other.
        fast = noise_share(state[Z], parameters) / pole_s
        for c in range(3, 6):
            for i in range(3):
                rows[c, BEFORE + i] += fast * by_rate[c, VX + i]
                rows[c, BEHIND + i] -= fast * by_rate[c, VX + i]


@inner_kernel
def judged(event: int, c: int, given: KalmanInputs, expected: PredictedReading) -> bool:
    """Return whether channel c of an event is used.

    It is not if it is missing, may be spoilt by a jump of the stick, or is a range near the sonar's limits.
    During a landing only ranges are used: the floor levels and holds the vehicle. A small error of the
    contact time would otherwise outweigh the rest of the flight.
    """
    events, model = given.events, given.model
    kind = events.kinds[event]
    channel = FIRST_CHANNEL[kind] + c
    spoilt = (events.landing[event] and kind != SONAR) or channel < given.command.spoilt_channels[event]
    if spoilt or math.isnan(events.values[event, c]):
        return False
    if kind == SONAR:
        margin = SONAR_MARGIN * math.sqrt(model.variance[channel])
        least, greatest = model.range_limits_m[0] + margin, model.range_limits_m[1] - margin
        return bool(least <= expected.reading[c] <= greatest)
    return True


@inner_kernel
def innovation_variance(p: Array, row: Array, ph: Array) -> float:
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


@inner_kernel
def innovation_of(kind: int, c: int, value: float, expected: PredictedReading) -> float:
    """Return reading minus prediction, updated by the event's earlier channels; headings are wrapped."""
    miss = value - expected.reading[c]
    for i in range(expected.rows.shape[1]):
        miss -= expected.rows[c, i] * expected.correction[i]
    if kind == ATTITUDE and c == 2:
        miss -= 2.0 * math.pi * math.floor(miss / (2.0 * math.pi) + 0.5)
    return float(miss)


@inner_kernel
def is_outlier(miss: float, std: float, channel: int, streak: Array) -> bool:
    """Return whether a reading is an outlier; ``streak[channel]`` counts successive ones."""
    if abs(miss) > GATE * std and streak[channel] < STREAK:
        streak[channel] += 1.0
        return True
    streak[channel] = 0.0
    return False


@inner_kernel
def correct(miss: float, s_var: float, estimate: KalmanState, expected: PredictedReading) -> None:
    """Update state and covariance by an innovation ``miss`` of variance ``s_var``."""
    state, ph = estimate.state, expected.ph
    for i in range(len(state)):
        step = ph[i] / s_var * miss
        expected.correction[i] += step
        state[i] += step
    correct_covariance(ph, s_var, estimate.p)


@inner_kernel
def correct_covariance(ph: Array, s_var: float, p: Array) -> None:
    """Update the covariance (n, n) by a reading of variance ``s_var``, whose covariances are ``ph`` (n,)."""
    for i in range(len(ph)):
        x = ph[i] / s_var
        for k in range(len(ph)):
            p[i, k] -= x * ph[k]
