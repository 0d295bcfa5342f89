"""Do all edges fit together, and how far off may one of them be: chi-square tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from backend.pose_graph.problem import Problem

CONFIDENCE = 0.999
"""Of the global test, and of the limit for one edge."""


@dataclass(frozen=True)
class ChiSquare:
    """Sum of the squared whitened residuals of the edges against what chance allows."""

    statistic: float
    dof: int
    limit: float

    @property
    def passed(self) -> bool:
        """Whether chance explains the sum."""
        return self.statistic <= self.limit


def chi_square(problem: Problem, statistic: float) -> ChiSquare:
    """Test whether the edges agree with each other and with the absolute measurements.

    ``statistic`` is the sum of the edges' squared whitened residuals. The freedom is that of the edges'
    loops, plus what absolute measurements may ask of them.
    """
    d = problem.dof
    tree = d * (problem.count - 1)
    rows = sum(unary.plain.dim() for unary in problem.unary_factors)
    dof = d * len(problem.i) - tree + min(rows, tree)
    # A tree of edges always fits: its residuals are rounding.
    return ChiSquare(statistic, dof, float(chi2.ppf(CONFIDENCE, dof)) if dof > 0 else np.inf)


def edge_limit(problem: Problem) -> float:
    """Whitened norm that a true edge exceeds once in a thousand."""
    return float(np.sqrt(chi2.ppf(CONFIDENCE, problem.dof)))
