"""Evidence of what is stated of a rangefinder's gain and zero: priors of several widths, compared.

The comparison is that of a lens (`backend.bundle.lens_evidence`). But where ranges are stated to be exact,
the estimate has neither gain nor zero. The widest prior is therefore put into the equations at the optimum,
and their solution is one linear step away: nothing is solved again.

A zero that is held wrong leaves residuals that follow the height, and these count as noise that lasts. The
noise of the ranges is therefore that of the residuals after the step, in which obstacles and hills remain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, diags_array

from backend.bundle.factors import DATUM, LOG_GAIN, LOG_SCALE
from backend.bundle.graph import WORLD, ScalePrior
from backend.bundle.lens_evidence import design_effect, log_marginal_likelihood
from backend.bundle.minimise import BundleOptimum
from backend.bundle.noise import TOLERANCE, range_noise
from backend.bundle.noise_level import over_typical
from backend.bundle.reduced_system import LinearSystem, ReducedSystem
from backend.measurements import SlantRange

Array = NDArray[np.float64]
_SHARED = [LOG_GAIN, DATUM]


@dataclass(frozen=True)
class RangePrior:
    """How well the errors that all ranges share are known."""

    gain_std: float
    """Relative."""
    zero_std_m: float


@dataclass(frozen=True)
class RangeEvidence:
    """Gain and zero of the ranges by the measurements alone, as a normal likelihood."""

    information: Array
    """(2, 2) of the logarithm of the gain, and of the zero in metres."""
    gradient: Array
    """(2,) of the log-likelihood where both are as stated."""
    floor_std_m: float
    """Least deviation of the zero: a beam hears the tops of the relief, or the gaps, at each place alike."""

    def log_evidence(self, prior: RangePrior) -> float:
        """Return the logarithm of the marginal likelihood under a prior, up to a constant."""
        return log_marginal_likelihood(self.gradient, self.information, np.diag(self.prior_std(prior) ** 2))

    def errors(self, prior: RangePrior) -> tuple[Array, Array]:
        """Return the estimates (2,) under a prior, and their standard deviations (2,)."""
        covariance = np.linalg.inv(self.information + np.diag(self.prior_std(prior) ** -2))
        return covariance @ self.gradient, np.sqrt(np.diag(covariance))

    def prior_std(self, prior: RangePrior) -> Array:
        """Return the standard deviations (2,) of a prior in the equations."""
        return np.maximum([prior.gain_std, np.hypot(prior.zero_std_m, self.floor_std_m)], _EXACT)


LEAST_RANGES = 4
"""Ranges without which their noise is not known."""
_EXACT = 1e-5
"""Standard deviation of what is stated as exact."""
_MOST_PASSES = 5
"""Largest number of linear steps in which the noise of the ranges is found."""


def range_evidence(
    optimum: BundleOptimum, stated: RangePrior, widest: RangePrior, lengths: ScalePrior | None = None
) -> RangeEvidence:
    """Return what the measurements of an optimum tell of gain and zero of its ranges.

    ``stated`` and ``widest`` are the narrowest and the widest of the priors to be compared. ``lengths`` are
    those by an instrument that the optimum does not have; their ratio is over its lengths. Raises
    ``SingularMatrixError`` where the flight leaves a direction open.
    """
    freed = _Freed.of(optimum, widest, lengths)
    for _ in range(_MOST_PASSES):
        reduced = freed.linear.eliminate()
        before_m, freed = freed.noise_m, freed.with_noise_after(reduced)
        if abs(np.log(freed.noise_m / before_m)) < TOLERANCE:
            break
    reduced = freed.linear.eliminate()
    step = reduced.solve(*freed.linear.gradient)
    found = freed.off + step[0][freed.columns]
    by_pose, none = np.zeros((reduced.size, 2)), np.zeros((len(step[1]), 2))
    by_pose[freed.columns] = np.eye(2)
    posterior = np.linalg.inv(reduced.solve(by_pose, none)[0][freed.columns])
    prior = np.diag(freed.std**-2.0)
    told = RangeEvidence(posterior - prior, posterior @ found, freed.floor_std_m)
    by_pose[freed.columns, 0] = posterior @ (found - told.errors(stated)[0])
    change = reduced.solve(by_pose[:, :1], none[:, :1])
    jacobian, right = freed.linear.jacobian()
    left = right - jacobian @ np.concatenate(step)
    effect = design_effect(optimum, np.asarray(jacobian @ np.vstack(change))[:, 0], left)
    return replace(told, information=told.information / effect, gradient=told.gradient / effect)


@dataclass(frozen=True)
class _Freed:
    """The linear system of an optimum, with gain and zero known as well as the widest prior says."""

    linear: LinearSystem
    rows: NDArray[np.bool_]
    """(rows,) those of the ranges among those of the pose side."""
    columns: NDArray[np.int64]
    """(2,) columns of gain and zero."""
    off: Array
    """(2,) from what is stated of both to the optimum."""
    std: Array
    """(2,) of the widest prior."""
    floor_std_m: float
    ranges: tuple[SlantRange, ...]
    noise_m: float
    """That of the ranges in the system."""

    @staticmethod
    def of(optimum: BundleOptimum, widest: RangePrior, lengths: ScalePrior | None) -> _Freed:
        """Return the system of an optimum, with the noise that the ranges are stated to have."""
        linear, pose_side = optimum.linearise(), optimum.cost.pose_side
        columns = np.arange(linear.structure.elimination.size)[linear.structure.columns(WORLD)]
        prior = np.flatnonzero(pose_side.rows_of("world prior"))
        before = 1.0 / linear.pose_side.tocsr()[prior[_SHARED], columns[_SHARED]]
        measured = optimum.problem.measurements
        floor_std_m = float(np.sqrt(max(before[1] ** 2 - measured.range_datum_std_m**2, 0.0)))
        std = np.maximum([widest.gain_std, np.hypot(widest.zero_std_m, floor_std_m)], before)
        off = -linear.pose_side_right[prior[_SHARED]] * before
        weight, right = np.ones(len(linear.pose_side_right)), linear.pose_side_right.copy()
        weight[prior[_SHARED]] = before / std
        if lengths is not None:
            row = prior[LOG_SCALE]
            weight[row] = 1.0 / (lengths.log_std * linear.pose_side.tocsr()[row, columns[LOG_SCALE]])
            right[row] = np.log(lengths.ratio) / lengths.log_std / weight[row]
        rows, noise_m = pose_side.rows_of("range"), optimum.noise.range_m
        stated_m = float(np.median([r.std_m for r in measured.ranges]))
        weight[rows] = noise_m / stated_m
        linear = _weighted(replace(linear, pose_side_right=right), weight)
        return _Freed(linear, rows, columns[_SHARED], off, std, floor_std_m, measured.ranges, stated_m)

    def with_noise_after(self, reduced: ReducedSystem) -> _Freed:
        """Return the system with the noise that the ranges have after its step."""
        by_pose, _ = reduced.solve(*self.linear.gradient)
        left = (self.linear.pose_side_right - self.linear.pose_side @ by_pose)[self.rows]
        noise_m = range_noise(self.ranges, left * self.noise_m * over_typical([r.std_m for r in self.ranges]))
        weight = np.ones(len(self.rows))
        weight[self.rows] = self.noise_m / noise_m
        return replace(self, linear=_weighted(self.linear, weight), noise_m=noise_m)


def _weighted(linear: LinearSystem, weight: Array) -> LinearSystem:
    """Return the system with its rows of the pose side multiplied by weights (rows,)."""
    rows = csc_array(diags_array(weight) @ linear.pose_side)
    return replace(linear, pose_side=rows, pose_side_right=weight * linear.pose_side_right)
