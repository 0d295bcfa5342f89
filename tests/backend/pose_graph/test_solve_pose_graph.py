import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from backend.pose_graph.graph import rank_deficient_warning
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.solve import solve_pose_graph
from tests.backend.synthetic import graph


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("poses", [True, False])
def test_a_pose_graph_is_solved_with_and_without_vertices(dimension: int, poses: bool):
    made = graph(11, dimension, poses=poses)
    s = solve_pose_graph(made)
    dof = (3 if dimension == 2 else 6) * (len(made.i) - len(made.ids) + 1)
    low, high = chi2.ppf([0.0005, 0.9995], dof)
    assert low < 2 * s.error < high
    assert s.covariances is not None
    assert np.isfinite(s.covariances).all()
    residual = from_pose_graph(made).residuals(s.w_T_b)
    np.testing.assert_allclose((residual**2).sum() / 2, s.error, rtol=1e-6)


def test_an_exact_graph_has_no_error():
    made = graph(12, 3, noise=0.0)
    assert solve_pose_graph(replace(made, poses=np.full_like(made.poses, np.nan))).error < 1e-6


def test_fixed_vertices_stay():
    made = graph(13, 3)
    made = replace(made, fixed=made.ids == 5)
    s = solve_pose_graph(made)
    np.testing.assert_allclose(s.w_T_b[5], made.poses[5], atol=1e-5)
    assert s.unobserved == ()


def test_a_disconnected_pose_graph_is_solved_in_parts():
    a, b = graph(14, 2), graph(15, 2, n=20)
    both = replace(
        a,
        ids=np.arange(60),
        poses=np.concatenate([a.poses, b.poses]),
        i=np.concatenate([a.i, b.i + 40]),
        j=np.concatenate([a.j, b.j + 40]),
        ij_T=np.concatenate([a.ij_T, b.ij_T]),
        information=np.concatenate([a.information, b.information]),
        fixed=np.zeros(60, dtype=bool),
    )
    s = solve_pose_graph(both)
    assert s.error == pytest.approx(solve_pose_graph(a).error + solve_pose_graph(b).error, rel=1e-4)
    np.testing.assert_array_equal(s.component, [0] * 40 + [1] * 20)


@pytest.mark.slow
def test_a_chain_of_100_000_poses_in_a_process_of_its_own():
    code = """
import numpy as np
from backend.pose_graph.solve import solve_pose_graph
from tests.backend.synthetic import planar_chain
s = solve_pose_graph(planar_chain(100_000))
assert s.converged and s.error < 1e-3, s.status
assert np.isfinite(s.covariances[1]).all()
print("solved")
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr[-500:]
    assert done.stdout.strip() == "solved"


def without_x(made, *edges: int):
    """The graph whose edges tell nothing about the step along their own x."""
    information = made.information.copy()
    for edge in edges:
        information[edge, 0, :] = information[edge, :, 0] = 0.0
    return replace(made, information=information)


def test_edges_that_tell_nothing_about_a_direction_are_counted():
    made = graph(3, 2)
    edges = [int(e) for e in np.flatnonzero(made.j - made.i == 1)[:4]]
    blind = without_x(made, *edges)
    told = solve_pose_graph(blind).warnings[0]
    i, j = made.ids[made.i[edges[0]]], made.ids[made.j[edges[0]]]
    assert f"4 of {len(made.i)} edges tell nothing about some direction" in told
    assert f"the first is {i}-{j})" in told
    # Directions that are known badly, in whatever units, are known.
    fine = np.diag([1e6, 1e6, 1e-6])
    for same in (made, replace(made, information=fine @ made.information @ fine)):
        assert not rank_deficient_warning(same)


def test_a_direction_that_no_edge_tells_is_in_the_status():
    made = graph(3, 2)
    last = int(made.j.max())
    reaching = np.flatnonzero((made.i == last) | (made.j == last))
    only = replace(
        made,
        **{
            name: np.delete(getattr(made, name), reaching[1:], axis=0)
            for name in ("i", "j", "ij_T", "information")
        },
    )
    (edge,) = np.flatnonzero((only.i == last) | (only.j == last))
    assert solve_pose_graph(only).status == "ok"
    status = solve_pose_graph(without_x(only, int(edge))).status
    assert status == f"1 direction around vertex {made.ids[last]} not observed"
