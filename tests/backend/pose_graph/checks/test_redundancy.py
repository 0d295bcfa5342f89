"""A graph that nothing checks is not ``ok``; covariances that are far too large are questioned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from backend import se3
from backend.g2o import read_g2o
from backend.measurements import LinkCheck, Rejection
from backend.pose_graph.checks.redundancy import unchecked_components
from backend.pose_graph.graph import PoseGraph, repeated_edges
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.solve import solve_pose_graph
from tests.backend.synthetic import graph
from tests.slam.faults.made_graph import laps


def walk(loops: list[tuple[int, int]], wrong: bool = False, n: int = 12) -> PoseGraph:
    """A planar chain with loops, of a standard deviation of 0.1 m and 0.1 rad, and noise of that size."""
    rng = np.random.default_rng(2)
    truth = se3.from_planar(np.column_stack([np.arange(n), np.zeros(n), np.zeros(n)]))
    pairs = np.array([(k, k + 1) for k in range(n - 1)] + loops)
    off = 0.1 * rng.normal(size=(len(pairs), 3))
    if wrong:
        off[n - 1 :] += rng.uniform(3, 9, size=(len(loops), 3))
    ij_T = se3.inverse(truth[pairs[:, 0]]) @ truth[pairs[:, 1]] @ se3.from_planar(off)
    information = np.tile(100.0 * np.eye(3), (len(pairs), 1, 1))
    fixed = np.zeros(n, dtype=bool)
    return PoseGraph(2, np.arange(n), truth, pairs[:, 0], pairs[:, 1], ij_T, information, fixed)


def test_a_chain_is_not_ok():
    (made, expected) = (
        walk([]),
        "vertices 0-11 rest on odometry alone, and no loop is left that checks it; add loops",
    )
    assert solve_pose_graph(made).status == expected
    held = replace(made, fixed=made.ids == 0)
    assert solve_pose_graph(held).status == expected
    assert solve_pose_graph(replace(made, fixed=(made.ids == 0) | (made.ids == 11))).status == "ok"


def test_odometry_that_is_left_after_rejections_is_not_ok():
    solved = solve_pose_graph(walk([(0, 5), (2, 9), (1, 11), (3, 7)], wrong=True))
    assert solved.edge_kept.sum() == 11
    assert solved.status == (
        "vertices 0-11 rest on odometry alone: 4 edges were rejected, and no loop is left that checks it; "
        "add loops, or check the rejected edges and their covariances"
    )


def test_a_tree_is_not_ok_and_parallel_edges_are_no_loop():
    made = walk([(0, 5)])
    keep = np.arange(12) != 4
    tree = replace(
        made, i=made.i[keep], j=made.j[keep], ij_T=made.ij_T[keep], information=made.information[keep]
    )
    expected = "vertices 0-11 rest on a tree of edges alone, and no loop is left that checks it; add loops"
    assert solve_pose_graph(tree).status == expected
    assert "rest on odometry alone" in solve_pose_graph(walk([(0, 1), (1, 2)])).status


def test_a_robot_that_one_loop_joins_is_named():
    """Two chains, the first with a loop of its own; one loop joins them, or two."""
    made = walk([(0, 5)], n=12)
    cut = np.ones(len(made.i), dtype=bool)
    cut[5] = False
    symbols = np.where(np.arange(12) < 6, ord("a") << 56, ord("b") << 56) + np.arange(12)
    ends = [(made.i[cut], made.j[cut], made.ij_T[cut], made.information[cut])]
    for loop in ((5, 6), (2, 9)):
        T = se3.inverse(made.poses[loop[0]]) @ made.poses[loop[1]]
        i, j, ij_T, information = ends[-1]
        ends.append(
            (
                np.append(i, loop[0]),
                np.append(j, loop[1]),
                np.concatenate([ij_T, T[None]]),
                np.concatenate([information, information[:1]]),
            )
        )
    one, two = (
        replace(made, ids=symbols, i=i, j=j, ij_T=ij_T, information=information)
        for i, j, ij_T, information in ends[1:]
    )
    assert "one loop alone" in solve_pose_graph(one).status
    assert solve_pose_graph(two).status == "ok"


def test_loops_of_one_place_beside_rejected_ones_are_named():
    made = walk([(0, 11), (1, 11), (5, 8)])
    solved = solve_pose_graph(made)
    kept = solved.edge_kept.copy()
    kept[-1] = False
    (sentence,) = unchecked_components(from_pose_graph(made), replace(solved, edge_kept=kept))
    assert "only loops near vertex 0 and vertex 11 were kept, and 1 loop elsewhere" in sentence
    assert unchecked_components(from_pose_graph(made), solved) == []


def test_a_loop_is_ok():
    assert solve_pose_graph(walk([(0, 11)])).status == "ok"


@pytest.mark.parametrize(("factor", "warned"), [(1.0, False), (10.0, True), (0.0, True)])
def test_residuals_far_below_the_stated_noise_are_reported_once(factor: float, warned: bool):
    made = graph(3, 2, noise=0.0 if factor == 0 else 1.0)
    made = replace(made, information=made.information / max(factor, 1.0) ** 2)
    told = [w for w in solve_pose_graph(made).warnings if "far better than their covariances" in w]
    assert len(told) == warned
    if warned:
        assert "for 60 degrees of freedom" in told[0]


@pytest.mark.parametrize("information", [1e-300, 1e-30, 1e-11])
def test_an_edge_without_information_is_left_out_and_reported(information: float):
    made = walk([(0, 11)])
    made.information[-1] = information * np.eye(3)
    solved = solve_pose_graph(made)
    assert solved.edge_reason[-1] == Rejection(LinkCheck.INFORMATION)
    assert not solved.edge_kept[-1]
    assert (
        "1 of 12 edges carries no information (the first is vertex 0 to vertex 11): left out"
        in solved.warnings
    )
    assert "rest on odometry alone" in solved.status


def test_a_graph_without_any_information_places_nothing():
    made = walk([(0, 11)])
    solved = solve_pose_graph(replace(made, information=1e-300 * made.information))
    assert solved.status == "12 poses could not be placed"
    assert solved.covariances is not None
    assert np.isnan(solved.covariances).all()


def test_one_direction_without_information_counts_as_none():
    made = walk([])
    made.information[3] = np.diag([1e-300, 100.0, 100.0])
    solved = solve_pose_graph(made)
    assert any("1 of 11 edges tells nothing about some direction" in w for w in solved.warnings)
    assert "not observed" in solved.status
    assert solved.covariances is not None
    assert np.isnan(solved.covariances[5]).all()


def test_repeated_edges_are_a_warning():
    """Each copy counts, and makes the standard deviations too small; an edge beside it is no copy."""
    made = walk([(0, 5), (2, 9)])
    assert not made.is_repeated.any()
    assert solve_pose_graph(made).status == "ok"
    again = np.append(np.arange(len(made.i)), [12, 3])
    twice = replace(
        made, i=made.i[again], j=made.j[again], ij_T=made.ij_T[again], information=made.information[again]
    )
    assert np.flatnonzero(twice.is_repeated).tolist() == [13, 14]
    (warning,) = repeated_edges(twice)
    assert "2 edges repeat another one in all digits (the first is 2-9)" in warning


def test_edges_that_contradict_each_other_after_the_rejection_are_in_the_status():
    """Odometry with a tenth of its real deviation, on a walk whose loops are all kept."""
    made = walk([(0, 5), (2, 9), (1, 11)])
    sharp = replace(made, information=100 * made.information)
    status = solve_pose_graph(sharp, loops_robust=False).status
    assert "the edges disagree more than their covariances allow" in status


@pytest.mark.parametrize("at", [4, 5])
def test_odometry_that_only_rejected_odometry_checks_is_named(at: int):
    """No loop begins at vertex 5: which of the two edges there is wrong, no other edge tells."""
    made = walk([(0, 4), (2, 6), (6, 11), (1, 9)])
    solved = solve_pose_graph(made)
    kept = solved.edge_kept.copy()
    kept[at] = False
    (sentence,) = unchecked_components(from_pose_graph(made), replace(solved, edge_kept=kept))
    ends = [f"vertex {k} to vertex {k + 1}" for k in (9 - at, at)]
    assert sentence == (
        f"1 edge (the first is {ends[0]}) is checked only by odometry that was rejected (the first is"
        f" {ends[1]}): either may be what is wrong"
    )


@pytest.mark.slow
def test_odometry_beside_a_rejected_step_of_a_kilometre_is_not_ok(tmp_path: Path):
    """The unit of one edge is wrong, and no loop begins at its end."""
    laps(tmp_path / "laps.g2o", 100, 50)
    made = read_g2o(tmp_path / "laps.g2o")
    made.ij_T[20, :2, 3] *= 1000
    solved = solve_pose_graph(made, covariances=False)
    assert np.count_nonzero(~solved.edge_kept) == 1
    assert "1 edge (the first is vertex " in solved.status
    assert "is checked only by odometry that was rejected (the first is vertex " in solved.status


def test_rejected_odometry_between_poses_with_loops_leaves_nothing_unchecked():
    made = walk([(0, 5), (1, 6), (4, 6), (5, 7), (0, 11)])
    solved = solve_pose_graph(made)
    kept = solved.edge_kept.copy()
    kept[5] = False
    assert unchecked_components(from_pose_graph(made), replace(solved, edge_kept=kept)) == []


def test_a_loop_without_information_is_no_rejected_one():
    """Rejections beside loops of one place are a doubt, lost information is none."""
    made = walk([(0, 11), (1, 11), (5, 8)])
    made.information[-1] = 1e-100 * np.eye(3)
    assert solve_pose_graph(made).status == "ok"
