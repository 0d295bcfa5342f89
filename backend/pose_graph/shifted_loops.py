"""Score test of loops whose vertex numbers are shifted along the odometry.

A file whose loops all name the vertex before or after the right one gives a map that bends to fit them. Where
loops are long, each edge of odometry takes a small share, and the chi-square test passes. The shift is then
one common parameter of all loops: the residual of a loop changes by a known amount for each vertex that its
end moves. The test asks whether the chi-square would fall if the loops were shifted back.

Source: Rao 1948 (score test); the other parameters are eliminated, as in Breusch and Pagan 1980 (Review of
Economic Studies 47), section 2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from backend import se3
from backend.gauge import format_keys
from backend.pose_graph.elimination import colamd_order
from backend.pose_graph.linear import cholesky
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.prediction import SIGNIFICANCE, noise_scale
from backend.pose_graph.solution import Solution

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

SHIFTS = np.array([pair for pair in product(range(-2, 3), repeat=2) if pair != (0, 0)])
"""(24, 2) numbers of vertices by which the loops' first and second ends move: 1 where a file counts from 1
instead of 0, or lost a row; 2 where both happened."""
_MIN_GAIN = 2 * float(np.log(len(SHIFTS) / SIGNIFICANCE))
"""Fall of the chi-square that none of the shifts reaches by chance but once in a thousand graphs."""


def shifted_loops(problem: Problem, solution: Solution) -> list[str]:
    """Return a sentence for each component whose kept loops agree better with other vertex numbers."""
    sentences = []
    for number in range(int(solution.component.max(initial=-1)) + 1):
        members = np.flatnonzero(solution.component == number)
        kept = solution.edge_kept & (solution.component[problem.i] == number)
        part = problem.with_edges(kept).restricted(members)
        test = None if part.trusted.all() else shift_test(part, solution.w_T_b[members])
        if test is None:
            continue
        gains = test.gains(SHIFTS)
        best = int(np.argmax(gains))
        if gains[best] > _MIN_GAIN:
            first, second = SHIFTS[best]
            sentences.append(
                f"{format_keys(members.tolist(), problem.name)}: the loops agree better with the odometry if"
                f" their first ends move by {first:+d} vertices along it and their second ends by"
                f" {second:+d} (chi-square {test.statistic - gains[best]:.4g} instead of"
                f" {test.statistic:.4g}); check the vertex numbers of the loops"
            )
    return sentences


@dataclass(frozen=True)
class ShiftTest:
    """Quadratic model of the chi-square over the shifts (2,) of the loops' first and second vertices."""

    statistic: float
    """Chi-square without a shift, in units of the estimated noise."""
    score: Array
    """(2,) half its gradient."""
    information: Array
    """(2, 2) half its second derivative after the poses have followed."""

    def gains(self, shifts: Array) -> Array:
        """Return (k,) by how much each of some shifts (k, 2) lowers the chi-square.

        It cannot fall below zero: beside an edge of very high information, more is an error of rounding.
        """
        falls = -2 * shifts @ self.score - np.einsum("ka,ab,kb->k", shifts, self.information, shifts)
        return np.asarray(np.minimum(falls, self.statistic))


def shift_test(problem: Problem, w_T: Array) -> ShiftTest | None:
    """Linearise all edges and the shifts of the loops at a solution.

    None if the system is singular, overflows, or is rounded away.
    """
    residual = problem.residuals(w_T)
    columns = [residual, *(_change(problem, w_T, residual, end) for end in (0, 1))]
    values = np.column_stack([each.ravel() for each in columns])
    J = _jacobian(problem, w_T)
    try:
        factor = cholesky(csc_array(J.T @ J), "NATURAL")
    except RuntimeError:
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # absurd residuals have no finite square
        projected = np.asarray(J.T @ values)
        # What is left of each product once the poses have followed.
        left = values.T @ values - projected.T @ factor.solve(projected)
        variance = noise_scale(problem, np.ones(len(problem.i), dtype=bool), w_T) ** 2
        left /= variance
        rounding = np.finfo(float).eps * (values**2).sum(axis=0).max() / variance
    # Beside an edge of very high information, what is left is less than the error of rounding.
    if not (np.isfinite(left).all() and rounding < 1):
        return None
    return ShiftTest(float(left[0, 0]), left[1:, 0], left[1:, 1:])


def _change(problem: Problem, w_T: Array, residual: Array, end: int) -> Array:
    """Return the change (m, d) of the residuals per vertex that one end of the loops moves along odometry."""
    change, count = np.zeros_like(residual), np.zeros(len(residual))
    for step in (-1, 1):
        moved, valid = _moved(problem, end, step)
        change[valid] += step * (moved.residuals(w_T)[valid] - residual[valid])
        count += valid
    return change / np.maximum(count, 1)[:, None]


def _moved(problem: Problem, end: int, step: int) -> tuple[Problem, Mask]:
    """Return the problem with one end of each loop a step ahead, and which loops (m,) could move."""
    odometry = np.sort(np.column_stack([problem.i, problem.j])[problem.trusted], axis=1)
    low, high = odometry.T
    beside = np.full(problem.count, -1, dtype=np.int64)
    beside[low if step > 0 else high] = high if step > 0 else low
    ends = [problem.i, problem.j]
    target = beside[ends[end]]
    valid = ~problem.trusted & (target >= 0) & (target != ends[1 - end])
    ends[end] = np.where(valid, target, ends[end])
    return replace(problem, i=ends[0], j=ends[1]), valid


def _jacobian(problem: Problem, w_T: Array) -> csc_array:
    """Return the derivatives of small residuals by the free poses, in a fill-reducing order."""
    d, m = problem.dof, len(problem.i)
    order = colamd_order(problem.i, problem.j)
    fixed = [a.k for a in problem.unary_factors if a.kind == "fixed"] or [0]
    order = order[~np.isin(order, fixed)]
    place = np.full(problem.count, -1, dtype=np.int64)
    place[order] = np.arange(len(order))
    i, j, R = problem.i, problem.j, problem.sqrt_information
    blocks = np.concatenate([-R @ problem.adjoint(se3.inverse(w_T[j]) @ w_T[i]), R])
    edge, pose = np.tile(np.arange(m), 2), np.concatenate([place[i], place[j]])
    row = np.broadcast_to(edge[:, None, None] * d + np.arange(d)[:, None], blocks.shape)
    column = np.broadcast_to(pose[:, None, None] * d + np.arange(d), blocks.shape)
    free = column >= 0
    return csc_array((blocks[free], (row[free], column[free])), shape=(m * d, len(order) * d))
