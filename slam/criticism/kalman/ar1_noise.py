"""Coloured noise in the filter, compiled: a first-order autoregression on each channel of some instruments.

A channel reads h(x) + e, and e keeps a share of itself from one sample to the next, so e belongs to the
state. Nothing of the vehicle moves it and it does not decay between samples: its mean and covariances are
kept beside those of the moving state, whose steps they do not burden. Without colour there is none of it.
Source: Bryson and Johansen 1965, shaping filters for coloured measurement noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.compiled import kernel
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.readings import CHANNELS, FIRST_CHANNEL, INSTRUMENT_OF, MOVING, WIDTH
from slam.criticism.kalman.record import Record

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


WHITE = -1
"""Slot of a channel whose noise is white."""


class Ar1Noise(NamedTuple):
    """The noises that are coloured, k of them, beside a state of n entries with m tangents."""

    slot: Ints
    """(channels,) which of the noises is the channel's, or ``WHITE``."""
    samples: Ints
    """(events,) how many samples after the instrument's last one, lost ones counted."""
    kept: Array
    """(k,) correlation of one sample's noise with the next."""
    variance: Array
    """(k,)."""
    mean: Array
    """(k,)."""
    cross: Array
    """(n, k) covariance with the state."""
    own: Array
    """(k, k) covariance."""
    sensitivity: Array
    """(k, m)."""
    told: Array
    """(k,) room to work: covariance of the noises with a reading."""
    moved: Array
    """(10, k) room to work."""


def ar1_noise_for(
    record: Record, setting: FilterParameters, states: int, sensitivity: int
) -> Ar1Noise | None:
    """The noises as they are before the first sample, stationary; none where all are white.

    The kernels are compiled by themselves for none: white noise costs nothing more, to the last digit.
    """
    colour = setting.noise_correlation[list(INSTRUMENT_OF)]
    channels = np.flatnonzero(colour)
    if len(channels) == 0:
        return None
    slot = np.full(len(CHANNELS), WHITE, dtype=np.int64)
    slot[channels] = np.arange(len(channels))
    variance = (record.noise_std * setting.noise_factor)[channels] ** 2
    k = len(channels)
    return Ar1Noise(
        slot, _samples(record), colour[channels], variance, np.zeros(k), np.zeros((states, k)),
        np.diag(variance), np.zeros((k, sensitivity)), np.zeros(k), np.zeros((MOVING, k)),
    )  # fmt: skip


def _samples(record: Record) -> Ints:
    """(events,) whole samples since the event before of the same kind."""
    samples = np.ones(len(record.kinds), dtype=np.int64)
    for kind in np.unique(record.kinds):
        rows = np.flatnonzero(record.kinds == kind)
        gaps = np.diff(record.times_s[rows])
        if len(gaps):
            samples[rows[1:]] = np.maximum(np.rint(gaps / np.median(gaps)), 1).astype(np.int64)
    return samples


@kernel
def sample(noise: Ar1Noise, event: int, kind: int) -> None:
    """The noises of an instrument's channels go on to its next sample."""
    n, k = noise.cross.shape
    for c in range(WIDTH[kind]):
        j = noise.slot[FIRST_CHANNEL[kind] + c]
        if j == WHITE:
            continue
        kept = noise.kept[j] ** noise.samples[event]
        noise.mean[j] *= kept
        for a in range(n):
            noise.cross[a, j] *= kept
        for b in range(k):
            noise.own[b, j] *= kept
            noise.own[j, b] *= kept
        noise.own[j, j] += (1.0 - kept * kept) * noise.variance[j]
        for d in range(noise.sensitivity.shape[1]):
            noise.sensitivity[j, d] *= kept


@kernel
def covariance_with_reading(noise: Ar1Noise, j: int, row: Array, ph: Array) -> float:
    """Covariances with a reading of row h (n,) and of noise j: those of the noises are
    kept in ``told``, those of the state in ``ph`` (n,), P h' on entry, completed. Returns the variance that
    the noise adds."""
    n, k = noise.cross.shape
    for i in range(k):
        total = 0.0
        for a in range(n):
            total += row[a] * noise.cross[a, i]
        noise.told[i] = total
    if j == WHITE:
        return 0.0
    added = 2.0 * noise.told[j] + noise.own[j, j]
    for i in range(k):
        noise.told[i] += noise.own[i, j]
    for a in range(n):
        ph[a] += noise.cross[a, j]
    return float(added)


@kernel
def correct_noise(noise: Ar1Noise, ph: Array, s_var: float, miss: float, changes: Array) -> None:
    """Take a reading's miss, of variance ``s_var``, into the noises, and its ``changes`` (m,) with each
    tangent into theirs."""
    n, k = noise.cross.shape
    for i in range(k):
        gain = noise.told[i] / s_var
        noise.mean[i] += gain * miss
        for a in range(n):
            noise.cross[a, i] -= gain * ph[a]
        for b in range(k):
            noise.own[i, b] -= gain * noise.told[b]
        for d in range(len(changes)):
            noise.sensitivity[i, d] -= gain * changes[d]
