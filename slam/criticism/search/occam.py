"""What fitted numbers cost, and how much more must be explained to explain better; in nats."""

from __future__ import annotations

import numpy as np

VERY_SIMILAR_NATS = 4.0
"""Two that explain so nearly the same may each be the other."""
SIZE_PRIOR = 100.0
"""Prior variance of an effect's size in units of its standard error: sizes of up to about 20 sigma."""


def occam(degrees: int) -> float:
    """Nats that so many fitted numbers cost."""
    return 0.5 * degrees * float(np.log1p(SIZE_PRIOR))
