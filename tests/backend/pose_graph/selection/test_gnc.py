from dataclasses import replace

import gtsam
import numpy as np
import pytest

from backend import se3
from backend.pose_graph.chi_square import chi_square_gate
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.selection.gnc import gnc_inliers
from backend.pose_graph.unary_factors import fixed
from tests.backend.synthetic import graph


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("limits", "kept"), [(0.5, True), (4.0, False)])
def test_gnc_rejects_an_edge_beyond_the_gate_and_keeps_one_within(dimension: int, limits: float, kept: bool):
    """A graph without noise: the residual of one loop is a known multiple of the chi-square gate."""
    made = graph(1, dimension, n=30, noise=0.0)
    problem = from_pose_graph(made)
    loop, d = len(made.i) - 1, problem.dof
    whitened = np.full(d, limits * np.sqrt(chi_square_gate(problem.dof)) / np.sqrt(d))
    xi = np.linalg.solve(problem.sqrt_information[loop], whitened)
    error = se3.from_planar(xi[None])[0] if dimension == 2 else se3.exp(xi[None])[0]
    ij_T = problem.ij_T.copy()
    ij_T[loop] = ij_T[loop] @ error
    problem = replace(problem, ij_T=ij_T)
    priors = gtsam.NonlinearFactorGraph()
    priors.push_back(fixed(0, made.poses[0], dimension).factor)
    inliers, _ = gnc_inliers(problem, priors, made.poses, np.ones(len(made.i), dtype=bool))
    expected = np.ones(len(made.i), dtype=bool)
    expected[loop] = kept
    np.testing.assert_array_equal(inliers, expected)
