"""The filter, compiled: an extended Kalman filter over the simulator's equations, with tangents.

Readings come in their order of time, one scalar at a time, so that each innovation over its own standard
deviation is white with variance 1 under the model: the exact likelihood of the flight (to the linearisation).
Beside the mean run tangents: how the mean and with it each innovation would change with a parameter of the
equations or of an instrument, an early or late command, or any signal injected into either, while the gains
stay. That is the exact linear sensitivity of the whitened innovations, filter included.
"""

from __future__ import annotations

import math

from slam.criticism.kalman.ar1_noise import WHITE, Ar1Noise, heard, learn, sample
from slam.criticism.kalman.arrays import (
    Array,
    FilterInputs,
    FilterOutputs,
    FilterState,
    NoiseArrays,
    PerturbationBuffers,
    PredictedReading,
    Workspace,
)
from slam.criticism.kalman.compiled import kernel
from slam.criticism.kalman.readings import (
    FIRST_CHANNEL,
    IMU,
    MOVING,
    RANGE_LAG,
    SONAR,
    TARGET,
    WIDTH,
)
from slam.criticism.kalman.sensitivity import carry, direct_change, force, tell
from slam.criticism.kalman.steps import (
    correct,
    is_outlier,
    judged,
    measurement,
    miss_of,
    predict,
    spread_along,
)
from slam.criticism.kalman.transition import jacobian, spread
from slam.simulation.dynamics import PITCH, ROLL, Z, derivative

USED, OUTLIER, IGNORED = 1, 2, 0
Z_STD = MOVING
"""Column of the states that are written down: behind the moving state, the standard deviation of z."""
OWN_SHARE = 0.25
"""Of a stamp's standard deviation times the kicks: a third of E |t|, as the next reading shows the rest. With
none of it gyros whose stamps are off by 7 ms scatter more about the axes that tilt than about yaw."""


@kernel
def _spread_by_stamp(row: Array, rate: Array, noise: NoiseArrays) -> float:
    """Variance of a reading with row ``row`` (n,) from its stamp, off by t of a deviation ``jitter_s``.

    It is off by t times its own rate, and by what the noises did in between: their kicks, of which the next
    reading shows most as well.
    """
    if noise.jitter_s <= 0.0:
        return 0.0
    slope, kicked = 0.0, 0.0
    for i in range(MOVING):
        slope += row[i] * rate[i]
    for i in range(TARGET, row.shape[0]):
        kicked += row[i] * row[i] * noise.rough[i]
    return noise.jitter_s * noise.jitter_s * slope * slope + OWN_SHARE * noise.jitter_s * kicked


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
    event: int,
    given: FilterInputs,
    estimate: FilterState,
    expected: PredictedReading,
    changes: PerturbationBuffers,
    written: FilterOutputs,
    coloured: Ar1Noise | None,
) -> None:
    """Take the channels of one event, one after the other, into the estimate."""
    events, noise = given.events, given.noise
    kind, ph, told = events.kinds[event], expected.ph, changes.told
    expected.done[:] = 0.0
    if coloured is not None:
        sample(coloured, event, kind)
    for c in range(WIDTH[kind]):
        written.status[event, c] = IGNORED
        if not judged(event, c, given, expected):
            continue
        channel, value, row = FIRST_CHANNEL[kind] + c, events.values[event, c], expected.rows[c]
        own_var, slot = noise.variance[channel], WHITE
        if coloured is not None:
            slot = coloured.slot[channel]
            if slot != WHITE:
                own_var = 0.0
                value -= coloured.mean[slot]
        own_var += _spread_by_stamp(row, expected.rate, noise)
        s_var = own_var + spread_along(estimate.p, row, ph)
        if coloured is not None:
            s_var += heard(coloured, slot, row, ph)
        miss, std = miss_of(kind, c, value, expected), math.sqrt(s_var)
        written.innovation[event, c] = miss / std
        written.log_variance[event, c] = math.log(s_var)
        if is_outlier(miss, std, channel, estimate.memory):
            written.status[event, c] = OUTLIER
            continue
        written.status[event, c] = USED
        if estimate.sensitivity.shape[1] > 0:
            if coloured is not None and slot != WHITE:
                for d in range(told.shape[0]):
                    changes.direct[c, d] += coloured.sensitivity[slot, d]
            tell(row, changes.direct[c], ph, s_var, estimate.sensitivity, told)
            for d in range(told.shape[0]):
                written.sensitivity[written.rows[0], d] = told[d] / std
        written.rows[0] += 1
        if coloured is not None:
            learn(coloured, ph, s_var, miss, told)
        correct(miss, s_var, estimate, expected)


@kernel
def run(
    begin: int,
    end: int,
    given: FilterInputs,
    estimate: FilterState,
    room: Workspace,
    written: FilterOutputs,
    coloured: Ar1Noise | None,
) -> None:
    """Filter events ``begin`` to ``end``: the ``estimate`` and the ``coloured`` noises, where there are any,
    carry on; what comes of it is ``written``, traces from their beginning on."""
    events, command, belief = given.events, given.command, given.belief
    step, expected, changes, scratch = room
    state, p, sensitivity = estimate.state, estimate.p, estimate.sensitivity
    traced = sensitivity.shape[1] > 0
    written.rows[0] = 0
    for e in range(begin, end):
        first, last = events.first_step[e], events.first_step[e + 1]
        for s in range(first, last):
            predict(s, given, estimate, step, scratch)
            if coloured is not None:
                carry(step.matrix, coloured.cross, coloured.moved)
            if traced:
                carry(step.matrix, sensitivity, changes.moved)
                force(s, given, sensitivity, step, changes, scratch)
        kind, stick = events.kinds[e], command.at_events[0, e]
        for i in range(MOVING):
            written.states[e, i] = state[i]
        written.states[e, Z_STD] = math.sqrt(p[Z, Z])
        if kind == IMU or first == last:
            # Only rates of tilt and speed jump with the stick: all else may use the last step's slopes.
            jacobian(state, stick, belief.parameters, expected.rate, step.slopes, scratch)
        else:
            spread(state, step.middle, step.middle_noise)
            derivative(step.middle, stick, step.middle_noise, belief.parameters, expected.rate)
        if kind == SONAR and belief.sensor[RANGE_LAG] > 0.0:
            _turn_within_lag(e, events.times_s, written.states, belief.sensor[RANGE_LAG], expected.rate)
        measurement(kind, events.elapsed[e], state, belief, step.slopes, expected, scratch)
        if traced:
            direct_change(e, given, state, expected, changes, scratch)
        _take(e, given, estimate, expected, changes, written, coloured)
