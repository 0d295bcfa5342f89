"""Result of the back end: one trajectory, its covariance, and the fate of each edge."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from backend.measurements import LinkCheck, Rejection

Array = NDArray[np.float64]


NO_INFORMATION = Rejection(LinkCheck.INFORMATION)
"""Reason of an edge that was left out before the solve."""


@dataclass(frozen=True)
class RowMistake:
    """A rejected edge that agrees with the kept ones after one mistake of its row is undone."""

    line: int | None
    """Line of the file, counted from 1; None for a graph that was not read from one."""
    first: int
    second: int
    """Numbers of the vertices as written."""
    mistake: str
    """Name of the mistake; several that explain the edge are separated by ``, or``."""
    sigma: float
    """Innovation of the edge as written, in standard deviations."""
    corrected_sigma: float
    """Innovation after the correction that agrees best."""


@dataclass(frozen=True)
class Solution:
    """Maximum-likelihood trajectory, with its uncertainty and diagnostics."""

    w_T_b: Array
    """(n, 4, 4) poses; NaN for a keyframe that nothing places."""
    covariances: Array | None
    """(n, 6, 6), rotation first, right perturbation, conditioned on the gauge; NaN where unknown; None if not
    requested."""
    component: NDArray[np.int64]
    """(n,) number of the connected component; 0 is the largest, -1 means not placed."""
    edge_kept: NDArray[np.bool_]
    """(m,) whether each relative pose took part in the final solve."""
    edge_reason: tuple[Rejection | None, ...]
    """(m,) reason for the rejection of a relative pose; None if it was kept."""
    edge_residual: Array
    """(m,) norm of the whitened residual of each relative pose at the solution, in sigmas."""
    error: float
    """Half the sum of squared whitened residuals over all kept factors; positions and ranges enter with their
    robust loss."""
    iterations: int
    converged: bool
    reasons: tuple[str, ...] = ()
    """Sentences that say what is not observed, was not placed, or may be wrong."""
    unobserved: tuple[str, ...] = ()
    """Directions that nothing measures, by keyframes, and the pose that was fixed instead."""
    warnings: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()
    """The reasons that edges scatter more than their covariances allow."""
    disputed_odometry: tuple[str, ...] = ()
    """Sentences about rejected loops that contradict odometry, or agree with odometry that was rejected."""
    row_mistakes: tuple[RowMistake, ...] = ()
    """Rejected edges of a pose graph that one typical mistake of their rows explains."""

    @property
    def status(self) -> str:
        """``ok``, or the reasons in one line."""
        return "; ".join(self.reasons) or "ok"

    @cached_property
    def edge_informative(self) -> NDArray[np.bool_]:
        """(m,) whether each relative pose carries information."""
        return np.array([reason != NO_INFORMATION for reason in self.edge_reason], dtype=bool)


_DETERMINED = 0.9
"""A posterior deviation above this share of the prior one means that nothing determined the value."""


@dataclass(frozen=True)
class RangeErrors:
    """Common errors of a rangefinder: reading = gain * range + zero offset."""

    gain: float
    gain_std: float
    zero_m: float
    zero_std_m: float
    gain_prior_std: float | None = None
    """Deviations of both before the flight; None where they were not kept."""
    zero_prior_std_m: float | None = None

    def determined(self, prior_gain_std: float, prior_zero_std_m: float) -> tuple[bool, bool]:
        """Return whether the measurements determine gain and zero beyond their priors."""
        return (
            self.gain_std < _DETERMINED * prior_gain_std,
            self.zero_std_m < _DETERMINED * prior_zero_std_m,
        )
