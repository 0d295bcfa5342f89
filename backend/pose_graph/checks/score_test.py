"""Score test of parameters that a solved pose graph does not have, such as a common offset of some loops.

The parameters change the residuals by known amounts. The test asks how far the chi-square would fall if they
were free and the poses followed, without another solve.

Source: Rao 1948 (score test); the poses are eliminated, as in Breusch and Pagan 1980 (Review of Economic
Studies 47), section 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, diags_array, hstack

from backend import se3
from backend.pose_graph.checks.solved_parts import solved_parts
from backend.pose_graph.elimination import colamd_order
from backend.pose_graph.linear import cholesky
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.prediction import noise_scale
from backend.pose_graph.solution import Solution

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChiSquareModel:
    """Quadratic model of the chi-square over k further parameters."""

    statistic: float
    """Chi-square without the parameters, in units of the estimated noise."""
    score: Array
    """(k,) half its gradient."""
    information: Array
    """(k, k) half its second derivative after the poses have followed."""


@dataclass(frozen=True)
class LinearisedEdges:
    """Edges of a connected part, linearised at its solution."""

    problem: Problem
    w_T: Array
    """(n, 4, 4) poses of the solution."""

    @cached_property
    def residuals(self) -> Array:
        """(m, d) whitened residuals of the edges."""
        return self.problem.residuals(self.w_T)

    @cached_property
    def noise_scale(self) -> float:
        """Estimated factor on the stated standard deviations."""
        return noise_scale(self.problem, np.ones(len(self.problem.i), dtype=bool), self.w_T)

    @cached_property
    def _jacobian(self) -> csc_array:
        return _jacobian(self.problem, self.w_T)

    def score_tests(self, *changes: csc_array) -> list[ChiSquareModel | None]:
        """Test groups of parameters, each by the derivative (m d, k) of the whitened residuals by them.

        One elimination of the poses serves all. The result is None for all if the system is singular, and for
        a group that overflows or is rounded away.
        """
        values = csc_array(hstack([csc_array(self.residuals.reshape(-1, 1)), *changes]))
        with np.errstate(over="ignore", invalid="ignore"):  # absurd residuals have no finite square
            variance = self.noise_scale**2
            left = _after_elimination(self._jacobian, values)
            if left is None:
                return [None] * len(changes)
            left /= variance
            # Beside an edge of very high information, what is left is less than the error of rounding.
            rounding = np.finfo(float).eps * values.power(2).sum(axis=0) / variance
        ends = np.cumsum([1, *(change.shape[1] for change in changes)])
        groups = [np.append(0, np.arange(begin, end)) for begin, end in pairwise(ends)]
        return [_model(left[np.ix_(group, group)]) if rounding[group].max() < 1 else None for group in groups]


def _model(left: Array) -> ChiSquareModel | None:
    if not np.isfinite(left).all():
        return None
    return ChiSquareModel(float(left[0, 0]), left[1:, 0], left[1:, 1:])


def _after_elimination(J: csc_array, values: csc_array) -> Array | None:
    """Return the products of columns (k, k) once the poses have followed; None if their system is singular.

    The columns are eliminated last, in one factorisation with the poses. It touches the few entries that a
    column fills; a solve for each column would touch all of the factor, and takes three times as long.
    """
    columns = csc_array(hstack([J, values]))
    products = csc_array(columns.T @ columns)
    n, own = J.shape[1], products.diagonal()[J.shape[1] :]
    # Columns of which nothing is left keep a pivot; their own size costs no digit that is not lost anyway.
    pivot = np.where(own > 0, own, 1.0)
    try:
        factor = cholesky(csc_array(products + diags_array(np.append(np.zeros(n), pivot))), "NATURAL")
    except RuntimeError:
        return None
    lower, upper = (csc_array(part)[n:, n:].toarray() for part in (factor.L, factor.U))
    return np.asarray(lower @ upper - np.diag(pivot))


def linearised_parts(problem: Problem, solution: Solution) -> list[LinearisedEdges]:
    """Return the kept edges of each connected part that has a loop."""
    parts = solved_parts(problem, solution, solution.edge_kept)
    return [LinearisedEdges(part, w_T) for part, w_T, _ in parts if not part.trusted.all()]


def by_end(problem: Problem, w_T: Array) -> tuple[Array, Array]:
    """Return the derivatives (m, d, d) of small whitened residuals by the poses of either end."""
    i, j, R = problem.i, problem.j, problem.sqrt_information
    return -R @ problem.adjoint(se3.inverse(w_T[j]) @ w_T[i]), R


def _jacobian(problem: Problem, w_T: Array) -> csc_array:
    """Return the derivatives of small residuals by the free poses, in a fill-reducing order."""
    d, m = problem.dof, len(problem.i)
    order = colamd_order(problem.i, problem.j)
    fixed = [a.k for a in problem.unary_factors if a.kind == "fixed"] or [0]
    order = order[~np.isin(order, fixed)]
    place = np.full(problem.count, -1, dtype=np.int64)
    place[order] = np.arange(len(order))
    blocks = np.concatenate(by_end(problem, w_T))
    edge, pose = np.tile(np.arange(m), 2), np.concatenate([place[problem.i], place[problem.j]])
    row = np.broadcast_to(edge[:, None, None] * d + np.arange(d)[:, None], blocks.shape)
    column = np.broadcast_to(pose[:, None, None] * d + np.arange(d), blocks.shape)
    free = column >= 0
    return csc_array((blocks[free], (row[free], column[free])), shape=(m * d, len(order) * d))
