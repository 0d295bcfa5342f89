"""Choice between two models of an uncertain lens, Brown's and an equidistant fisheye, by their evidence.

Where no distortion is stated, its model is not known either. Both models are then fitted to the same
observations at the same noise. The evidence of each is the marginal likelihood by Laplace's approximation:
the likelihood at the optimum, and how much the flight narrows the priors of the numbers. What both models
share, poses and points, contributes equally to both. The fisheye has no tangential terms, so Brown's model
counts without them where these are superfluous.

Source: MacKay 2003, chapter 28 (Laplace's approximation, Occam's factor); Kass and Raftery 1995; Dickey 1971
(evidence without some of the numbers).
"""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from numpy.typing import NDArray

from backend.bundle.lens import CENTER, FOCAL, NAMES, TERMS, prior_calibration, prior_covariance
from backend.bundle.minimise import COARSE, BundleCost, BundleOptimum, minimise_bundle
from backend.bundle.observations import Cameras
from backend.bundle.problem import BundleProblem, Variables
from backend.bundle.projections import undistorted
from backend.errors import BackendError
from backend.significance import VERY_STRONG_NATS
from backend.sparse_cholesky import SingularMatrixError

Array = NDArray[np.float64]


def fisheye_by_evidence(
    optimum: BundleOptimum, error: float, start: gtsam.Values
) -> tuple[BundleProblem, Variables] | None:
    """Return problem and variables of an equidistant fisheye, if it explains the observations much better.

    ``optimum`` has the ``error``, half the sum of squares, and ``start`` holds what nothing observes. The
    result is None where the fisheye is not better, or where the model of the lens is stated or fixed.
    """
    brown = optimum.problem.camera
    prior = prior_calibration(brown)
    is_free = optimum.problem.self_calibrates and brown.lens == "brown" and brown.radial_std > 0
    if not is_free or prior[TERMS].any():
        return None
    none = (0.0,) * 4
    camera = replace(brown, lens="equidistant", distortion=none, stated=(*prior[:4].tolist(), *none))
    problem = replace(optimum.problem, camera=camera)
    values = gtsam.Values(optimum.values)
    values.erase(CALIBRATION(0))
    values.insert(CALIBRATION(0), _alike(optimum))
    cost = BundleCost.of(problem, optimum.noise, optimum.used, start)
    try:
        found = minimise_bundle(cost, Variables(values, optimum.at.point), *COARSE)
        fisheye = BundleOptimum(cost, found.at, found.structure)
        gain = _log_evidence(fisheye, found.error) - _log_evidence(optimum, error)
    except (BackendError, SingularMatrixError):
        return None
    return (problem, found.at) if gain > VERY_STRONG_NATS else None


def _log_evidence(optimum: BundleOptimum, error: float) -> float:
    """Return the logarithm of the marginal likelihood, but for what both models of the lens share.

    Raises ``SingularMatrixError`` where the flight leaves a direction open.
    """
    camera = optimum.problem.camera
    posterior, prior = optimum.linearise().eliminate().calibration_covariance, prior_covariance(camera)
    evidence = 0.5 * (np.linalg.slogdet(posterior)[1] - np.linalg.slogdet(prior)[1]) - error
    found = Cameras.of(optimum.problem, optimum.values).calibration - prior_calibration(camera)
    tangential = np.flatnonzero([name[0] == "p" for name in NAMES[camera.lens]])
    if len(tangential) and camera.tangential_std > 0:
        p, of_p = found[tangential], np.ix_(tangential, tangential)
        narrowed = np.linalg.slogdet(prior[of_p])[1] - np.linalg.slogdet(posterior[of_p])[1]
        evidence += max(0.5 * (narrowed - p @ np.linalg.solve(posterior[of_p], p)), 0.0)
    return float(evidence)


def _alike(optimum: BundleOptimum) -> Array:
    """Return the calibration (8,) of the fisheye closest to the estimated lens at the observations."""
    seen, prior = optimum.cost.observations, optimum.problem.camera
    lens = Cameras.of(optimum.problem, optimum.values).calibration
    xy = undistorted(lens, seen.pixel)
    radius = np.maximum(np.linalg.norm(xy, axis=1), np.finfo(float).tiny)
    recorded = np.sum((seen.pixel - lens[CENTER]) / lens[FOCAL] * xy, axis=1) / radius
    powers = np.arctan(radius)[:, None] ** np.array([1, 3, 5, 7, 9])
    weight = lens[0] / seen.std_px
    # A narrow view does not show all numbers: their priors keep those at what is stated.
    priors = np.diag([0.0] + [1 / prior.radial_std] * 4)
    rows = np.vstack([powers * weight[:, None], priors])
    ratio, *terms = np.linalg.lstsq(rows, np.append(recorded * weight, np.zeros(5)), rcond=None)[0]
    return np.array([*(ratio * lens[FOCAL]), *lens[CENTER], *(np.array(terms) / ratio)])
