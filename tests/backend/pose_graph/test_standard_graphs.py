"""Standard graphs against their published optima."""

import pytest

from backend.g2o import read_g2o
from backend.pose_graph.solve import solve_pose_graph
from tests.benchmarks.graphs import false_loops, graph_folder, published

FOLDER = graph_folder()
pytestmark = pytest.mark.skipif(FOLDER is None, reason="SLAM_DATA does not name the folder of measured data")
NAMES = ["CSAIL", "intel", "manhattan", "parking-garage"]
LARGER = ["torus3D", "sphere2500", "city10000"]


@pytest.mark.parametrize("name", [*NAMES, *(pytest.param(name, marks=pytest.mark.slow) for name in LARGER)])
def test_reaches_the_published_optimum(name: str):
    assert FOLDER is not None
    optimum = published(FOLDER)[name]
    s = solve_pose_graph(read_g2o(FOLDER / f"{name}.g2o"), covariances=False)
    assert s.error == pytest.approx(optimum, rel=1e-4)
    assert s.converged
    assert s.edge_kept.all()


@pytest.mark.slow
def test_false_loops_of_a_real_robot_are_found():
    assert FOLDER is not None
    found = false_loops(FOLDER)
    assert found.recall > 0.9
    assert found.precision > 0.7
    assert found.ate_after_m < 0.5 * found.ate_odometry_m < 0.5 * found.ate_before_m
