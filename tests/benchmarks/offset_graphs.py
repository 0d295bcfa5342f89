"""Generated graphs in which a share of the loops has one common offset, as a repeating floor makes it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from backend import se3
from backend.pose_graph.solution import Solution
from backend.pose_graph.solve import solve_pose_graph
from tests.benchmarks.false_loops import edges_of
from tests.benchmarks.generated_graphs import SHAPES, MadeGraph, Scene, make
from tests.benchmarks.graphs import aligned_rmse

WHERE = ("stretch", "tail", "mixed")
"""Loops with the offset: a row of them in order of their later ends, the last ones, or any of them."""


@dataclass(frozen=True)
class OffsetScene:
    """Parameters of one graph; see `Scene`."""

    shape: str
    robots: int
    poses_per_loop: int
    share: float
    size_m: float
    where: str
    seed: int


def offset_scenes(seeds: range) -> Iterator[OffsetScene]:
    """Yield all combinations."""
    for each in product(SHAPES, (1, 2, 3), (1, 2, 4), (0.3, 0.4, 0.5, 0.6), (0.3, 1.0, 3.0), WHERE, seeds):
        yield OffsetScene(*each)


def make_offset(scene: OffsetScene) -> MadeGraph:
    """Make one graph: some loops place their later ends elsewhere in the world, by one transform."""
    made = make(Scene(scene.shape, scene.robots, scene.poses_per_loop, 0.0, "random", scene.seed))
    graph, w_T = made.graph, made.w_T
    about = [scene.robots, scene.poses_per_loop, round(100 * scene.share), round(100 * scene.size_m)]
    rng = np.random.default_rng([scene.seed, *about, WHERE.index(scene.where)])
    later = np.maximum(graph.i, graph.j)
    loops = np.flatnonzero(~made.odometry)
    loops = loops[np.argsort(later[loops], kind="stable")]
    count = round(scene.share * len(loops))
    begin = int(rng.integers(len(loops) - count + 1)) if scene.where == "stretch" else len(loops) - count
    some = rng.permutation(loops) if scene.where == "mixed" else loops
    wrong = np.isin(np.arange(len(later)), some[begin : begin + count])
    to, turn = rng.uniform(0, 2 * np.pi), rng.normal(scale=0.2 * min(scene.size_m, 1.0))
    middle = np.eye(4)
    middle[:3, 3] = w_T[later[wrong], :3, 3].mean(axis=0)
    offset = se3.from_planar(np.array([[scene.size_m * np.cos(to), scene.size_m * np.sin(to), turn]]))[0]
    offset = middle @ offset @ se3.inverse(middle)
    # The measurement is that between the earlier end and the later one, moved by the offset.
    at_j = se3.inverse(w_T[graph.j]) @ offset @ w_T[graph.j]
    at_i = se3.inverse(w_T[graph.i]) @ se3.inverse(offset) @ w_T[graph.i]
    forward = (graph.j > graph.i)[:, None, None]
    moved = np.where(forward, graph.ij_T @ at_j, at_i @ graph.ij_T)
    ij_T = np.where(wrong[:, None, None], moved, graph.ij_T)
    return replace(made, graph=replace(graph, ij_T=ij_T), false=wrong)


def error_ratio(made: MadeGraph, solution: Solution) -> float:
    """Return the position error over that of the graph without its false loops."""
    clean = solve_pose_graph(edges_of(made.graph, ~made.false), covariances=False, loops_robust=False)
    error, best = (aligned_rmse(each.w_T_b[:, :3, 3], made.w_T[:, :3, 3]) for each in (solution, clean))
    return error / best
