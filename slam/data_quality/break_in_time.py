"""Break of a size at an unknown moment: the sup-Wald test (Andrews, 1993)."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from slam.core.arrays import Array

FEWEST_PARTS = 8
"""Least number of parts of a flight in which a change has a moment."""
TRIMMED = 0.15
"""Least share of a parameter's information on either side of the moment of a change."""


def likeliest_break(
    score: Array, information: Array, tolerance: float, is_white: bool = False
) -> tuple[int, float, float]:
    """Return the first segment after the likeliest break, the change there, and its z: Student's, as a normal
    one, by the variance of the segments about the two sizes, no less than that of white rows. Where rows are
    known to be white, it is normal."""
    count, whole = len(score), float(information.sum())
    sums = np.cumsum([score, information, score**2, score * information, information**2], axis=1)
    last = np.flatnonzero(np.minimum(sums[1], whole - sums[1]) >= TRIMMED * whole)
    if count < FEWEST_PARTS or whole <= 0.0 or not len(last):
        return 0, 0.0, 0.0
    # Sums over the segments on either side of each break.
    s, n, ss, sn, nn = np.swapaxes([sums[:, last], sums[:, -1:] - sums[:, last]], 0, 1)
    sizes = s / n
    squares = ss - 2.0 * sizes * sn + sizes**2 * nn
    variance = np.sum(np.maximum(squares * count / (count - 2), n) / n**2, axis=0)
    change = sizes[1] - sizes[0]
    t = np.abs(change) / np.sqrt(variance + tolerance**2)
    k = int(np.argmax(t))
    z = float(-norm.ppf(max(float(student.sf(t[k], np.inf if is_white else count - 2)), 1e-300)))
    return int(last[k]) + 1, float(change[k]), z
