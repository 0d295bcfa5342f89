"""Gain of likelihood by one more parameter, calibrated by its scatter from second to second.

The filter's noise is rarely exact: its process noise is the same along all axes, and vibration is not white.
Then chance gains more than the likelihood says. The scatter of the score over independent parts of the flight
shows by how much. Source: Chandler and Bate 2007, "Inference for clustered data using the independence
loglikelihood", Biometrika 94, section 2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def calibrated_gain(values: Array, likelihoods: Array) -> float:
    """Return the gain in nats of the most likely value over the first one, which leaves the parameter out.

    ``values`` (n,) increase; ``likelihoods`` (n, p) are log likelihoods of p parts of the flight, each long
    enough to be independent of the others. Parts in which nothing was read are all zeros.

    The gain G of a parameter v is ``v^2 H / 2`` with the curvature H, so that ``(2 G)^2 / V`` is the square
    of its Wald statistic, with V the variance of v times the score. V is that of the parts at the maximum,
    where the expected score of each part is zero however much it tells of the parameter. Since p parts
    determine V, the square becomes nats as the likelihood ratio of a mean with unknown variance. It is never
    more than the gain itself: a scatter that is too small by chance is no evidence.
    """
    parts = likelihoods[:, likelihoods.any(axis=0)]
    count, best = parts.shape[1], int(np.argmax(parts.sum(axis=1)))
    if best == 0 or count < 2:
        return 0.0
    gain = float(parts[best].sum() - parts[0].sum())
    below, above = best - 1, min(best + 1, len(values) - 1)
    score = values[best] * (parts[above] - parts[below]) / (values[above] - values[below])
    variance = count * float(np.var(score, ddof=1))
    if variance == 0.0:
        return gain
    wald_squared = (2 * gain) ** 2 / variance
    return float(min(gain, count / 2 * np.log1p(wald_squared / (count - 1))))
