"""Evidence of what is stated of a lens: priors of several widths about the same numbers, compared.

The lens is estimated under one prior, best the widest. About that estimate the likelihood is taken as normal,
so that the marginal likelihood of every other prior has a closed form, at the same noise and observations.

Relief and matches that are wrong together make residuals of one picture dependent, so that the covariance of
the estimate is too small. The likelihood therefore counts by its design effect: the variance between pictures
of the change that the widest prior allows, over the variance that the model states, if that is larger.

Source: MacKay 2003, chapter 28 (evidence, Occam's factor); White 1982 and Rao and Scott 1984 (variance under
dependent errors).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from numpy.typing import NDArray

from backend.bundle.accuracy.systematic_terms import row_pictures
from backend.bundle.lens import prior_calibration, prior_covariance
from backend.bundle.minimise import BundleOptimum
from backend.bundle.observations import Cameras
from backend.bundle.residual_spread import autocorrelated_std
from backend.measurements import PinholeModel

Array = NDArray[np.float64]


def log_evidence_of_priors(optimum: BundleOptimum, cameras: Sequence[PinholeModel]) -> Array:
    """Return the logarithms of the marginal likelihoods of the lenses of ``cameras``, up to a constant.

    ``optimum`` was found under a prior with the same mean. What is extrapolated from a narrow one is less
    exact. The first of the cameras has the narrowest prior. Raises ``SingularMatrixError`` where the flight
    leaves a direction open.
    """
    # The factor is not kept: that of a long flight is as large as all else of its refinement.
    found = optimum.linearise().eliminate().calibration_covariance
    prior = prior_covariance(optimum.problem.camera)
    unit = np.sqrt(np.diag(prior))
    scale = np.outer(unit, unit)
    lens = Cameras.of(optimum.problem, optimum.values).calibration
    off = (lens - prior_calibration(optimum.problem.camera)) / unit
    posterior = np.linalg.inv(found / scale)
    information = posterior - np.linalg.inv(prior / scale)
    # The gradient of the likelihood by the stated numbers: at the estimate, the prior holds against it.
    gradient = posterior @ off
    priors = [prior_covariance(camera) / scale for camera in cameras]
    under_narrowest = np.linalg.solve(information + np.linalg.inv(priors[0]), gradient)
    effect = _design_effect(optimum, posterior @ (off - under_narrowest) / unit)
    return np.array(
        [log_marginal_likelihood(gradient / effect, information / effect, prior) for prior in priors]
    )


def log_marginal_likelihood(gradient: Array, information: Array, prior: Array) -> float:
    """Return the logarithm of the integral of a normal likelihood times a normal prior (q, q) of mean 0."""
    joint = information + np.linalg.inv(prior)
    gain = gradient @ np.linalg.solve(joint, gradient)
    return float(0.5 * (gain - np.linalg.slogdet(joint)[1] - np.linalg.slogdet(prior)[1]))


def _design_effect(optimum: BundleOptimum, weights: Array) -> float:
    """Return the design effect of the sum of the lens's numbers with ``weights`` (q,)."""
    linear, reduced = optimum.eliminated()
    by_pose = np.zeros((reduced.size, 1))
    by_pose[reduced.structure.columns(CALIBRATION(0)), 0] = weights
    change = reduced.solve(by_pose, np.zeros((optimum.at.point.size, 1)))
    return design_effect(optimum, linear.times(*change)[:, 0], linear.right)


def design_effect(optimum: BundleOptimum, influence: Array, residuals: Array) -> float:
    """Return by how much the sum of whitened residuals (rows,) with weights (rows,) varies more than is
    stated: its variance between pictures over that of the model, and at least 1.

    The rows are those of `LinearSystem.jacobian`.
    """
    picture = row_pictures(optimum)
    of_picture = picture >= 0
    each = np.bincount(picture[of_picture], (influence * residuals)[of_picture]).astype(float)
    each -= each.mean()  # what the priors, which belong to no picture, hold against
    stated = float(influence[of_picture] @ influence[of_picture])
    if len(each) < 2 or stated <= 0:
        return 1.0
    between = len(each) ** 2 / (len(each) - 1) * autocorrelated_std(each[:, None]) ** 2
    return max(between / stated, 1.0)
