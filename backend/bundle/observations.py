"""The floor points in the factor graph of the planar bundle adjustment: projections and relief."""

from __future__ import annotations

import gtsam
import gtsam_unstable
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import L as POINT
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.graph import IDENTITY, BundleProblem, NoiseLevels, pose_side_graph


def build_graph(
    problem: BundleProblem, noise: NoiseLevels, used: NDArray[np.bool_], start: gtsam.Values
) -> gtsam.NonlinearFactorGraph:
    """Build the whole factor graph at the given noise levels: observations, relief, and the pose side."""
    graph = gtsam.NonlinearFactorGraph()
    _add_observations(graph, problem, noise, used)
    flat = gtsam.noiseModel.Diagonal.Sigmas(np.array([1e4, 1e4, noise.relief]))
    for t in range(int(problem.tracks.track.max()) + 1):
        graph.push_back(gtsam.PriorFactorPoint3(POINT(t), np.zeros(3), flat))
    graph.push_back(pose_side_graph(problem, noise, start))
    return graph


def _add_observations(
    graph: gtsam.NonlinearFactorGraph, problem: BundleProblem, noise: NoiseLevels, used: NDArray[np.bool_]
) -> None:
    """Add one projection factor per observation, with Huber's loss."""
    tracks, camera = problem.tracks, problem.camera
    models: dict[float, gtsam.noiseModel.Base] = {}
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(problem.config.huber_sigmas)
    fixed = gtsam.Cal3_S2(*camera.focal_px, 0.0, *camera.center_px)
    std = np.round(tracks.std_px * noise.pixel_scale, 4)
    for m in np.flatnonzero(used):
        sigma = float(std[m])
        if sigma not in models:
            models[sigma] = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Isotropic.Sigma(2, sigma))
        keys = POSE(int(tracks.keyframe[m])), POINT(int(tracks.track[m]))
        # No exception (the last two arguments): a point behind the camera has a cost. GeneralSFMFactor2 would
        # accept it at no cost, and print a line.
        if problem.self_calibrates:
            pose, point = keys
            factor: gtsam.NonlinearFactor = gtsam_unstable.ProjectionFactorPPPCCal3DS2(
                tracks.pixel[m], models[sigma], pose, IDENTITY, point, CALIBRATION(0), False, False
            )
        else:
            factor = gtsam.GenericProjectionFactorCal3_S2(
                tracks.pixel[m], models[sigma], *keys, fixed, False, False
            )
        graph.push_back(factor)
