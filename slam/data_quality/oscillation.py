"""Lines in a spectrum: an oscillation at one frequency.

Each bin of the periodogram of noise is exponentially distributed about the level of its neighbours, and a sum
over flights has a gamma distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from backend.significance import RARE_LOG_CHANCE
from slam.data_quality.channels import InstrumentReadings
from slam.data_quality.finding import Finding

Array = NDArray[np.float64]

LOWEST_HZ = 3.0
"""Least frequency: below it vehicle and pilot move."""
NEIGHBOURS = 120
"""Number of neighbouring bins that give the noise level. With 40 of them its error makes a line of noise seem
seven times as improbable as it is, and one healthy vehicle was reported as oscillating."""
FEWEST = 256
GREATER_PART = 0.5
"""Least share of the fast variance that is in the line: rotors leave fainter ones in healthy recordings."""


@dataclass(frozen=True)
class Line(Finding):
    """One spectral line of a channel."""

    frequency_hz: float
    amplitude: float
    unit: str

    @property
    def is_shown_otherwise(self) -> bool:
        """True: the innovations of a channel oscillate with it."""
        return True

    def _text(self) -> str:
        by = f"by {self.amplitude:.2g} {self.unit}"
        return f"{self.channel} oscillates at {self.frequency_hz:.1f} Hz {by}"


@dataclass(frozen=True)
class Vibration(Finding):
    """A spectral line of a channel that several series share."""

    frequency_hz: float
    log10_chance: float
    """Common logarithm of the probability that noise makes such a line at this frequency."""

    def _text(self) -> str:
        chance = f"by chance in 10^{self.log10_chance:.0f}"
        return f"{self.channel} oscillates at {self.frequency_hz:.1f} Hz ({chance})"


def strongest_line(stream: InstrumentReadings) -> Line | None:
    """Return the line with the greatest share of its channel's fast variance, or None."""
    found = []
    for name, column in zip(stream.channels, stream.values.T, strict=True):
        if (line := _line(name, stream.unit, stream.stamps_s, column)) is not None:
            found.append(line)
    return max(found, key=lambda pair: pair[0])[1] if found else None


def _line(name: str, unit: str, stamps_s: Array, column: Array) -> tuple[float, Line] | None:
    known = np.isfinite(column)
    if known.sum() < FEWEST:
        return None
    step_s = float(np.median(np.diff(stamps_s)))
    times_s = np.arange(stamps_s[known][0], stamps_s[known][-1], step_s)
    even = np.interp(times_s, stamps_s[known], column[known])
    window = np.hanning(len(even))
    power = np.abs(np.fft.rfft((even - even.mean()) * window)) ** 2
    frequency = np.fft.rfftfreq(len(even), step_s)
    fast = frequency > LOWEST_HZ
    chance = np.where(fast, log_tail(over_neighbours(power), 1), 0.0)
    k = int(np.argmin(chance))
    if chance[k] > RARE_LOG_CHANCE:
        return None
    of_line = float(power[max(k - 2, 0) : k + 3].sum())
    share = of_line / float(power[fast].sum())
    amplitude = 2.0 * float(np.sqrt(of_line / len(even) / np.sum(window**2)))
    return (share, Line(float(frequency[k]), amplitude, unit, channel=name)) if share > GREATER_PART else None


def common_line(channel: str, series: Sequence[tuple[Array, float]]) -> Vibration | None:
    """Return the least probable line that several series of a channel share; None without a line.

    ``series``: white values (n,) at even times, 0 where one is missing, and their interval in s. Series with
    fewer than ``FEWEST`` values do not count.
    """
    series = [(white, step_s) for white, step_s in series if len(white) >= FEWEST]
    if not series:
        return None
    # Flights that sample a little faster or slower than others have their line in the same bin.
    longest_s = max(len(white) * step_s for white, step_s in series)
    shares = [
        over_neighbours(np.abs(np.fft.rfft(white, round(longest_s / step_s))) ** 2)
        for white, step_s in series
    ]
    bins = min(map(len, shares))
    total = np.sum([share[:bins] for share in shares], axis=0)
    frequency = np.arange(bins) / longest_s
    log_chance = np.where(frequency > LOWEST_HZ, log_tail(total, len(series)), 0.0)
    k = int(np.argmin(log_chance))
    if log_chance[k] > RARE_LOG_CHANCE:
        return None
    return Vibration(float(frequency[k]), float(log_chance[k] / np.log(10.0)), channel=channel)


def over_neighbours(power: Array) -> Array:
    """Return a periodogram over the mean level of each bin's neighbours."""
    parts = np.array_split(power, max(len(power) // NEIGHBOURS, 1))
    # The median of an exponential distribution is log 2 times its mean, and a line does not raise it.
    floor = np.concatenate([np.full(len(p), np.median(p) / np.log(2.0)) for p in parts])
    return np.asarray(power / np.maximum(floor, 1e-300))


def log_tail(total: Array, count: int) -> Array:
    """Return log P(sum of ``count`` exponential variables > ``total``)."""
    orders = np.arange(count)
    terms = orders * np.log(np.maximum(total, 1e-300))[:, None] - gammaln(orders + 1.0)
    return np.asarray(logsumexp(terms, axis=1) - total)
