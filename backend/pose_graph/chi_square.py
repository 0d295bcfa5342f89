"""Chi-square tests: global consistency of all edges, and the gate of a single edge."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from backend.pose_graph.problem import Problem
from backend.quantiles import chi_square_limit, chi_square_quantile
from backend.significance import FALSE_ALARM

SIGNIFICANCE = FALSE_ALARM
"""Significance level of the global test and of all gates, and limit of the false discovery rate."""
_FAR_BELOW = 0.1
"""Ratio of a chi-square to its degrees of freedom below which the stated covariances are questioned."""


@dataclass(frozen=True)
class ChiSquare:
    """Result of a chi-square test on the edges' squared whitened residuals."""

    statistic: float
    dof: int
    limit: float

    @property
    def passed(self) -> bool:
        """Whether noise explains the statistic."""
        return self.statistic <= self.limit

    @property
    def is_below(self) -> bool:
        """Whether the statistic is too small by chance: the stated covariances are too large."""
        return self.dof > 0 and self.statistic < chi_square_quantile(SIGNIFICANCE, self.dof)

    def at(self, noise: float) -> ChiSquare:
        """Return the test with the standard deviations of all edges multiplied by a factor."""
        return replace(self, statistic=self.statistic / noise**2)

    @property
    def is_far_below(self) -> bool:
        """Whether the statistic is so small that the stated covariances are worth a warning."""
        return self.is_below and self.statistic < _FAR_BELOW * self.dof


def chi_square(problem: Problem, statistic: float) -> ChiSquare:
    """Test whether the edges agree with each other and with the unary factors.

    ``statistic`` is the sum of the edges' squared whitened residuals. The degrees of freedom are those of
    the cycles, plus the rows of the unary factors up to the size of a spanning tree.
    """
    rows = sum(unary.gaussian.dim() for unary in problem.unary_factors)
    return edges_test(problem.dof, problem.count, len(problem.i), rows, statistic)


def edges_test(dof: int, poses: int, edges: int, unary_rows: int, statistic: float) -> ChiSquare:
    """Test a sum of squared whitened residuals by the numbers of poses, edges and rows of unary factors.

    ``dof`` is that of one pose: 3 or 6.
    """
    tree = dof * (poses - 1)
    free = dof * edges - tree + min(unary_rows, tree)
    # A tree of edges always fits: its residuals are rounding errors.
    return ChiSquare(statistic, free, chi_square_gate(free) if free > 0 else np.inf)


def chi_square_gate(dof: float) -> float:
    """Return the squared whitened distance of ``dof`` numbers that a true edge exceeds once in a thousand."""
    return chi_square_limit(SIGNIFICANCE, dof)
