"""Covariances along chains of pictures of one floor, each seen by its two predecessors."""

import gtsam
import numpy as np
import pytest

from backend.pose_graph.marginals import pose_covariances

STEP_M = 0.3
TURN_RAD = 0.1
RAY_STD = 1e-3
CORNER = np.array([0.57, 0.43])
"""Half the view of a camera one metre above the floor, in metres."""


def _root_information(moved_m: np.ndarray) -> np.ndarray:
    """Square root of the information of points of the floor on the relative pose of two parallel pictures."""
    x, y = np.meshgrid(np.linspace(-1, 1, 8) * CORNER[0], np.linspace(-1, 1, 6) * CORNER[1], indexing="ij")
    floor = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    floor = floor[(np.abs(floor[:, :2] - moved_m) < CORNER).all(axis=1)]

    def seen(p: np.ndarray) -> np.ndarray:
        # The tilt of the first camera over the floor is unknown too, so that a tilt looks like a motion.
        tilted = floor / (floor @ [p[6], p[7], 1.0])[:, None]
        at = (tilted - [*moved_m, 0.0] - p[3:6]) @ gtsam.Rot3.Expmap(p[:3]).matrix()
        return np.asarray((at[:, :2] / at[:, 2:]).ravel())

    steps = 1e-6 * np.eye(8)
    J = np.array([(seen(s) - seen(-s)) / 2e-6 for s in steps]).T / RAY_STD
    tilt_std = np.diag([0, 0, 0, 0, 0, 0, 20.0, 20.0])
    covariance = np.linalg.inv(J.T @ J + tilt_std.T @ tilt_std)[:6, :6]
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)).T)


def _chain(n: int) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    angle = TURN_RAD * np.arange(n)
    place = np.cumsum(STEP_M * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), axis=0)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    upright = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.05, 0.05, 1e4, 1e4, 1e4, 0.007]))
    for k in range(n):
        values.insert(k, gtsam.Pose3(gtsam.Rot3(), place[k]))
        graph.add(gtsam.PriorFactorPose3(k, values.atPose3(k), upright))
        for i in range(max(k - 2, 0), k):
            noise = gtsam.noiseModel.Gaussian.SqrtInformation(_root_information((place[k] - place[i])[:2]))
            graph.add(gtsam.BetweenFactorPose3(i, k, values.atPose3(i).between(values.atPose3(k)), noise))
    gauge = gtsam.noiseModel.Diagonal.Sigmas(np.array([1e4, 1e4, 1e-6, 1e-6, 1e-6, 1e4]))
    graph.add(gtsam.PriorFactorPose3(0, values.atPose3(0), gauge))
    return graph, values


@pytest.mark.parametrize("n", [40, 160])
def test_covariances_keep_their_digits_from_the_first_pose_to_the_last(n: int):
    graph, values = _chain(n)
    J, _ = graph.linearize(values).jacobian()
    scale = np.linalg.norm(J, axis=0)
    V = np.linalg.inv(np.linalg.qr(J / scale, mode="r")) / scale[:, None]
    expected = np.array([V[6 * k : 6 * k + 6] @ V[6 * k : 6 * k + 6].T for k in range(n)])
    found = pose_covariances(graph, values, range(n))
    std = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))
    assert (np.abs(found - expected) / (std[:, :, None] * std[:, None, :])).max() < 1e-7
