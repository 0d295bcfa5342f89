import numpy as np
import pytest

from backend.pose_graph.initialize import chordal, spanning_tree, tree_edges
from backend.pose_graph.problem import from_pose_graph
from tests.backend.synthetic import graph


@pytest.mark.parametrize("dimension", [2, 3])
def test_both_starts_are_exact_on_exact_edges(dimension: int):
    g = graph(1, dimension, noise=0.0)
    ones = np.ones(len(g.i))
    n = len(g.ids)
    np.testing.assert_allclose(spanning_tree(n, g.i, g.j, g.ij_T, ones, 3, g.poses[3]), g.poses, atol=1e-9)
    relaxed = chordal(g.i, g.j, g.ij_T, ones, ones, g.poses[0], n, dimension == 2)
    assert relaxed is not None
    np.testing.assert_allclose(relaxed, g.poses, atol=1e-8)


@pytest.mark.parametrize("dimension", [2, 3])
def test_chordal_starts_lower_than_the_tree(dimension: int):
    g = graph(2, dimension, noise=3.0)
    ones = np.ones(len(g.i))
    relaxed = chordal(g.i, g.j, g.ij_T, ones, ones, g.poses[0], len(g.ids), dimension == 2)
    assert relaxed is not None
    tree = spanning_tree(len(g.ids), g.i, g.j, g.ij_T, ones, 0, g.poses[0])
    low, high = ((from_pose_graph(g).residuals(w_T) ** 2).sum() for w_T in (relaxed, tree))
    assert low < 0.5 * high


def test_the_tree_goes_by_the_surest_of_parallel_edges():
    wrong = np.tile(np.eye(4), (3, 1, 1))
    wrong[1, 0, 3], wrong[2, 0, 3] = 1.0, 9.0
    i, j = np.array([0, 0, 1]), np.array([1, 1, 0])
    w_T = spanning_tree(2, i, j, wrong, np.array([5.0, 1.0, 7.0]), 0, np.eye(4))
    assert w_T[1, 0, 3] == 1.0
    np.testing.assert_array_equal(tree_edges(2, i, j, np.array([5.0, 1.0, 7.0])), [1])


def test_what_no_edge_reaches_stays_unknown():
    edge = np.eye(4)[None]
    w_T = spanning_tree(3, np.array([0]), np.array([1]), edge, np.ones(1), 0, np.eye(4))
    assert np.isnan(w_T[2]).all()
    assert np.isfinite(w_T[:2]).all()
