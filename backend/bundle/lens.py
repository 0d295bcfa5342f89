"""The calibration that all pictures share: what is told of it, and what a refinement has estimated.

Its numbers are (fx, fy, cx, cy, k1, k2, p1, p2, k3), in OpenCV's notation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.measurements import PinholeModel

Array = NDArray[np.float64]

FOCAL, CENTER, DISTORTION = slice(0, 2), slice(2, 4), slice(4, 9)
_RADIAL, _TANGENTIAL = [4, 5, 8], [6, 7]
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")

_HELD = 1e-5
"""Standard deviation of a number that is held; of the focal lengths as a ratio."""


@dataclass(frozen=True)
class LensEstimate:
    """A calibration that a refinement has estimated, each array (9,) in the order of ``NAMES``."""

    calibration: Array
    std: Array
    """Standard deviations; NaN if undetermined."""
    told_std: Array
    """Standard deviations of what was told before the flight."""

    @property
    def is_estimated(self) -> NDArray[np.bool_]:
        """Whether the flight tells more about each number than was told before it.

        The information of an estimate is that of the prior plus that of the flight. The flight has the larger
        share where the variance is below half of the prior's.
        """
        return np.asarray((self.std**2 < 0.5 * self.told_std**2) & (self.told_std > _HELD))


def is_uncertain(camera: PinholeModel) -> bool:
    """Return whether a number of the calibration is to be estimated."""
    stds = camera.focal_std_ratio, camera.aspect_std_ratio, camera.center_std_px
    return any(std > 0 for std in (*stds, camera.radial_std, camera.tangential_std))


def told_calibration(camera: PinholeModel) -> Array:
    """Return the calibration (9,) that is told."""
    return np.array([*camera.focal_px, *camera.center_px, *camera.distortion])


def told_covariance(camera: PinholeModel) -> Array:
    """Return the covariance (9, 9) of the calibration that is told."""
    focal = np.array(camera.focal_px)
    sigmas = np.full(9, _HELD)
    # Held relatively: in pixels the two focal lengths would be so strongly tied that digits are lost.
    sigmas[FOCAL] = focal * max(camera.aspect_std_ratio, _HELD)
    sigmas[CENTER] = max(camera.center_std_px, _HELD)
    sigmas[_RADIAL] = max(camera.radial_std, _HELD)
    sigmas[_TANGENTIAL] = max(camera.tangential_std, _HELD)
    covariance = np.diag(sigmas**2)
    covariance[FOCAL, FOCAL] += camera.focal_std_ratio**2 * np.outer(focal, focal)
    return covariance
