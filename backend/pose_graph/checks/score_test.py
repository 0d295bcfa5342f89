"""Score test of parameters that a solved pose graph does not have, such as a common offset of some loops.

The parameters change the residuals by known amounts. The test asks how far the chi-square would fall if they
were free and the poses followed, without another solve.

Source: Rao 1948 (score test); the poses are eliminated, as in Breusch and Pagan 1980 (Review of Economic
Studies 47), section 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, hstack

from backend import se3
from backend.pose_graph.elimination import colamd_order
from backend.pose_graph.linear import cholesky
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.prediction import noise_scale

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


def score_test(problem: Problem, w_T: Array, change: csc_array) -> ChiSquareModel | None:
    """Linearise all edges at a solution.

    ``change`` (m d, k) is the derivative of the whitened residuals by the further parameters. None if the
    system is singular, overflows, or is rounded away.
    """
    values = csc_array(hstack([csc_array(problem.residuals(w_T).reshape(-1, 1)), change]))
    J = _jacobian(problem, w_T)
    try:
        factor = cholesky(csc_array(J.T @ J), "NATURAL")
    except RuntimeError:
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # absurd residuals have no finite square
        projected = (J.T @ values).toarray()
        # What is left of each product once the poses have followed.
        left = (values.T @ values).toarray() - projected.T @ factor.solve(projected)
        variance = noise_scale(problem, np.ones(len(problem.i), dtype=bool), w_T) ** 2
        left /= variance
        rounding = np.finfo(float).eps * values.power(2).sum(axis=0).max() / variance
    # Beside an edge of very high information, what is left is less than the error of rounding.
    if not (np.isfinite(left).all() and rounding < 1):
        return None
    return ChiSquareModel(float(left[0, 0]), left[1:, 0], left[1:, 1:])


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
