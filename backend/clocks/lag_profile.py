"""Lag between two recordings of one motion, whose clocks may be hours apart.

A signal that both recorded is correlated at every lag: the rate of turn as a vector, or the speed. Of
vectors, the correlation is that under the best rotation between the two, so that a mount need not be known.
A correlation does not depend on a unit.

Source: Padfield 2012 (IEEE Transactions on Image Processing 21), equations 20 to 22, for correlation with
missing values; Kabsch 1976 (Acta Crystallographica A32) for the best rotation; Bartlett 1946 (Supplement to
the JRSS 8) for the number of independent samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from backend.clocks.grid_posterior import grid_posterior

Array = NDArray[np.float64]

STEP_S = 0.1
"""Step of the signals: vehicles turn and brake at less than 5 Hz."""
_LONGEST_MEMORY_S = 60.0
"""Longest time over which a signal's autocorrelation is summed."""
_LEAST_SAMPLES = 8.0
"""Fewer independent samples leave the variance of a correlation coefficient unknown."""
_NEAR = 20
"""Steps on each side of a peak over which its posterior reaches."""
_FORGOTTEN = 0.05
"""Product of two autocorrelations beyond which their sum would be that of noise."""


@dataclass(frozen=True)
class Signal:
    """A signal of one or three components at even steps of ``STEP_S``."""

    begin_s: float
    values: Array
    """(n, d); NaN where unknown."""

    @staticmethod
    def sampled(stamps_s: Array, values: Array, longest_gap_s: float) -> Signal:
        """Interpolate values (n, d) at stamps (n,), increasing; gaps that last longer are left unknown."""
        at_s = stamps_s[0] + STEP_S * np.arange(int((stamps_s[-1] - stamps_s[0]) / STEP_S) + 1)
        after = np.clip(np.searchsorted(stamps_s, at_s), 1, max(len(stamps_s) - 1, 1))
        in_gap = np.diff(stamps_s, append=stamps_s[-1])[after - 1] > longest_gap_s
        found = np.column_stack([np.interp(at_s, stamps_s, column) for column in values.T])
        return Signal(float(stamps_s[0]), np.where(in_gap[:, None], np.nan, found))


@dataclass(frozen=True)
class LagProfile:
    """How much better each lag explains the two signals than no relation between them."""

    lags_s: Array
    """(g,) a moment has a stamp larger by this lag in the first recording than in the second."""
    evidence: Array
    """(g,) twice the gain of the log-likelihood; 0 where the signals are not alike."""
    memory: float
    """Number of samples that one independent sample takes."""

    def peaks(self, apart_s: float, most: int) -> Array:
        """Return the lags of the highest peaks, the best one first, no two nearer than ``apart_s``.

        Left out are peaks of less than half of the best evidence, since the approximations of this stage do
        not cost the true lag so much, and those that chance alone reaches at one of so many lags.
        """
        left = self.evidence.copy()
        found: list[float] = []
        least = max(0.5 * float(left.max(initial=0.0)), 2.0 * float(np.log(max(len(left), 2))))
        while len(found) < most and left.max(initial=0.0) >= least:
            best = float(self.lags_s[int(left.argmax())])
            found.append(best)
            left[np.abs(self.lags_s - best) < apart_s] = 0.0
        return np.array(found)


def finer_lag(first: Signal, second: Signal, profile: LagProfile, lag_s: float) -> tuple[float, float]:
    """Return mean and standard deviation of the posterior over the lags near a peak, of scalar signals.

    What counts there is how long the difference of the two signals remembers, not the signals themselves.
    """
    k = int(np.abs(profile.lags_s - lag_s).argmin())
    shift = round((lag_s + second.begin_s - first.begin_s) / STEP_S)
    rows = np.arange(max(shift, 0), min(shift + len(second.values), len(first.values)))
    a, known_a = _filled(first.values[rows])
    b, known_b = _filled(second.values[rows - shift])
    known = known_a * known_b
    size = max(float((b**2 * known).sum()), 1e-300)
    left = (a - b * float((a * b).sum()) / size) * known
    slope = np.gradient(b, axis=0) * known
    near = slice(max(k - _NEAR, 0), k + _NEAR + 1)
    scale = profile.memory / _memory(left, known, slope, known)
    lags_s, weight = grid_posterior(profile.lags_s[near], -scale * profile.evidence[near])
    mean_s = float(weight @ lags_s)
    # Signals that are interpolated at steps do not resolve a width below a step.
    return mean_s, float(np.sqrt(weight @ (lags_s - mean_s) ** 2 + STEP_S**2 / 12))


