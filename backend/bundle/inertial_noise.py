"""Noise of the IMU and of the pictures between keyframes from their residuals, and intervals that do not fit.

Vibration, quantisation and integration add to the noise at rest. The residuals of the intervals show it, less
the share that the estimated poses, velocities and biases absorb. That share is measured with draws of noise.
Saturation, jumps of a bias and lost readings spoil single intervals; these are cut.

Source: Förstner and Wrobel 2016, section 4.2.4 (variance components), with a stochastic estimate of the
redundancy (Hutchinson 1990).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.bundle.inertial.graph import (
    NOMINAL_INERTIAL_NOISE,
    InertialNoiseFactors,
    add_inertial,
)
from backend.bundle.minimise import BundleOptimum
from backend.bundle.noise_level import NOMINAL_COUNT
from backend.bundle.pose_side_factors import Kind, PoseSideFactors
from backend.bundle.problem import BundleProblem
from backend.bundle.reduced_system import LinearSystem
from backend.errors import BackendError
from backend.preintegration.intervals import MOTION, ROTATION, STATE_SIZE
from backend.quantiles import chi_square_limit, chi_square_quantile
from backend.sparse_cholesky import SingularMatrixError

Array = NDArray[np.float64]

_DRAWS = 16
"""Draws of noise; with 100 intervals they measure the redundancy to a few percent."""
_FALSE_CUTS = 1e-3
"""Probability that any of the intervals is cut by chance."""
_MOST_TRIMS = 20
_KINDS: tuple[Kind, Kind] = ("inertial interval", "frame homography")
"""Factors whose noise is estimated."""


@dataclass(frozen=True)
class _Squares:
    """Sums of squares of whitened errors."""

    gyro: Array
    """(m,) of each interval."""
    accel: Array
    walk: Array
    """(m,) of the random walks of the biases."""
    frames: float

    @staticmethod
    def of(intervals: Array, frames: Array) -> _Squares:
        """Add up errors of ``intervals`` and ``frames`` (rows, ...), averaged over further axes."""
        of_intervals = _mean_squares(intervals).reshape(-1, STATE_SIZE)
        return _Squares(
            gyro=of_intervals[:, ROTATION].sum(axis=1),
            accel=of_intervals[:, MOTION].sum(axis=1),
            walk=of_intervals[:, MOTION.stop :].sum(axis=1),
            frames=float(_mean_squares(frames).sum()),
        )

    @staticmethod
    def at(factors: PoseSideFactors, values: gtsam.Values) -> _Squares:
        """Add up the whitened errors of some factors at ``values``, without robust weights."""
        return _Squares.of(*(_errors(factors.of_kind(kind), values) for kind in _KINDS))


def _mean_squares(errors: Array) -> Array:
    """Return the squares (rows,) of errors (rows, ...), averaged over further axes."""
    return np.asarray(np.mean((errors**2).reshape(len(errors), math.prod(errors.shape[1:])), axis=1))


def _errors(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> Array:
    """Return the errors (rows,) of factors, whose own code whitens them."""
    each = [factor.unwhitenedError(values) for factor in factors if isinstance(factor, gtsam.CustomFactor)]
    return np.concatenate([np.zeros(0), *each])


def start_factors(problem: BundleProblem, values: gtsam.Values) -> InertialNoiseFactors:
    """Return factors at which the initial values fit: readings that count too much would bend the map."""
    part = problem.inertial
    if part is None:
        return NOMINAL_INERTIAL_NOISE
    factors = PoseSideFactors()
    add_inertial(factors, part, values, problem.camera.b_T_c, NOMINAL_INERTIAL_NOISE)
    squares = _Squares.at(factors, values)
    gyro, accel = (
        max(1.0, float(np.sqrt(np.median(found) / chi_square_quantile(0.5, rows.stop - rows.start))))
        for found, rows in ((squares.gyro, ROTATION), (squares.accel, MOTION))
    )
    return InertialNoiseFactors(gyro, accel)


def estimate_inertial_noise(optimum: BundleOptimum) -> tuple[InertialNoiseFactors, NDArray[np.bool_]]:
    """Return the factors on the noise, and the intervals (m,) to keep.

    All are at least 1. Residuals may be small by chance; and a homography has hardly more numbers than its
    pose, so that its residuals cannot show that it is better than stated. Poses that count as too exact make
    the map too small, as noise in a regressor does.
    """
    part, noise = optimum.problem.inertial, optimum.noise.inertial
    if part is None:
        return noise, np.ones(0, dtype=bool)
    factors = optimum.cost.pose_side
    found, left = _Squares.at(factors, optimum.values), _residuals_of_draws(optimum.linearise())
    expected = _Squares.of(*(left[factors.rows_of(kind)] for kind in _KINDS))
    limit = chi_square_limit(_FALSE_CUTS / len(part.intervals), STATE_SIZE)
    kept, gyro, accel = np.ones(len(part.intervals), dtype=bool), 1.0, 1.0
    for _ in range(_MOST_TRIMS):
        gyro = max(1.0, _factor(noise.gyro, found.gyro[kept].sum(), expected.gyro[kept].sum()))
        accel = max(1.0, _factor(noise.accel, found.accel[kept].sum(), expected.accel[kept].sum()))
        scaled = (noise.gyro / gyro) ** 2 * found.gyro + (noise.accel / accel) ** 2 * found.accel
        fits = scaled + found.walk < limit
        if (fits == kept).all():
            break
        kept = fits
    frames = max(1.0, _factor(noise.frames, found.frames, expected.frames))
    return InertialNoiseFactors(gyro, accel, frames), kept


def _factor(before: float, found: float, expected: float) -> float:
    """Return the factor on the nominal noise, from squares at the factor ``before`` and expected ones."""
    return float(np.sqrt((found * before**2 + NOMINAL_COUNT) / (expected + NOMINAL_COUNT)))


def _residuals_of_draws(linear: LinearSystem) -> Array:
    """Return the residuals (rows, draws) of the pose side that a fit leaves of drawn unit noise.

    Raises ``BackendError`` if a variable is not determined.
    """
    try:
        reduced = linear.eliminate()
    except SingularMatrixError:
        raise BackendError("the readings of the IMU leave a direction open") from None
    jacobian, left = linear.jacobian()
    white = np.random.default_rng(0).standard_normal((len(left), _DRAWS))
    gradient = np.asarray(jacobian.T @ white)
    fitted = reduced.solve(gradient[: reduced.size], gradient[reduced.size :])[0]
    rows = linear.pose_side.shape[0]
    return np.asarray(white[-rows:] - linear.pose_side @ fitted)
