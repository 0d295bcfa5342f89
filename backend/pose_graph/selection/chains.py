"""Join chains of odometry that only loops connect: the trajectories of several robots.

Nothing predicts the pose of one chain relative to another, so no gate can test their first loop. Each loop
between two chains is a hypothesis about it; the other loops between the same chains then agree or not, within
the odometry's uncertainty on both sides. The hypothesis with the most support joins the chains, and the
consistent set grows from there. The idea is that of Mangelson et al. 2018 (ICRA), section IV.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from backend import se3
from backend.pose_graph.initialize import tree_edges
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import MAX_HYPOTHESES
from backend.pose_graph.selection.places import ROW_LENGTH, place_pairs
from backend.pose_graph.selection.prediction import innovations

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Chain:
    """Poses that odometry connects, in a frame of their own."""

    members: Index
    """(k,) poses of the whole problem, increasing."""
    w_T: Array
    """(k, 4, 4)."""
    samples: Array
    """(k, d, s) samples of their posterior, right perturbations."""


def chain_members(problem: Problem) -> list[Index]:
    """Return the poses of each chain: the connected components of the trusted edges."""
    n = problem.count
    i, j = problem.i[problem.trusted], problem.j[problem.trusted]
    label = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)[1]
    order = np.argsort(label, kind="stable")
    return [np.sort(each) for each in np.split(order, np.flatnonzero(np.diff(label[order])) + 1)]


def connected(problem: Problem, chosen: Mask, among: Mask, w_T: Array) -> Mask:
    """Return ``chosen`` edges (m,), plus the best ``among`` others (m,) that connect all poses."""
    rank = np.where(chosen, 1e-9, np.where(among, 1, 1e9))
    cost = rank * (1 + (problem.residuals(w_T) ** 2).sum(axis=1))
    tree = tree_edges(problem.count, problem.i, problem.j, cost)
    return np.asarray(chosen | np.isin(np.arange(len(chosen)), tree))


def join_chains(problem: Problem, chains: list[Chain], out_of_time: Callable[[], bool]) -> tuple[Mask, Array]:
    """Return the loops (m,) that join all chains, one for each join, and all poses in the first one's frame.

    The loops of the whole problem must connect the chains.
    """
    state = Joining(problem, chains)
    first = state.w_T[0].copy()
    joints = np.zeros(len(problem.i), dtype=bool)
    while True:
        across = np.flatnonzero(state.label[problem.i] != state.label[problem.j])
        if len(across) == 0:
            return joints, first @ se3.inverse(state.w_T[0]) @ state.w_T
        best = state.best_loop(across, out_of_time)
        state.join(best)
        joints[best] = True


class Joining:
    """Poses, samples and frames of the chains while they are joined."""

    def __init__(self, problem: Problem, chains: list[Chain], scale: float = 1.0) -> None:
        """Begin with separate ``chains``; ``scale`` is the factor of the noise over the stated one."""
        n, d = problem.count, problem.dof
        self.problem, self.scale = problem, scale
        self.label = np.empty(n, dtype=np.int64)
        self.w_T = np.empty((n, 4, 4))
        self.samples = np.empty((n, d, chains[0].samples.shape[2]))
        for number, chain in enumerate(chains):
            self.label[chain.members] = number
            self.w_T[chain.members] = chain.w_T
            self.samples[chain.members] = chain.samples
        self.noise = np.random.default_rng(1).standard_normal((d, self.samples.shape[2]))

    def best_loop(self, across: Index, out_of_time: Callable[[], bool]) -> int:
        """Return the loop between two frames that most other loops between them support."""
        ends = np.sort(self.label[np.column_stack([self.problem.i, self.problem.j])[across]], axis=1)
        pair = ends[:, 0] * len(self.label) + ends[:, 1]
        found = [self.most_supported(across[pair == each], out_of_time) for each in np.unique(pair).tolist()]
        return max(found, key=lambda each: each[1])[0]

    def most_supported(self, loops: Index, out_of_time: Callable[[], bool]) -> tuple[int, float]:
        """Return the one of some ``loops`` (k,) between two frames that the others support most.

        The support is the negative log probability (nats) that false loops agree with it by chance. Of very
        many loops only some are tried.
        """
        place = place_pairs(self.problem.i[loops], self.problem.j[loops], ROW_LENGTH)
        best, most = int(loops[0]), 0.0
        for loop in loops[:: -(-len(loops) // MAX_HYPOTHESES)].tolist():
            if out_of_time():
                break
            support = self._support(loop, loops, place)
            if support > most:
                best, most = loop, support
        return best, most

    def _support(self, loop: int, loops: Index, place: Index) -> float:
        """Return the support (nats) of one loop by others; those between the same two places count once."""
        w_T, samples = self._placed(loop)
        found = innovations(self.problem, w_T, samples, loops, self.scale)
        agrees = found.agrees() & (place != place[loops == loop])
        surprise = np.zeros(place.max() + 1)
        np.maximum.at(surprise, place[agrees], -found.log_pass_probability()[agrees])
        return float(surprise.sum())

    def agreeing(self, loop: int, loops: Index) -> Mask:
        """Return which of some loops (k,) between two frames agree with one loop that joins them."""
        w_T, samples = self._placed(loop)
        return innovations(self.problem, w_T, samples, loops).agrees()

    def _placed(self, loop: int) -> tuple[Array, Array]:
        """Return poses and samples with the frame at the loop's end moved to where the loop puts it."""
        p = self.problem
        i, j = p.i[loop], p.j[loop]
        moved = np.flatnonzero(self.label == self.label[j])
        at = self.w_T[i] @ p.ij_T[loop]
        w_T, samples = self.w_T.copy(), self.samples.copy()
        w_T[moved] = at @ se3.inverse(self.w_T[j]) @ self.w_T[moved]
        own = np.linalg.pinv(p.sqrt_information[loop]) @ self.noise
        error = p.adjoint(se3.inverse(p.ij_T[loop])) @ samples[i] + own - samples[j]
        samples[moved] += p.adjoint(se3.inverse(w_T[moved]) @ at) @ error
        return w_T, samples

    def join(self, loop: int) -> None:
        """Put the frame at the loop's end into that at its beginning."""
        self.w_T, self.samples = self._placed(loop)
        here, there = self.label[self.problem.i[loop]], self.label[self.problem.j[loop]]
        self.label[self.label == there] = here
