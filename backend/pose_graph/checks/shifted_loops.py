"""Score test of loops whose vertex numbers are shifted along the odometry.

A file whose loops all name the vertex before or after the right one gives a map that bends to fit them. Where
loops are long, each edge of odometry takes a small share, and the chi-square test passes. The shift is then
one common parameter of all loops: the residual of a loop changes by a known amount for each vertex that its
end moves. The test asks whether the chi-square would fall if the loops were shifted back.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from backend.gauge import format_keys
from backend.pose_graph.checks.score_test import ChiSquareModel, LinearisedEdges
from backend.pose_graph.chi_square import SIGNIFICANCE
from backend.pose_graph.problem import Problem

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

SHIFTS = np.array([pair for pair in product(range(-2, 3), repeat=2) if pair != (0, 0)])
"""(24, 2) numbers of vertices by which the loops' first and second ends move: 1 where a file counts from 1
instead of 0, or lost a row; 2 where both happened."""
_MIN_GAIN = 2 * float(np.log(len(SHIFTS) / SIGNIFICANCE))
"""Fall of the chi-square that none of the shifts reaches by chance but once in a thousand graphs."""


def shifted_loops(problem: Problem, test: ChiSquareModel | None) -> list[str]:
    """Return a sentence if the loops of a part agree better with other vertex numbers.

    ``test`` is that of `shift_columns`, or None if the part cannot be tested.
    """
    if test is None:
        return []
    fall = gains(test, SHIFTS)
    best = int(np.argmax(fall))
    if fall[best] <= _MIN_GAIN:
        return []
    first, second = SHIFTS[best]
    return [
        f"{format_keys(range(problem.count), problem.name)}: the loops agree better with the odometry if"
        f" their first ends move by {first:+d} vertices along it and their second ends by"
        f" {second:+d} (chi-square {test.statistic - fall[best]:.4g} instead of"
        f" {test.statistic:.4g}); check the vertex numbers of the loops"
    ]


def gains(test: ChiSquareModel, shifts: Array) -> Array:
    """Return (k,) by how much each of some shifts (k, 2) lowers the chi-square.

    It cannot fall below zero: beside an edge of very high information, more is an error of rounding.
    """
    falls = -2 * shifts @ test.score - np.einsum("ka,ab,kb->k", shifts, test.information, shifts)
    return np.asarray(np.minimum(falls, test.statistic))


def shift_columns(linearised: LinearisedEdges) -> csc_array:
    """Return the derivatives (m d, 2) of the residuals by the vertices that the loops' two ends move."""
    return csc_array(np.column_stack([_change(linearised, end).ravel() for end in (0, 1)]))


def _change(linearised: LinearisedEdges, end: int) -> Array:
    """Return the change (m, d) of the residuals per vertex that one end of the loops moves along odometry."""
    residual = linearised.residuals
    change, count = np.zeros_like(residual), np.zeros(len(residual))
    for step in (-1, 1):
        moved, valid = _moved(linearised.problem, end, step)
        change[valid] += step * (moved.residuals(linearised.w_T)[valid] - residual[valid])
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
