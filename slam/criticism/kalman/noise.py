"""AR(1) noise of instruments in the filter, and the filter under several noises at once; compiled.

A channel reads h(x) + e, where e is a first-order autoregression from sample to sample, so e belongs to the
state. The vehicle does not act on e, and e does not decay between samples. White noise has no such state.
All noises but the first are small changes of it. A change acts on the covariance and on the gains; all share
the Jacobians and the set of used readings. The mean under a change differs linearly from the first one.
Sources: Bryson and Johansen 1965, shaping filters for coloured measurement noise; Harvey 1989, section 3.4.5,
with differences in place of derivatives.
"""

from __future__ import annotations

import math

from backend.compilation import inner_kernel
from slam.core.arrays import Array
from slam.criticism.kalman.arrays import FilterRun
from slam.criticism.kalman.readings import FIRST_CHANNEL, MOVING, TARGET, WIDTH
from slam.criticism.kalman.sensitivity import carry
from slam.criticism.kalman.transition import covariance_step, process_noise, transition

WHITE = -1
"""In place of the state that holds a channel's AR(1) noise, where its noise is white."""


@inner_kernel
def sample(event: int, filtered: FilterRun) -> None:
    """Propagate the AR(1) noises of an instrument's channels to its next sample."""
    events, noise, estimate = filtered.events, filtered.noise, filtered.estimate
    kind, state = events.kinds[event], estimate.state
    for channel in range(FIRST_CHANNEL[kind], FIRST_CHANNEL[kind] + WIDTH[kind]):
        j = filtered.model.ar1_state[channel]
        if j == WHITE:
            continue
        share = noise.ar1[0, channel] ** events.samples[event]
        for c in range(len(noise.ar1)):
            own = noise.ar1[c, channel] ** events.samples[event]
            for i in range(len(state)):
                estimate.p[c, i, j] *= own
                estimate.p[c, j, i] *= own
            estimate.p[c, j, j] += (1.0 - own * own) * noise.variance[c, channel]
            estimate.shift[j, c] = own * estimate.shift[j, c] + (own - share) * state[j]
        state[j] *= share
        for d in range(estimate.sensitivity.shape[1]):
            estimate.sensitivity[j, d] *= share


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
def correct_covariance(ph: Array, s_var: float, p: Array) -> None:
    """Update the covariance (n, n) by a reading of variance ``s_var``, whose covariances are ``ph`` (n,)."""
    for i in range(len(ph)):
        x = ph[i] / s_var
        for k in range(len(ph)):
            p[i, k] -= x * ph[k]


OWN_SHARE = 0.25
"""Share of the stamp's standard deviation over which process noise is added to a reading's variance. It is a
third of E |t|, because the next reading shows the rest. Without it, gyros with stamps off by 7 ms scatter
more about the axes that tilt than about yaw."""


@inner_kernel
def spread_by_stamp(row: Array, rate: Array, jitter_s: float, diffusion: Array) -> float:
    """Return the variance that an error t of the stamp adds to a reading with row ``row`` (n,).

    The error t has the standard deviation ``jitter_s``. The reading errs by t times its own rate, and by the
    process noise in between, most of which the next reading shows as well.
    """
    if jitter_s <= 0.0:
        return 0.0
    slope, kicked = 0.0, 0.0
    for i in range(MOVING):
        slope += row[i] * rate[i]
    for i in range(TARGET, row.shape[0]):
        kicked += row[i] * row[i] * diffusion[i]
    return jitter_s * jitter_s * slope * slope + OWN_SHARE * jitter_s * kicked


@inner_kernel
def predict_covariance(c: int, h: float, filtered: FilterRun) -> None:
    """Predict the covariance under noise c over a step, and note how much less its noises decay meanwhile."""
    step, noise, shift = filtered.step, filtered.noise, filtered.estimate.shift
    matrix, slower, n = step.matrix, step.slower[c], step.matrix.shape[0]
    if not noise.decays_alike[c]:
        matrix = step.other_matrix
        transition(step.slopes, noise.hold[c], h, matrix)
        for i in range(n):
            slower[i] = 0.0
            for k in range(TARGET, n):
                slower[i] += (matrix[i, k] - step.matrix[i, k]) * (step.before[k] + shift[k, c])
    process_noise(noise.hold[c], matrix, step.q)
    covariance_step(h, filtered.estimate.p[c], step.slopes, matrix, step.q, step.work)


@inner_kernel
def predict_shift(filtered: FilterRun) -> None:
    """Predict by how much the means under the changed noises differ from the first one."""
    step, shift = filtered.step, filtered.estimate.shift
    carry(step.matrix, shift, step.work)
    for c in range(shift.shape[1]):
        if not filtered.noise.decays_alike[c]:
            for i in range(shift.shape[0]):
                shift[i, c] += step.slower[c, i]


@inner_kernel
def variance_of(c: int, channel: int, row: Array, ph: Array, filtered: FilterRun) -> float:
    """Return the variance of a channel's innovation under noise c, and write the state's covariance with it
    into ``ph`` (n,)."""
    noise, rate = filtered.noise, filtered.expected.rate
    s = spread_by_stamp(row, rate, noise.jitter_s[c], noise.diffusion[c])
    s += innovation_variance(filtered.estimate.p[c], row, ph)
    return s + noise.variance[c, channel] if filtered.model.ar1_state[channel] == WHITE else s


@inner_kernel
def correct_changes(event: int, column: int, miss: float, s_var: float, filtered: FilterRun) -> None:
    """Correct the filters under changed noises by an event's channel, of an innovation ``miss`` of variance
    ``s_var`` under the first noise.

    Write the changes of its prediction and the ratios of its variance. A change of the stamps' jitter does
    not use readings that jumps of the stick may then spoil."""
    expected, noise, written, shift = (
        filtered.expected, filtered.noise, filtered.written, filtered.estimate.shift,
    )  # fmt: skip
    row, ph, own_ph, at = expected.rows[column], expected.ph, expected.other_ph, written.rows[0]
    channel = FIRST_CHANNEL[filtered.events.kinds[event]] + column
    for c in range(1, len(noise.hold)):
        if channel < noise.spoilt_channels[c, event]:
            written.change_of_mean[at, c - 1], written.variance_ratio[at, c - 1] = 0.0, 1.0
            for i in range(len(row)):
                shift[i, c] -= ph[i] / s_var * miss
            continue
        s, moved = variance_of(c, channel, row, own_ph, filtered), 0.0
        for i in range(len(row)):
            moved += row[i] * shift[i, c]
        written.change_of_mean[at, c - 1] = moved / math.sqrt(s_var)
        written.variance_ratio[at, c - 1] = s / s_var
        gain, plain_gain = (miss - moved) / s, miss / s_var
        for i in range(len(row)):
            shift[i, c] += own_ph[i] * gain - ph[i] * plain_gain
        correct_covariance(own_ph, s, filtered.estimate.p[c])
