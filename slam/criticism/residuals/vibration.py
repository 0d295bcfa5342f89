"""Lines in the spectrum of the innovations: vibrations that no term of the catalogue describes.

Whitened innovations have a flat spectrum. Each bin of a periodogram is exponentially distributed, and the sum
over flights has a gamma distribution. A bin far above its neighbours is an oscillation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from slam.criticism.kalman.filter import USED
from slam.criticism.kalman.innovations import FilterPass
from slam.criticism.kalman.readings import CHANNELS, place_of
from slam.criticism.kalman.record import Record

Array = NDArray[np.float64]

LOWEST_HZ = 3.0
"""Least frequency: below it vehicle and pilot move, and a term that fits badly leaves oscillations."""
NEIGHBOURS = 120
"""Number of neighbouring bins that give the noise level. With 40 of them its error makes a line of noise seem
seven times as improbable as it is, and one healthy vehicle was reported as oscillating."""
LOG_CHANCE = -20.0
"""Logarithm of the greatest probability of a reported line; about 10^5 bins are tested."""
FEWEST = 256


@dataclass(frozen=True)
class Vibration:
    """One spectral line."""

    channel: str
    frequency_hz: float
    log_chance: float
    """Natural logarithm of the probability that noise makes such a line in this bin."""

    def __str__(self) -> str:
        chance = self.log_chance / np.log(10.0)
        return f"{self.channel} oscillates at {self.frequency_hz:.1f} Hz (by chance in 10^{chance:.0f})"


def vibration_of(records: Sequence[Record], passes: Sequence[FilterPass]) -> Vibration | None:
    """Return the least probable line of all channels, or None."""
    found = [v for channel in range(len(CHANNELS)) if (v := _line(channel, records, passes)) is not None]
    return min(found, key=lambda v: v.log_chance, default=None)


def _line(channel: int, records: Sequence[Record], passes: Sequence[FilterPass]) -> Vibration | None:
    """Return the line of one channel over all flights, or None."""
    series = [_white(channel, record, run) for record, run in zip(records, passes, strict=True)]
    series = [(white, step_s) for white, step_s in series if len(white) >= FEWEST]
    if not series:
        return None
    # Flights that sample a little faster or slower than others have their line in the same bin.
    longest_s = max(len(white) * step_s for white, step_s in series)
    shares = [_over_neighbours(white, round(longest_s / step_s)) for white, step_s in series]
    bins = min(map(len, shares))
    total = np.sum([share[:bins] for share in shares], axis=0)
    frequency = np.arange(bins) / longest_s
    log_chance = np.where(frequency > LOWEST_HZ, _log_tail(total, len(series)), 0.0)
    k = int(np.argmin(log_chance))
    if log_chance[k] > LOG_CHANCE:
        return None
    return Vibration(CHANNELS[channel], float(frequency[k]), float(log_chance[k]))


def _white(channel: int, record: Record, run: FilterPass) -> tuple[Array, float]:
    """Return a channel's whitened innovations at even times (0 where unused), and the time step."""
    kind, c = place_of(channel)
    rows = np.flatnonzero(record.kinds == kind)
    used = run.status[rows, c] == USED
    if used.sum() < FEWEST:
        return np.zeros(0), 0.0
    times_s, white = record.times_s[rows], np.where(used, run.white[rows, c], 0.0)
    step_s = float(np.median(np.diff(times_s)))
    at = np.rint((times_s - times_s[0]) / step_s).astype(np.int64)
    return np.asarray(np.bincount(at, weights=white - white.mean()), dtype=float), step_s


def _over_neighbours(white: Array, length: int) -> Array:
    """Return the periodogram on the bins of ``length`` samples over the mean of each bin's neighbours."""
    spectrum = np.abs(np.fft.rfft(white, length)) ** 2
    parts = np.array_split(spectrum, max(len(spectrum) // NEIGHBOURS, 1))
    # The median of an exponential distribution is log 2 times its mean, and a line does not raise it.
    floor = np.concatenate([np.full(len(p), np.median(p) / np.log(2.0)) for p in parts])
    return np.asarray(spectrum / np.maximum(floor, 1e-12))


def _log_tail(total: Array, count: int) -> Array:
    """Return log P(sum of ``count`` exponential variables > ``total``)."""
    orders = np.arange(count)
    terms = orders * np.log(np.maximum(total, 1e-300))[:, None] - gammaln(orders + 1.0)
    return np.asarray(logsumexp(terms, axis=1) - total)
