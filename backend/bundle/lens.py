"""The calibration that all pictures share: what is stated of it, and what a refinement has estimated.

Its numbers are in OpenCV's notation. They are (fx, fy, cx, cy, k1, k2, p1, p2, k3) of Brown's model, and
(fx, fy, cx, cy, k1, k2, k3, k4) of an equidistant fisheye.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from numpy.typing import NDArray

from backend.bundle.pose_side_factors import PoseSideFactors
from backend.measurements import LensModel, PinholeModel

Array = NDArray[np.float64]

FOCAL, CENTER, TERMS = slice(0, 2), slice(2, 4), slice(4, None)
NAMES: Mapping[LensModel, tuple[str, ...]] = {
    "brown": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
    "equidistant": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
}

_FIXED_STD = 1e-5
"""Standard deviation of a number that is fixed; of the focal lengths as a ratio."""


@dataclass(frozen=True)
class LensEstimate:
    """A calibration that a refinement has estimated, each array (q,) in the order of ``NAMES``."""

    model: LensModel
    calibration: Array
    std: Array
    """Standard deviations; NaN if undetermined."""
    prior_std: Array
    """Standard deviations of what was known before the flight."""

    @property
    def is_estimated(self) -> NDArray[np.bool_]:
        """Whether the flight tells more about each number than was known before it.

        The information of an estimate is that of the prior plus that of the flight. The flight has the larger
        share where the variance is below half of the prior's.
        """
        return np.asarray((self.std**2 < 0.5 * self.prior_std**2) & (self.prior_std > _FIXED_STD))


def is_uncertain(camera: PinholeModel) -> bool:
    """Return whether a number of the calibration is to be estimated."""
    stds = camera.focal_std_ratio, camera.aspect_std_ratio, camera.center_std_px
    return any(std > 0 for std in (*stds, camera.radial_std, camera.tangential_std))


def start_numbers(camera: PinholeModel) -> Array:
    """Return the calibration (q,) to start with, which a fixed lens keeps."""
    return np.array([*camera.focal_px, *camera.center_px, *camera.distortion])


def prior_calibration(camera: PinholeModel) -> Array:
    """Return the calibration (q,) that is stated, the mean of its prior."""
    return start_numbers(camera) if camera.stated is None else np.array(camera.stated)


def prior_covariance(camera: PinholeModel) -> Array:
    """Return the covariance (q, q) of that prior."""
    focal = np.array(camera.focal_px)
    names = NAMES[camera.lens]
    sigmas = np.full(len(names), _FIXED_STD)
    # Fixed relatively: in pixels the two focal lengths would be so strongly tied that digits are lost.
    sigmas[FOCAL] = focal * max(camera.aspect_std_ratio, _FIXED_STD)
    sigmas[CENTER] = max(camera.center_std_px, _FIXED_STD)
    sigmas[[name[0] == "k" for name in names]] = max(camera.radial_std, _FIXED_STD)
    sigmas[[name[0] == "p" for name in names]] = max(camera.tangential_std, _FIXED_STD)
    covariance = np.diag(sigmas**2)
    covariance[FOCAL, FOCAL] += camera.focal_std_ratio**2 * np.outer(focal, focal)
    return covariance


def add_calibration(pose_side: PoseSideFactors, camera: PinholeModel) -> None:
    """Add the prior on the calibration."""
    model = gtsam.noiseModel.Gaussian.Covariance(prior_covariance(camera))
    pose_side.add("lens prior", gtsam.PriorFactorVector(CALIBRATION(0), prior_calibration(camera), model))
