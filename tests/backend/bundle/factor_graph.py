"""The cost of a refinement as a factor graph of gtsam with one factor for each observation: an oracle."""

from __future__ import annotations

import gtsam
import gtsam_unstable
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import L as POINT
from gtsam.symbol_shorthand import X as POSE

from backend.bundle.graph import Variables
from backend.bundle.minimise import BundleCost

IDENTITY = gtsam.symbol("i", 0)
"""Mount that the projection factor with a free calibration requires, held at the identity."""


def factor_graph(cost: BundleCost) -> gtsam.NonlinearFactorGraph:
    """Return the graph of all factors: observations, priors on the points, and the pose side."""
    graph, seen, camera = gtsam.NonlinearFactorGraph(), cost.observations, cost.problem.camera
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(seen.huber_sigmas)
    fixed = gtsam.Cal3_S2(*camera.focal_px, 0.0, *camera.center_px)
    for k, t, pixel, std_px in zip(seen.keyframe, seen.track, seen.pixel, seen.std_px, strict=True):
        model = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Isotropic.Sigma(2, std_px))
        if cost.problem.self_calibrates:
            factor = gtsam_unstable.ProjectionFactorPPPCCal3DS2(
                pixel, model, POSE(k), IDENTITY, POINT(t), CALIBRATION(0), False, False
            )
        else:
            factor = gtsam.GenericProjectionFactorCal3_S2(
                pixel, model, POSE(k), POINT(t), fixed, False, False
            )
        graph.push_back(factor)
    flat = gtsam.noiseModel.Diagonal.Sigmas(seen.prior_std)
    for t in range(len(seen.first) - 1):
        graph.push_back(gtsam.PriorFactorPoint3(POINT(t), np.zeros(3), flat))
    if cost.problem.self_calibrates:
        held = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
        graph.push_back(gtsam.PriorFactorPose3(IDENTITY, gtsam.Pose3(), held))
    graph.push_back(cost.pose_side)
    return graph


def all_values(cost: BundleCost, at: Variables) -> gtsam.Values:
    """Return the values of all variables of that graph."""
    values = gtsam.Values(at.values)
    for t, point in enumerate(at.point):
        values.insert(POINT(t), point)
    if cost.problem.self_calibrates:
        values.insert(IDENTITY, gtsam.Pose3())
    return values
