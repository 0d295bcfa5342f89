"""The cost of a refinement as a factor graph of gtsam with one factor for each observation: an oracle.

Pictures are projected by gtsam where the calibration is held, and by OpenCV where it is free.
"""

from __future__ import annotations

import cv2
import gtsam
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import L as POINT
from gtsam.symbol_shorthand import X as POSE

from backend.bundle.minimise import BundleCost
from backend.bundle.problem import Variables


def free_projection_factor(
    k: int, t: int, pixel: np.ndarray, model: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """Return the factor of a pose, a point and a calibration, projected by OpenCV."""

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list | None) -> np.ndarray:
        pose, point = values.atPose3(POSE(k)).matrix(), values.atPoint3(POINT(t))
        fx, fy, cx, cy, *distortion = values.atVector(CALIBRATION(0))
        R, c_p = pose[:3, :3], pose[:3, :3].T @ (point - pose[:3, 3])
        if c_p[2] <= 0:  # as gtsam's own factors
            if jacobians is not None:
                jacobians[0], jacobians[1], jacobians[2] = (np.zeros((2, d)) for d in (6, 3, 9))
            return np.full(2, 2 * fx)
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        found, J = cv2.projectPoints(np.zeros((1, 3)), np.zeros(3), c_p, K, np.array(distortion))
        if jacobians is not None:
            by_c_p = J[:, 3:6]
            x, y, z = c_p
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            jacobians[0] = np.hstack([by_c_p @ cross, -by_c_p])
            jacobians[1], jacobians[2] = by_c_p @ R.T, J[:, 6:15].copy()
        return np.asarray(found.ravel() - pixel)

    return gtsam.CustomFactor(model, [POSE(k), POINT(t), CALIBRATION(0)], error)


def factor_graph(cost: BundleCost) -> gtsam.NonlinearFactorGraph:
    """Return the graph of all factors: observations, priors on the points, and the pose side."""
    graph, seen, camera = gtsam.NonlinearFactorGraph(), cost.observations, cost.problem.camera
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(seen.huber_sigmas)
    fixed = gtsam.Cal3_S2(*camera.focal_px, 0.0, *camera.center_px)
    for k, t, pixel, std_px in zip(seen.keyframe, seen.track, seen.pixel, seen.std_px, strict=True):
        model = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Isotropic.Sigma(2, std_px))
        if cost.problem.self_calibrates:
            factor = free_projection_factor(k, t, pixel, model)
        else:
            factor = gtsam.GenericProjectionFactorCal3_S2(
                pixel, model, POSE(k), POINT(t), fixed, False, False
            )
        graph.push_back(factor)
    for t, std in enumerate(seen.prior_std):
        flat = gtsam.noiseModel.Diagonal.Sigmas(std)
        graph.push_back(gtsam.PriorFactorPoint3(POINT(t), np.zeros(3), flat))
    graph.push_back(cost.pose_side.graph)
    return graph


def all_values(cost: BundleCost, at: Variables) -> gtsam.Values:
    """Return the values of all variables of that graph."""
    values = gtsam.Values(at.values)
    for t, point in enumerate(at.point):
        values.insert(POINT(t), point)
    return values
