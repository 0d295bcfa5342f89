"""Evidence (marginal likelihood) of a set of accepted loops; rejected loops are uniform over the map.

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
from backend.pose_graph.selection.prediction import log_prior_volume, noise_scale

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Graph = Callable[[Mask], gtsam.NonlinearFactorGraph]
"""Function from kept edges (m,) to their factor graph, with all priors."""


@dataclass(frozen=True)
class LinearizedSet:
    """A set of edges, its solution, and the linear system at it."""

    kept: Mask
    w_T: Array
    loops: Mask
    J: csr_array
    """(m d, size) of all edges, columns in the order in which they are eliminated."""
    factor: SuperLU
    """Cholesky factor of the information of the kept edges."""
    chi_square: float
    log_volumes: Array
    """(m,) log of the whitened volume over which a false loop is uniform, over that of a unit Gaussian."""
    scale: float
    """Estimated factor on the stated standard deviations."""

    @staticmethod
    def of(
        problem: Problem, graph: Graph, kept: Mask, w_T: Array, log_volumes: Array
    ) -> LinearizedSet | None:
        """Linearise the kept edges (m,) at their poses; None if the system is singular."""
        m, d = len(problem.i), problem.dof
        order = elimination_order(graph(kept), d)
        J = csr_array(jacobian(graph(np.ones(m, dtype=bool)), problem.values(w_T), order))
        edges = J[: m * d]
        used = J[np.append(np.repeat(kept, d), np.ones(J.shape[0] - m * d, dtype=bool))]
        try:
            factor = cholesky(csc_array(used.T @ used), "NATURAL")
        except RuntimeError:
            return None
        chi_square = float((problem.residuals(w_T)[kept] ** 2).sum())
        scale = noise_scale(problem, kept, w_T)
        return LinearizedSet(
            kept=kept,
            w_T=w_T,
            loops=~problem.trusted,
            J=edges,
            factor=factor,
            chi_square=chi_square,
            log_volumes=log_volumes,
            scale=scale,
        )

    @property
    def odds(self) -> float:
        """Prior log odds that a loop is true, from the share of kept ones."""
        return log_odds(self.kept, self.loops)

    def evidence(self, odds: float) -> float:
        """Return the log evidence by Laplace's approximation at the set's own noise scale.

        It is exact up to a constant that is common to all sets of the same edges.
        """
        size, d = self.J.shape[1], self.J.shape[0] // len(self.kept)
        volume = float(np.log(np.abs(self.factor.U.diagonal())).sum()) / 2 - size * np.log(self.scale)
        prior = np.where(self.loops, odds, odometry_log_odds(self.loops)) - d * np.log(self.scale)
        gained = float((self.log_volumes + prior)[self.kept].sum())
        return float(gained - self.chi_square / self.scale**2 / 2 - volume)


def odometry_log_odds(loops: Mask) -> float:
    """Return the prior log odds that an edge of odometry is true: none of them is known to be false.

    Laplace's rule of succession for as many true edges as are no ``loops`` (m,).
    """
    return float(np.log1p(np.count_nonzero(~loops)))


def log_unit_volumes(problem: Problem, w_T: Array) -> Array:
    """Return (m,) log whitened volumes in which a false edge may lie, over that of a unit Gaussian."""
    return np.asarray(log_prior_volume(problem, w_T) - problem.dof / 2 * np.log(2 * np.pi))
