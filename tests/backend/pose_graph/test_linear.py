"""The Jacobian of a graph as a sparse matrix."""

from __future__ import annotations

import gtsam
import numpy as np

from backend.pose_graph.linear import linear_system


def test_variables_that_no_factor_touches_have_columns_of_zeros():
    """gtsam leaves them out, so that the columns behind them would be those of others."""
    rng = np.random.default_rng(0)
    poses = [gtsam.Pose3.Expmap(rng.normal(0, 0.5, 6)) for _ in range(4)]
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.BetweenFactorPose3(1, 3, poses[0], gtsam.noiseModel.Isotropic.Sigma(6, 0.1)))
    for key, pose in enumerate(poses):
        values.insert(key, pose)
    matrix, right = linear_system(graph, values)
    expected, expected_right = graph.linearize(values).jacobian()
    assert matrix.shape == (6, 24)
    dense = matrix.toarray()
    np.testing.assert_allclose(np.hstack([dense[:, 6:12], dense[:, 18:]]), expected, atol=1e-9)
    np.testing.assert_array_equal(dense[:, np.r_[0:6, 12:18]], 0.0)
    np.testing.assert_allclose(right, expected_right, atol=1e-12)