def lag_profile(first: Signal, second: Signal) -> LagProfile:
    """Correlate two signals of as many components at every lag at which they overlap."""
    a, has_a = _filled(first.values)
    b, has_b = _filled(second.values)
    n, m, d = len(a), len(b), a.shape[1]
    size = next_fast_len(n + m - 1, real=True)

    def correlated(x: Array, y: Array) -> Array:
        """Return the sums (g, i, j) of x[k + shift, i] y[k, j] for each shift from 1 - m to n - 1."""
        spectra = rfft(x, size, axis=0)[:, :, None] * np.conj(rfft(y, size, axis=0))[:, None]
        both = irfft(spectra, size, axis=0)
        return np.concatenate([both[size - m + 1 :], both[:n]])

    count = np.maximum(np.round(correlated(has_a, has_b)[:, 0, 0]), 0.0)
    safe = np.maximum(count, 1.0)
    sum_a, sum_b = correlated(a, has_b)[:, :, 0], correlated(has_a, b)[:, 0]
    size_a, size_b = (a**2).sum(axis=1)[:, None], (b**2).sum(axis=1)[:, None]
    square_a = correlated(size_a, has_b)[:, 0, 0] - (sum_a**2).sum(axis=1) / safe
    square_b = correlated(has_a, size_b)[:, 0, 0] - (sum_b**2).sum(axis=1) / safe
    product = np.maximum(square_a, 0.0) * np.maximum(square_b, 0.0)
    # Rounding errors of the transform must not pass for a signal that is constant over the overlap.
    least = max(1e-9 * float(size_a.sum()) * float(size_b.sum()), 1e-300)
    alike = _alike(correlated(a, b) - sum_a[:, :, None] * sum_b[:, None] / safe[:, None, None])
    r = np.where(product > least, alike / np.sqrt(np.maximum(product, least)), 0.0)
    memory = _memory(a, has_a, b, has_b)
    independent = count / memory
    gain: Array = -d * independent * np.log1p(-(np.clip(r, 0.0, 1.0 - 1e-9) ** 2))
    shifts = np.arange(1 - m, n)
    lags_s: Array = first.begin_s - second.begin_s + STEP_S * shifts.astype(np.float64)
    return LagProfile(lags_s, np.asarray(np.where(independent >= _LEAST_SAMPLES, gain, 0.0), float), memory)


def _alike(products: Array) -> Array:
    """Return the sum of products (g,) under the best rotation, from sums of products (g, d, d)."""
    if products.shape[1] == 1:
        return np.asarray(products[:, 0, 0])
    return np.asarray(np.linalg.svd(products, compute_uv=False).sum(axis=1))


def _filled(values: Array) -> tuple[Array, Array]:
    """Return values (n, d) without their mean, 0 where unknown, and (n, 1) 1 where they are known."""
    known: NDArray[np.bool_] = np.asarray(np.isfinite(values).all(axis=1))
    mean = values[known].mean(axis=0) if known.any() else 0.0
    return np.where(known[:, None], values - mean, 0.0), known[:, None].astype(float)


def _memory(a: Array, has_a: Array, b: Array, has_b: Array) -> float:
    """Return the number of samples that one independent sample of the product takes."""
    longest = min(round(_LONGEST_MEMORY_S / STEP_S), len(a), len(b))
    both: Array = _autocorrelation(a, has_a, longest) * _autocorrelation(b, has_b, longest)
    end = next((k for k, value in enumerate(both.tolist()) if value <= _FORGOTTEN), longest)
    return float(1.0 + 2.0 * both[1:end].sum())


def _autocorrelation(values: Array, known: Array, longest: int) -> Array:
    """Return the autocorrelation (longest,) of values that are 0 where unknown."""
    size = next_fast_len(2 * len(values), real=True)
    sums, counts = (
        irfft((np.abs(rfft(x, size, axis=0)) ** 2).sum(axis=1), size)[:longest] for x in (values, known)
    )
    mean = sums / np.maximum(np.round(counts), 1.0)
    return np.asarray(mean / max(float(mean[0]), 1e-300))
