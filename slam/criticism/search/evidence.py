"""Prior and parameter costs of a hypothesis in nats, and the lead that makes one explanation better than
another."""

from __future__ import annotations

import numpy as np

from slam.simulation.terms import CATALOGUE

KNOWN, UNKNOWN = 0.9, 0.1
"""Prior probabilities of an effect of the catalogue and of anything else."""
ONE_OF_ALL = float(np.log(len(CATALOGUE) / KNOWN))
"""Cost in nats of one term of the catalogue out of all."""
VERY_SIMILAR_NATS = 4.0
"""Lead below which two explanations are taken as alternatives."""
SIZE_PRIOR = 100.0
"""Prior variance of an effect's size in units of its standard error: sizes of up to about 20 sigma."""


def parameter_cost(degrees: int) -> float:
    """Return the cost in nats of ``degrees`` fitted parameters."""
    return 0.5 * degrees * float(np.log1p(SIZE_PRIOR))
