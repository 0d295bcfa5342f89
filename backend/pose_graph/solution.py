"""What the back end gives back: one trajectory, its covariance, and what became of each edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Solution:
    """The most likely trajectory, with everything a person must know to trust it."""

    w_T_b: Array
    """(n, 4, 4) poses; NaN where nothing places a keyframe."""
    covariances: Array | None
    """(n, 6, 6), rotation first, right perturbation, given what was held; NaN where unknown; None: not
    asked."""
    component: NDArray[np.int64]
    """(n,) connected part of the graph; 0 is the largest, -1 not placed."""
    edge_kept: NDArray[np.bool_]
    """(m,) whether each relative pose took part in the final solve."""
    edge_reason: tuple[str, ...]
    """(m,) why a relative pose was rejected, in words with figures; empty for one that was kept."""
    edge_residual: Array
    """(m,) norm of the whitened residual of each relative pose at the solution, in sigmas."""
    error: float
    """Half the squared whitened residuals over all kept factors; positions and ranges by their robust
    loss."""
    iterations: int
    converged: bool
    status: str
    """``ok``, or in one sentence what is wrong."""
    unobserved: tuple[str, ...] = ()
    """Which directions of which keyframes nothing measures, and what was held in their place."""
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class RangeErrors:
    """What all readings of a rangefinder have in common: gain times the range, plus the error of its zero.

    Standard deviations no smaller than those that were assumed say that nothing else told.
    """

    gain: float
    gain_std: float
    zero_m: float
    zero_std_m: float
