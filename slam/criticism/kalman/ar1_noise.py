"""AR(1) measurement noise in the filter, compiled, on each channel of some instruments.

A channel reads h(x) + e, where e is a first-order autoregression from sample to sample, so e belongs to the
state. The vehicle does not act on e, and e does not decay between samples. Its mean and covariances are
therefore stored apart from those of the moving state, whose steps stay cheap. White noise has no such
state.
Source: Bryson and Johansen 1965, shaping filters for coloured measurement noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from backend.compilation import inner_kernel
from slam.core.arrays import Array, Ints
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.readings import CHANNELS, FIRST_CHANNEL, INSTRUMENT_OF, MOVING, WIDTH
from slam.criticism.kalman.record import Record

WHITE = -1
"""Slot of a channel whose noise is white."""


class Ar1Noise(NamedTuple):
    """State of k AR(1) noises, for a filter state of n entries with m sensitivities."""

    slot: Ints
    """(channels,) index of the channel's noise, or ``WHITE``."""
    samples: Ints
    """(events,) number of samples since the instrument's last one, lost samples included."""
    coefficient: Array
    """(k,) AR(1) coefficient."""
    variance: Array
    """(k,) stationary variance."""
    mean: Array
    """(k,)."""
    cross: Array
    """(n, k) covariance with the state."""
    own: Array
    """(k, k) covariance."""
    sensitivity: Array
    """(k, m)."""
    reading_cov: Array
    """(k,) buffer: covariance of the noises with a reading."""
    work: Array
    """(10, k) buffer."""


def ar1_noise_for(
    record: Record,
    parameters: FilterParameters,
    states: int,
    sensitivity: int,
    changed: Sequence[FilterParameters] = (),
) -> Ar1Noise:
    """Return the stationary noises before the first sample, of channels that have one under the parameters
    or under ``changed`` ones; none where all noises are white."""
    colour = parameters.noise_correlation[list(INSTRUMENT_OF)]
    correlated = np.any([p.noise_correlation != 0.0 for p in (parameters, *changed)], axis=0)
    channels = np.flatnonzero(correlated[list(INSTRUMENT_OF)])
    slot = np.full(len(CHANNELS), WHITE, dtype=np.int64)
    slot[channels] = np.arange(len(channels))
    variance = (record.noise_std * parameters.noise_factor)[channels] ** 2
    k = len(channels)
    return Ar1Noise(
        slot, _samples(record), colour[channels], variance, np.zeros(k), np.zeros((states, k)),
        np.diag(variance), np.zeros((k, sensitivity)), np.zeros(k), np.zeros((MOVING, k)),
    )  # fmt: skip


def _samples(record: Record) -> Ints:
    """Return (events,) the whole samples since the previous event of the same kind."""
    samples = np.ones(len(record.kinds), dtype=np.int64)
    for kind in np.unique(record.kinds):
        rows = np.flatnonzero(record.kinds == kind)
        gaps = np.diff(record.times_s[rows])
        if len(gaps):
            samples[rows[1:]] = np.maximum(np.rint(gaps / np.median(gaps)), 1).astype(np.int64)
    return samples


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
        for b in range(k):
            noise.own[i, b] -= gain * noise.reading_cov[b]
        for d in range(len(changes)):
            noise.sensitivity[i, d] -= gain * changes[d]
