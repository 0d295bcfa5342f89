import numpy as np

from backend.pose_graph.graph import build_pose_graph
from tests.backend.synthetic import LOOP_STD, ODOMETRY_STD, flight


def test_the_information_of_a_built_graph_is_the_inverse_covariance():
    made = flight(1, n=10, loops=2)
    built = build_pose_graph(made.truth, made.measurements.relative_poses)
    for e, information in zip(made.measurements.relative_poses, built.information, strict=True):
        std = LOOP_STD if e.kind == "loop" else ODOMETRY_STD
        np.testing.assert_allclose(information, np.diag(std**-2.0), rtol=1e-9, atol=1e-6)
