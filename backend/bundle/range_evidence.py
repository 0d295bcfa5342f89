"""Evidence for or against the stated gain and zero of a rangefinder: it compares priors of several widths.

The comparison is that of a lens (`backend.bundle.lens_evidence`). But where ranges are stated to be exact,
the estimate has neither gain nor zero. The widest prior is therefore put into the equations at the optimum,
and their solution is one linear step away: nothing is solved again.

A zero that is fixed at a wrong value leaves residuals that follow the height, and the refinement takes them
for correlated noise. The noise of the ranges is therefore that of the residuals after the step, in which
obstacles and hills remain. Where hills rise and fall with the flight, they look like a zero. The pictures
show the height of the ground below each beam. One more variable is the share of it that the beams hear.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, diags_array

from backend.bundle.factors import DATUM, LOG_GAIN, LOG_SCALE, WORLD
from backend.bundle.ground_below import ground_below_m
from backend.bundle.lens_evidence import design_effect, log_marginal_likelihood
from backend.bundle.minimise import BundleOptimum
from backend.bundle.noise import TOLERANCE, range_noise
from backend.bundle.noise_level import over_typical
from backend.bundle.problem import ScalePrior
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
    """Least deviation of the zero: a beam may hear the tops of the relief, or the gaps, everywhere."""

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


_EXACT = 1e-5
"""Standard deviation of what is stated as exact."""
_MOST_PASSES = 5
"""Largest number of linear steps in which the noise of the ranges is found."""


def range_evidence(
    optimum: BundleOptimum, stated: RangePrior, widest: RangePrior, lengths: ScalePrior | None = None
) -> RangeEvidence:
    """Return what the measurements of an optimum tell of gain and zero of its ranges.

    ``stated`` and ``widest`` are the narrowest and the widest of the priors to be compared. ``lengths`` are
    those of an instrument that the optimum does not use, over the lengths of the optimum. Raises
    ``SingularMatrixError`` where the flight leaves a direction open.
    """
    freed = _Freed.of(optimum, widest, lengths)
    for _ in range(_MOST_PASSES):
        # The factor is not kept: that of a long flight is as large as all else of its refinement.
        left = _Solution.of(freed).left_of_pose_side
        before_m, freed = freed.noise_m, freed.with_noise_of(left)
        if abs(np.log(freed.noise_m / before_m)) < TOLERANCE:
            break
    solution = _Solution.of(freed)
    found = freed.off + solution.by_pose[freed.columns]
    posterior = np.asarray(np.linalg.inv(solution.covariance), np.float64)
    told = RangeEvidence(posterior - np.diag(freed.std**-2.0), posterior @ found, freed.floor_std_m)
    influence, left = solution.influence(posterior @ (found - told.errors(stated)[0]))
    effect = design_effect(optimum, influence, left)
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
    ground: Array
    """(rows of the pose side,) derivative of the residuals by the share that the beam hears of the height of
    the ground below over the floor."""

    @staticmethod
    def of(optimum: BundleOptimum, widest: RangePrior, lengths: ScalePrior | None) -> _Freed:
        """Return the system of an optimum, with the noise that the ranges are stated to have."""
        linear, pose_side = optimum.linearise(), optimum.cost.pose_side
        columns = linear.structure.columns_of([WORLD])[0]
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
        stated_m = float(np.median([r.to_level_std_m for r in measured.ranges]))
        weight[rows] = noise_m / stated_m
        linear = _weighted(replace(linear, pose_side_right=right), weight)
        ground = np.zeros(len(weight))
        ground[rows] = (
            -ground_below_m(optimum.problem, optimum.at, optimum.at.point[:, 2])[0]
            * linear.pose_side[:, [columns[DATUM]]].toarray()[rows, 0]
        )
        return _Freed(
            linear, rows, columns[_SHARED], off, std, floor_std_m, measured.ranges, stated_m, ground
        )

    def with_noise_of(self, left_of_pose_side: Array) -> _Freed:
        """Return the system with the noise of the ranges by the residuals ``left_of_pose_side`` (rows,)."""
        left = left_of_pose_side[self.rows]
        noise_m = range_noise(
            self.ranges, left * self.noise_m * over_typical([r.to_level_std_m for r in self.ranges])
        )
        weight = np.ones(len(self.rows))
        weight[self.rows] = self.noise_m / noise_m
        linear = _weighted(self.linear, weight)
        return replace(self, linear=linear, noise_m=noise_m, ground=weight * self.ground)


@dataclass(frozen=True)
class _Solution:
    """The step that solves the system, with the ground below as one more variable, of unit variance."""

    freed: _Freed
    reduced: ReducedSystem
    by_pose: Array
    by_point: Array
    share: float
    """Share of the height of the ground below that the beams hear."""
    per_share: tuple[Array, Array]
    """Decrease of the step for a share of one, by the pose side and by the points."""
    precision: float
    """That of the share."""

    @staticmethod
    def of(freed: _Freed) -> _Solution:
        reduced, ground = freed.linear.eliminate(), freed.ground
        step = reduced.solve(*freed.linear.gradient)
        of_ground = np.asarray(freed.linear.pose_side.T @ ground)
        taken = reduced.solve(of_ground, np.zeros(len(step[1])))
        precision = float(1.0 + ground @ ground - of_ground @ taken[0])
        share = float(ground @ freed.linear.pose_side_right - of_ground @ step[0]) / precision
        by_pose, by_point = (each - share * away for each, away in zip(step, taken, strict=True))
        return _Solution(freed, reduced, by_pose, by_point, share, taken, precision)

    @property
    def left_of_pose_side(self) -> Array:
        """Right-hand side (rows,) of the pose side after the step."""
        linear = self.freed.linear
        return np.asarray(
            linear.pose_side_right - linear.pose_side @ self.by_pose - self.share * self.freed.ground
        )

    @property
    def covariance(self) -> Array:
        """(2, 2) of gain and zero."""
        columns, unit = self.freed.columns, np.zeros((self.reduced.size, 2))
        unit[columns] = np.eye(2)
        along = self.per_share[0][columns]
        own = self.reduced.solve(unit, np.zeros((len(self.by_point), 2)))[0][columns]
        return np.asarray(own + np.outer(along, along) / self.precision)

    def influence(self, weights: Array) -> tuple[Array, Array]:
        """Return the influence (rows,) of all residuals on the sum of gain and zero with ``weights`` (2,).

        The second result is the residuals (rows,) after the step.
        """
        columns, unit = self.freed.columns, np.zeros(self.reduced.size)
        unit[columns] = weights
        own = self.reduced.solve(unit, np.zeros(len(self.by_point)))
        share = -float(weights @ self.per_share[0][columns]) / self.precision
        change = [each - share * away for each, away in zip(own, self.per_share, strict=True)]
        linear, right = self.freed.linear, self.freed.linear.right
        both = zip(change, (self.by_pose, self.by_point), strict=True)
        influence, fitted = linear.times(*(np.column_stack(pair) for pair in both)).T
        ground = np.zeros(len(right))
        ground[len(right) - len(self.freed.ground) :] = self.freed.ground
        return influence + share * ground, right - fitted - self.share * ground


def _weighted(linear: LinearSystem, weight: Array) -> LinearSystem:
    """Return the system with its rows of the pose side multiplied by weights (rows,)."""
    rows = csc_array(diags_array(weight) @ linear.pose_side)
    return replace(linear, pose_side=rows, pose_side_right=weight * linear.pose_side_right)
