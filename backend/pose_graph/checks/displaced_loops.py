"""Rejected loops that agree with each other: all of them are displaced in the same way.

Where a floor repeats, each false loop puts its second end one period away from where it is. Such loops may
outnumber the true ones, and a few of them may agree with the map by chance. Odometry that is wrong, and
believed, displaces true loops in the same way. The graph alone does not tell which of these it is.

A displacement has a frame: a floor that repeats displaces in the world, an exchanged calibration in the frame
of the second end. How often false loops agree by chance is measured on null loops.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.pose_graph.checks.solved_parts import solved_parts
from backend.pose_graph.chi_square import SIGNIFICANCE, chi_square_gate
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.null_loops import NullLoops
from backend.pose_graph.selection.places import ROW_LENGTH, place_pairs
from backend.pose_graph.selection.prediction import squared_mahalanobis
from backend.pose_graph.solution import Solution
from backend.quantiles import binomial_tail

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_SEEDS = 300
"""Loops with which all others are compared; of more loops, each n-th."""


@dataclass(frozen=True)
class _Displacements:
    """Transforms from where the map has the second ends of loops to where the loops put them."""

    T: Array
    """(k, 4, 4)."""
    covariance: Array
    """(k, d, d) of the loops' own noise, right perturbation."""
    planar: bool

    def agreeing(self, T: Array, covariance: Array) -> Mask:
        """Return (k,) which displacements equal one other (4, 4), with its covariance (d, d)."""
        apart = se3.inverse(T) @ self.T
        tangent = se3.planar_log(apart) if self.planar else se3.log(apart)
        most = chi_square_gate(tangent.shape[1])
        return np.asarray(squared_mahalanobis(tangent, self.covariance + covariance) <= most)


def displaced_loops(problem: Problem, solution: Solution) -> list[str]:
    """Return a sentence for each component with rejected loops that share a displacement."""
    sentences = []
    for part, w_T, inside in solved_parts(problem, solution, solution.edge_informative):
        group = displaced_group(part, solution.edge_kept[inside], w_T)
        if group.any():
            sentences.append(_sentence(part.with_edges(group), w_T))
    return sentences


def displaced_group(problem: Problem, kept: Mask, w_T: Array) -> Mask:
    """Return the largest group of rejected loops (m,) that share a displacement; empty if none does.

    Loops between the same two places count once.
    """
    loops, group = ~problem.trusted, np.zeros_like(kept)
    rejected = loops & ~kept
    if np.count_nonzero(rejected) < 2:
        return group
    place = place_pairs(problem.i, problem.j, ROW_LENGTH)
    null_loops = NullLoops.of(problem, np.flatnonzero(loops), place[loops]).problem
    found = [
        _largest_group(frame(problem.with_edges(rejected), w_T), frame(null_loops, w_T), place[rejected])
        for frame in (_in_world, _at_second_end)
    ]
    group[rejected] = max(found, key=np.count_nonzero)
    return group


def _largest_group(found: _Displacements, by_chance: _Displacements, place: Index) -> Mask:
    """Return the largest group (k,) of loops that agree more often than chance explains; empty if none."""
    count = len(np.unique(place))
    best = np.zeros(len(place), dtype=bool)
    for k in range(0, len(place), -(-len(place) // _SEEDS)):
        seed = found.T[k], found.covariance[k]
        agreeing = found.agreeing(*seed)
        elsewhere = len(np.unique(place[agreeing & (place != place[k])]))
        if elsewhere == 0 or np.count_nonzero(agreeing) <= np.count_nonzero(best):
            continue
        hits = np.count_nonzero(by_chance.agreeing(*seed))
        chance = (1 + hits) / (1 + len(by_chance.T))
        if binomial_tail(elsewhere, count - 1, chance) * len(place) <= SIGNIFICANCE:
            best = agreeing
    return best


def _in_world(problem: Problem, w_T: Array) -> _Displacements:
    there = w_T[problem.j]
    turn = problem.adjoint(there)
    T = w_T[problem.i] @ problem.ij_T @ se3.inverse(there)
    return _Displacements(T, turn @ _noise(problem) @ np.swapaxes(turn, 1, 2), problem.dimension == 2)


def _at_second_end(problem: Problem, w_T: Array) -> _Displacements:
    T = se3.inverse(w_T[problem.j]) @ w_T[problem.i] @ problem.ij_T
    return _Displacements(T, _noise(problem), problem.dimension == 2)


def _noise(problem: Problem) -> Array:
    R = problem.sqrt_information
    return np.asarray(np.linalg.pinv(np.swapaxes(R, 1, 2) @ R, hermitian=True))


def _sentence(group: Problem, w_T: Array) -> str:
    off = _at_second_end(group, w_T).T
    length = float(np.median(np.linalg.norm(off[:, :3, 3], axis=1)))
    angle = float(np.median(np.degrees(np.linalg.norm(se3.log(off)[:, :3], axis=1))))
    first = f"{group.name(group.i[0])} to {group.name(group.j[0])}"
    return (
        f"{len(group.i)} rejected loops (the first is {first}) agree with each other, {length:.2g}"
        f" {group.length_unit} and {angle:.2g} deg from the map: a floor that repeats, or a map that is wrong"
        " there; compare these places, and the loops beside them"
    )
