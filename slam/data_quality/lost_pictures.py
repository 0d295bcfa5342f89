"""Lost pictures: gaps between the stamps of a camera, as a Poisson number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

Array = NDArray[np.float64]

HEALTHY_LOSS = 5e-4
"""Share of pictures that a healthy recorder may lose."""
LOST_NATS = 9.0
"""Nats that lost pictures must reach: those of five in 500."""
CERTAIN = 0.9
"""Share of the cases in which a smallest size that shows is found."""
MOST_LOST = 50
"""Greatest number of losses that is tried for the smallest share that shows."""


@dataclass(frozen=True)
class LostPictures:
    """Number of lost pictures of a flight, and number of pictures that it should have."""

    lost: float
    due: float

    def nats(self, share: float) -> float:
        """Return the log likelihood ratio of the Poisson number for the lost share ``share`` against a
        healthy one."""
        return float(self.lost * np.log(share / HEALTHY_LOSS) - self.due * (share - HEALTHY_LOSS))


def missing(stamps_s: Array) -> int:
    """Return the number of pictures missing in the gaps between stamps (n,)."""
    gaps = np.diff(stamps_s)
    return int(np.sum(np.maximum(np.rint(gaps / np.median(gaps)) - 1.0, 0.0)))


def share_for(count: int, among: int) -> float:
    """Return the share that gives at least ``count`` of ``among`` by Poisson's law in nine of ten cases."""
    return float(gammaincinv(count, CERTAIN)) / among if among else np.inf


def smallest_share(taken: int) -> float:
    """Return the lost share that nine of ten flights with ``taken`` pictures show; infinite for none."""
    each = ((n, LostPictures(n, taken + n).nats(n / max(taken + n, 1))) for n in range(1, MOST_LOST))
    return next((share_for(count, taken) for count, nats in each if nats >= LOST_NATS), np.inf)
