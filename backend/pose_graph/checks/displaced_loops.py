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
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.null_loops import NullLoops
from backend.pose_graph.selection.places import ROW_LENGTH, place_pairs
from backend.pose_graph.selection.prediction import SIGNIFICANCE, chi_square_gate, squared_mahalanobis
from backend.pose_graph.solution import NO_INFORMATION, Solution
from backend.quantiles import binomial_tail

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_SEEDS = 300
"""Loops with which all others are compared; of more loops, each n-th."""


@dataclass(frozen=True)
class Displacements:
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
    """Return a sentence about the largest group of rejected loops that share a displacement, if one does.

    Loops between the same two places count once.
    """
    informative = np.array([reason != NO_INFORMATION for reason in solution.edge_reason], dtype=bool)
    placed = (solution.component[problem.i] >= 0) & (solution.component[problem.j] >= 0)
    loops = np.flatnonzero(~problem.trusted & placed & informative)
    rejected = loops[~solution.edge_kept[loops]]
    if len(rejected) < 2:
        return []
    place = place_pairs(problem.i, problem.j, ROW_LENGTH)
    null = NullLoops.of(problem, loops, place[loops]).problem
    best: Index = rejected[:0]
    for frame in (_in_world, _at_second_end):
        found, by_chance = (
            frame(p, solution.w_T_b)
            for p in (problem.with_edges(np.isin(np.arange(len(place)), rejected)), null)
        )
        group = rejected[_largest_group(found, by_chance, place[rejected])]
        best = max(best, group, key=len)
    return [_sentence(problem, solution, best)] if len(best) else []


def _largest_group(found: Displacements, by_chance: Displacements, place: Index) -> Mask:
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


def _in_world(problem: Problem, w_T: Array) -> Displacements:
    there = w_T[problem.j]
    turn = problem.adjoint(there)
    T = w_T[problem.i] @ problem.ij_T @ se3.inverse(there)
    return Displacements(T, turn @ _noise(problem) @ np.swapaxes(turn, 1, 2), problem.dimension == 2)


def _at_second_end(problem: Problem, w_T: Array) -> Displacements:
    T = se3.inverse(w_T[problem.j]) @ w_T[problem.i] @ problem.ij_T
    return Displacements(T, _noise(problem), problem.dimension == 2)


def _noise(problem: Problem) -> Array:
    R = problem.sqrt_information
    return np.asarray(np.linalg.pinv(np.swapaxes(R, 1, 2) @ R, hermitian=True))


def _sentence(problem: Problem, solution: Solution, group: Index) -> str:
    i, j = problem.i[group], problem.j[group]
    off = se3.inverse(solution.w_T_b[j]) @ solution.w_T_b[i] @ problem.ij_T[group]
    length = float(np.median(np.linalg.norm(off[:, :3, 3], axis=1)))
    angle = float(np.median(np.degrees(np.linalg.norm(se3.log(off)[:, :3], axis=1))))
    unit = problem.length_unit
    return (
        f"{len(group)} rejected loops (the first is {problem.name(i[0])} to {problem.name(j[0])}) agree with"
        f" each other, {length:.2g} {unit} and {angle:.2g} deg from the map: a floor that repeats, or a map"
        " that is wrong there; compare these places, and the loops beside them"
    )
