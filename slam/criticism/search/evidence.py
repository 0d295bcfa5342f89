"""What a hypothesis costs before any flight is seen: its prior and its numbers; and how much more must be
explained to explain better. In nats."""

from __future__ import annotations

import numpy as np

from slam.simulation.terms import CATALOGUE

KNOWN, UNKNOWN = 0.9, 0.1
"""Prior shares of an effect of the catalogue and of anything else."""
ONE_OF_ALL = float(np.log(len(CATALOGUE) / KNOWN))
"""Nats that it costs to be one term of the catalogue and no other."""
VERY_SIMILAR_NATS = 4.0
"""Two that explain so nearly the same may each be the other."""
SIZE_PRIOR = 100.0
"""Prior variance of an effect's size in units of its standard error: sizes of up to about 20 sigma."""


def parameter_cost(degrees: int) -> float:
    """Nats that so many fitted numbers cost."""
    return 0.5 * degrees * float(np.log1p(SIZE_PRIOR))
