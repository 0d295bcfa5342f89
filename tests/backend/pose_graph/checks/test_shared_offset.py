"""A common offset of many loops is found, where the odometry takes the error in small shares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend import se3
from backend.pose_graph.checks.score_test import LinearisedEdges
from backend.pose_graph.checks.shared_offset import LoopOffsets
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.solve import solve_pose_graph
from tests.benchmarks.generated_graphs import SHAPES, Scene, make
from tests.benchmarks.offset_graphs import OffsetScene, error_ratio, make_offset, offset_scenes


def most_likely_offset(linearised: LinearisedEdges):
    offsets = LoopOffsets.of(linearised)
    return offsets.most_likely(linearised.score_tests(offsets.columns)[0])


def solved(graph, robust: bool = True):
    return solve_pose_graph(graph, covariances=False, loops_robust=robust)


@pytest.mark.parametrize("shape", SHAPES)
def test_true_loops_have_no_common_offset(shape: str):
    for each in (1, 4):
        graph = make(Scene(shape, 1, each, 0.0, "random", 1)).graph
        found = most_likely_offset(LinearisedEdges(from_pose_graph(graph), solved(graph).w_T_b))
        assert 0 < found.gain < found.limit


def test_the_gain_is_the_fall_of_the_chi_square_of_a_solve_with_the_offset():
    """The offset is small, so that the linear model holds; other loops give the same within their noise."""
    made = make_offset(OffsetScene("laps", 1, 1, 0.4, 0.3, "stretch", 3))
    problem, bent = from_pose_graph(made.graph), solved(made.graph, robust=False)
    found = most_likely_offset(LinearisedEdges(problem, bent.w_T_b))
    right = make(Scene("laps", 1, 1, 0.0, "random", 3)).graph
    clean = solved(right, robust=False)
    scale = bent.error / (problem.dof * (len(problem.i) - problem.count + 1) / 2)
    assert found.gain * max(scale, 1) == pytest.approx(2 * (bent.error - clean.error), rel=0.1)
    assert np.isin(found.loops, np.flatnonzero(made.false)).mean() > 0.9
    assert np.isin(np.flatnonzero(made.false), found.loops).mean() > 0.9
    off = (se3.inverse(right.ij_T) @ made.graph.ij_T)[made.false, :3, 3]
    assert found.length == pytest.approx(np.sqrt((off**2).sum(axis=1).mean()), rel=0.1)
    assert found.is_false


def test_covariances_that_are_too_large_give_no_finding():
    """Residuals that the stated noise explains are no contradiction, whatever the rest agrees to."""
    graph = make_offset(OffsetScene("laps", 1, 1, 0.4, 0.3, "stretch", 3)).graph
    wide = replace(graph, information=graph.information / 1000)
    found = most_likely_offset(LinearisedEdges(from_pose_graph(wide), solved(wide, robust=False).w_T_b))
    assert not found.is_false


def test_a_spatial_graph_gives_the_same_as_the_planar_one():
    """With the other three directions known, a planar graph is a spatial one."""
    made = make_offset(OffsetScene("laps", 1, 1, 0.4, 0.3, "stretch", 3)).graph
    information = np.zeros((len(made.i), 6, 6))
    information[:] = np.diag([1e6, 1e6, 0, 0, 0, 1e6])
    information[:, se3.PLANAR[:, None], se3.PLANAR] = made.information
    spatial = replace(made, dimension=3, information=information)
    flat, found = (
        most_likely_offset(LinearisedEdges(from_pose_graph(each), solved(each, robust=False).w_T_b))
        for each in (made, spatial)
    )
    assert np.array_equal(flat.loops, found.loops)
    assert found.length == pytest.approx(flat.length, rel=0.05)


def test_a_stretch_that_only_its_own_loops_tie_to_the_rest_is_not_tested():
    """Two robots: an offset of all loops between them moves the second one, and changes no residual."""
    graph = make(Scene("laps", 2, 1, 0.0, "random", 1)).graph
    second = len(graph.ids) // 2
    across = (graph.i < second) != (graph.j < second)
    one = np.flatnonzero(across)[:1]
    keep = ~across | np.isin(np.arange(len(across)), one)
    some = replace(
        graph,
        i=graph.i[keep],
        j=graph.j[keep],
        ij_T=graph.ij_T[keep],
        information=graph.information[keep],
    )
    found = most_likely_offset(LinearisedEdges(from_pose_graph(some), solved(some).w_T_b))
    assert found.gain < found.limit


@pytest.mark.slow
def test_few_wrong_maps_are_ok():
    """Where 30 to 60 % of the loops have one offset, at most one map in eight is wrong and not told so.

    Without the tests of common offsets and of rival groups it was one in four.
    """
    scenes = list(offset_scenes(range(11, 12)))[3::39]
    silent = []
    for scene in scenes:
        made = make_offset(scene)
        solution = solved(made.graph)
        if solution.status == "ok" and error_ratio(made, solution) > 1.2:
            silent.append(scene)
    assert len(silent) <= len(scenes) / 8, silent
