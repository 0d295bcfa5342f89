"""AR(1) noise of instruments in the filter, and the filter under small changes of its noise; compiled.

A channel reads h(x) + e, where e is a first-order autoregression from sample to sample, so e belongs to the
state. The vehicle does not act on e, and e does not decay between samples. Its mean and covariances are
therefore stored apart from those of the moving state, whose steps stay cheap. White noise has no such state.
A change of the noise acts on the covariance and on the gains. The plain filter and all changes therefore
share the Jacobians and the set of used readings. A change's mean differs from the plain one linearly.
Sources: Bryson and Johansen 1965, shaping filters for coloured measurement noise; Harvey 1989, section 3.4.5,
with differences in place of derivatives.
"""

from __future__ import annotations

import math

from backend.compilation import inner_kernel
from slam.core.arrays import Array
from slam.criticism.kalman.arrays import Ar1Noise, FilterRun, NoiseChangeArrays, StepBuffers
from slam.criticism.kalman.readings import FIRST_CHANNEL, MOVING, TARGET, WIDTH
from slam.criticism.kalman.sensitivity import add_multiple, carry
from slam.criticism.kalman.transition import covariance_step, process_noise, transition

WHITE = -1
"""Slot of a channel whose noise is white."""


@inner_kernel
def sample(noise: Ar1Noise, event: int, kind: int) -> None:
    """Propagate the noises of an instrument's channels to its next sample."""
    n, k = noise.cross.shape
    for c in range(WIDTH[kind]):
        j = noise.slot[FIRST_CHANNEL[kind] + c]
        if j == WHITE:
            continue
        share = noise.coefficient[j] ** noise.samples[event]
        noise.mean[j] *= share
        for a in range(n):
            noise.cross[a, j] *= share
        for b in range(k):
            noise.own[b, j] *= share
            noise.own[j, b] *= share
        noise.own[j, j] += (1.0 - share * share) * noise.variance[j]
        for d in range(noise.sensitivity.shape[1]):
            noise.sensitivity[j, d] *= share


@inner_kernel
def covariance_with_reading(noise: Ar1Noise, j: int, row: Array, ph: Array) -> float:
    """Compute the covariances with a reading of row h (n,) and noise j.

    Those of the noises go to ``reading_cov``. ``ph`` (n,) holds P h' on entry and the covariance of the state
    on return. Return the variance that the noise adds."""
    n, k = noise.cross.shape
    for i in range(k):
        total = 0.0
        for a in range(n):
            total += row[a] * noise.cross[a, i]
        noise.reading_cov[i] = total
    if j == WHITE:
        return 0.0
    added = 2.0 * noise.reading_cov[j] + noise.own[j, j]
    for i in range(k):
        noise.reading_cov[i] += noise.own[i, j]
    for a in range(n):
        ph[a] += noise.cross[a, j]
    return float(added)


@inner_kernel
def correct_noise(noise: Ar1Noise, ph: Array, s_var: float, miss: float, changes: Array) -> None:
    """Correct noises by a ``miss`` of variance ``s_var``, and their sensitivities by its ``changes`` (m,)."""
    n, k = noise.cross.shape
    for i in range(k):
        gain = noise.reading_cov[i] / s_var
        noise.mean[i] += gain * miss
        for a in range(n):
            noise.cross[a, i] -= gain * ph[a]
        add_multiple(-gain, noise.reading_cov, noise.own[i])
        add_multiple(-gain, changes, noise.sensitivity[i])


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
def noise_of(c: int, changes: NoiseChangeArrays) -> Ar1Noise:
    """Return the AR(1) noises of one change."""
    noises = changes.coloured
    return Ar1Noise(
        noises.slot, noises.samples, noises.coefficient[c], noises.variance[c], noises.mean[c],
        noises.cross[c], noises.own[c], noises.sensitivity, noises.reading_cov,
    )  # fmt: skip


@inner_kernel
def predict_changes(h: float, step: StepBuffers, changes: NoiseChangeArrays) -> None:
    """Predict the changes over the plain filter's last step, which began at its state ``changes.before``."""
    shift, before, n = changes.shift, changes.before, step.matrix.shape[0]
    for c in range(changes.p.shape[0]):
        p, matrix, slower = changes.p[c], step.matrix, changes.slower[c]
        if not changes.decays_alike[c]:
            matrix = changes.matrix
            transition(step.slopes, changes.hold[c], h, matrix)
            for i in range(n):
                slower[i] = 0.0
                for k in range(TARGET, n):
                    slower[i] += (matrix[i, k] - step.matrix[i, k]) * (before[k] + shift[k, c])
        process_noise(changes.hold[c], matrix, step.q)
        covariance_step(h, p, step.slopes, matrix, step.q, step.work)
        for i in range(MOVING):
            p[i, i] += step.contact_variance[i]
            if step.late_stick_noise[i] != 0.0:
                for j in range(MOVING):
                    p[i, j] += step.late_stick_noise[i] * step.late_stick_noise[j]
        if changes.coloured.cross.shape[2] > 0:
            carry(matrix, changes.coloured.cross[c], step.work)
    carry(step.matrix, shift, step.work)
    for c in range(changes.p.shape[0]):
        if not changes.decays_alike[c]:
            for i in range(n):
                shift[i, c] += changes.slower[c, i]


@inner_kernel
def correct_changes(event: int, column: int, miss: float, s_var: float, filtered: FilterRun) -> None:
    """Correct the changes by an event's channel, of a plain innovation ``miss`` of variance ``s_var``.

    Write the changes of its prediction and the ratios of its variance at the plain row. A change of the
    stamps' jitter does not use readings that jumps of the stick may then spoil."""
    expected, changes = filtered.expected, filtered.others
    written, noise = filtered.written, filtered.coloured
    row, rate, ph = expected.rows[column], expected.rate, expected.ph
    channel = FIRST_CHANNEL[filtered.events.kinds[event]] + column
    shift, own_ph, at, slot = changes.shift, changes.ph, written.rows[0], noise.slot[channel]
    for c in range(changes.p.shape[0]):
        own, p = noise_of(c, changes), changes.p[c]
        if channel < changes.spoilt_channels[c, event]:
            written.change_of_mean[at, c], written.variance_ratio[at, c] = 0.0, 1.0
            for i in range(len(row)):
                shift[i, c] -= ph[i] / s_var * miss
            continue
        s = spread_by_stamp(row, rate, changes.jitter_s[c], changes.diffusion[c])
        s += innovation_variance(p, row, own_ph) + covariance_with_reading(own, slot, row, own_ph)
        moved = 0.0
        for i in range(len(row)):
            moved += row[i] * shift[i, c]
        if slot == WHITE:
            s += changes.variance[c, channel]
        else:
            moved += own.mean[slot] - noise.mean[slot]
        written.change_of_mean[at, c] = moved / math.sqrt(s_var)
        written.variance_ratio[at, c] = s / s_var
        gain, plain_gain = (miss - moved) / s, miss / s_var
        for i in range(len(row)):
            shift[i, c] += own_ph[i] * gain - ph[i] * plain_gain
        correct_noise(own, own_ph, s, miss - moved, changes.untraced)
        correct_covariance(own_ph, s, p)
