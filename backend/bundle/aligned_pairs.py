"""Factors of keyframes that were aligned by grey levels, with the directions that lines leave open."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.homography_factor import (
    ROWS,
    ImagePlane,
    homography_factor,
    homography_whitening,
    transfer,
)
from backend.bundle.lens import FOCAL
from backend.bundle.pose_side_factors import PoseSideFactors
from backend.measurements import AlignedPair, PinholeModel
from backend.robust import robust_unit

Array = NDArray[np.float64]


def add_aligned(
    pose_side: PoseSideFactors,
    pairs: tuple[AlignedPair, ...],
    camera: PinholeModel,
    at: gtsam.Values,
) -> None:
    """Add the robust factors of some pairs, with the effect of the floor's slope at ``at``."""
    if not pairs:
        return
    focal = at.atVector(CALIBRATION(0))[FOCAL] if at.exists(CALIBRATION(0)) else np.array(camera.focal_px)
    plane, model = ImagePlane(focal, np.array(camera.center_px)), robust_unit(ROWS)
    f_T_k, f_T_j = (
        np.array([at.atPose3(POSE(k)).matrix() for k in numbers])
        for numbers in ([pair.k for pair in pairs], [pair.j for pair in pairs])
    )
    rays = plane.rays(np.array([pair.pixel for pair in pairs]))
    by_slope = transfer(f_T_k, f_T_j, rays, plane).by_slope
    for number, pair in enumerate(pairs):
        whitening = homography_whitening(pair.covariance, by_slope[number])
        keys, pixel = (POSE(pair.k), POSE(pair.j)), pair.k_pixel.ravel()
        factor = homography_factor(keys, rays[number], pixel, plane, whitening, model)
        pose_side.add("aligned pair", factor)
