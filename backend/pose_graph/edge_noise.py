"""The noise of edges over the stated one, from the fit of all of them."""

from __future__ import annotations

import numpy as np

from backend.measurements import Measurements
from backend.pose_graph.checks.solved_parts import solved_parts
from backend.pose_graph.connected_component import gauge_priors
from backend.pose_graph.from_measurements import from_measurements
from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, Options
from backend.pose_graph.selection.reweighted import reweighted_fit
from backend.pose_graph.solution import Solution
from backend.quantiles import chi_square_quantile


def typical_variance(measurements: Measurements, fit: Solution) -> float:
    """Return the factor of a typical edge's variance over the stated one; ``fit`` is that of all edges.

    A fit follows each edge, so that its residual is smaller than its error, and false loops strain it. Edges
    are therefore compared with what the others tell, and those far off count less.
    """
    problem, _ = from_measurements(measurements, None)
    parts = solved_parts(problem, fit, np.ones(len(problem.i), dtype=bool))
    squared = [
        reweighted_fit(GaugeFixedProblem(part, gauge_priors(part, w_T)[0], Options()), w_T).squared
        for part, w_T, _ in parts
        if len(part.i)
    ]
    return float(np.median(np.concatenate(squared))) / chi_square_quantile(0.5, problem.dof)
