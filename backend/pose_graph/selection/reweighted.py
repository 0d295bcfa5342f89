"""The fit of all edges in which those far off lose their weight, and the noise that the others show.

A few false loops strain the fit of all edges everywhere, so that no residual tells the noise. Each fit with
less weight on the edges far off strains less, and the noise falls until it is that of the true edges. Most
edges must be true. Source: Black and Rangarajan 1996 (IJCV 19), section 4 (the weights of Geman and McClure).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from backend.pose_graph.chi_square import chi_square_gate
from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, least_squares_fit
from backend.pose_graph.marginals import posterior
from backend.pose_graph.problem import Problem
from backend.quantiles import chi_square_quantile

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_CHECKED = 0.3
"""Least share of an edge's own variance in that of its innovation, along a direction where others check it: a
third in a triangle of equal edges, the smallest cycle that tells their noise. In a longer one a false loop
would look like the noise of all its edges."""
_ROUNDS = 20
"""Maximum number of fits. Most graphs need four."""
_STRAINED = 2.0
"""Ratio of the mean squared residual to that of a typical edge, from which on false loops strain the fit. It
is 1.1 for the pictures of a compressed video, and above 5 with one false loop."""
_SETTLED = 0.95
"""Ratio of the noise of two fits from which on they agree."""


@dataclass(frozen=True)
class ReweightedFit:
    """Poses, and how far each edge lies from where the others have it."""

    problem: Problem
    w_T: Array
    """(n, 4, 4)."""
    squared: Array
    """(m,) squared innovation of each edge, in its own stated deviations."""
    dof: float
    """Degrees of freedom of the residuals of all edges."""

    @property
    def typical_variance(self) -> float:
        """Factor of a typical edge's variance over the stated one."""
        return float(np.median(self.squared)) / chi_square_quantile(0.5, self.problem.dof)

    @property
    def noise(self) -> float:
        """The same factor, and at least 1: covariances are not narrowed."""
        return max(self.typical_variance, 1.0)

    @property
    def limit(self) -> float:
        """Squared innovation that a true edge hardly exceeds, by that noise."""
        return chi_square_gate(self.problem.dof) * self.noise

    @property
    def agreeing(self) -> Mask:
        """(m,) whether an edge lies within its limit."""
        return np.asarray(self.squared <= self.limit)

    @property
    def weight(self) -> Array:
        """(m,) weight of each edge in the next fit: a quarter at the limit."""
        return np.asarray(1 / (1 + self.squared / self.limit) ** 2)


def reweighted_fit(gauge_fixed: GaugeFixedProblem, w_T: Array) -> ReweightedFit:
    """Return the fit; ``w_T`` (n, 4, 4) is that of all edges.

    That one is the result where no strain is seen: the weights take a part of the true noise with them.
    """
    problem = gauge_fixed.problem
    every = np.ones(len(problem.i), dtype=bool)
    found = _at(gauge_fixed, w_T, np.ones(len(problem.i)))
    residual = float((problem.residuals(w_T) ** 2).sum())
    if residual <= found.noise * max(chi_square_gate(found.dof), _STRAINED * found.dof):
        return found
    for _ in range(_ROUNDS):
        weight, limit = found.weight, found.limit
        weighted = replace(gauge_fixed, problem=_weighted(problem, weight))
        try:
            found = _at(gauge_fixed, least_squares_fit(weighted, every, found.w_T).w_T, weight)
        except BackendError:  # an edge that alone joins two parts has lost its weight
            break
        if gauge_fixed.options.out_of_time() or found.limit > _SETTLED * limit:
            break
    return found


def _weighted(problem: Problem, weight: Array) -> Problem:
    """Return the problem with the information of each edge multiplied by its weight (m,)."""
    return replace(problem, sqrt_information=np.sqrt(weight)[:, None, None] * problem.sqrt_information)


def _at(gauge_fixed: GaugeFixedProblem, w_T: Array, weight: Array) -> ReweightedFit:
    """Compute the innovations at the fit with the weights (m,) of all edges.

    The fit follows each edge, so that a residual is a share of the innovation only. Along directions that no
    other measurement checks, the residual is taken as it is.
    """
    problem = gauge_fixed.problem
    graph = replace(gauge_fixed, problem=_weighted(problem, weight)).graph(np.ones(len(weight), dtype=bool))
    predicted = posterior(graph, problem.values(w_T), (), gauge_fixed.edges).predictions
    predicted[~np.isfinite(predicted).all(axis=(1, 2))] = np.eye(problem.dof)
    variance, axes = np.linalg.eigh(predicted)
    along = np.einsum("mab,ma->mb", axes, problem.residuals(w_T)) ** 2
    share = 1 - np.minimum(weight[:, None] * variance, 1.0)
    # The innovation is the residual over its share. Its variance is that of edge and prediction together.
    whole = share + variance
    checked = share > _CHECKED * whole
    squared = (along / np.where(checked, share * whole, 1.0)).sum(axis=1)
    return ReweightedFit(problem, w_T, squared, float(share.sum()))
