"""Evidence (marginal likelihood) of a set of accepted loops; rejected ones are uniform over the map.

Source: MacKay 1992 (Neural Computation 4), section 3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import SuperLU

from backend.pose_graph.linear import cholesky, elimination_order, jacobian
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import log_odds
from backend.pose_graph.selection.prediction import noise_scale

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Graph = Callable[[Mask], gtsam.NonlinearFactorGraph]
"""The factors of some edges, with all that holds them."""


@dataclass(frozen=True)
class LinearizedSet:
    """A set of edges, its solution, and the linear system about it."""

    kept: Mask
    w_T: Array
    loops: Mask
    J: csr_array
    """(m d, size) of all edges, columns in the order in which they are eliminated."""
    factor: SuperLU
    """Of the information of those that are kept."""
    squares: float
    log_volumes: Array
    """(m,) log of the whitened volume over which a false loop is uniform, over that of a unit Gaussian."""
    scale: float
    """Factor on the stated standard deviations."""

    @staticmethod
    def of(
        problem: Problem, graph: Graph, kept: Mask, w_T: Array, log_volumes: Array
    ) -> LinearizedSet | None:
        """Of some edges (m,) and the poses from them; None where the system is singular."""
        m, d = len(problem.i), problem.dof
        order = elimination_order(graph(kept), d)
        J = csr_array(jacobian(graph(np.ones(m, dtype=bool)), problem.values(w_T), order))
        edges = J[: m * d]
        used = J[np.append(np.repeat(kept, d), np.ones(J.shape[0] - m * d, dtype=bool))]
        try:
            factor = cholesky(csc_array(used.T @ used), "NATURAL")
        except RuntimeError:
            return None
        squares = float((problem.residuals(w_T)[kept] ** 2).sum())
        scale = noise_scale(problem, kept, w_T)
        return LinearizedSet(kept, w_T, ~problem.trusted, edges, factor, squares, log_volumes, scale)

    @property
    def odds(self) -> float:
        """Prior log odds that a loop is true."""
        return log_odds(self.kept, self.loops)

    def evidence(self, scale: float, odds: float) -> float:
        """Log evidence by Laplace's approximation, up to a constant that all sets share."""
        d = self.J.shape[0] // len(self.kept)
        taken = self.kept & self.loops
        volume = float(np.log(np.abs(self.factor.U.diagonal())).sum())
        gained = float((self.log_volumes[taken] - d * np.log(scale) + odds).sum())
        return gained - self.squares / scale**2 / 2 - volume / 2
