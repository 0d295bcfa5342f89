"""A set of edges that a selection keeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.gauge_fixed_problem import GraphFit
from backend.pose_graph.problem import Problem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Selection:
    """A set of consistent edges and its fit."""

    kept: Mask
    """(m,)."""
    fit: GraphFit
    innovation_sigma: Array
    """(m,) innovations of the rejected edges, and residuals of the kept ones, in standard deviations."""
    is_complete: bool = True
    """False if the growth of the consistent set was cut off."""
    disputed_odometry: tuple[str, ...] = ()
    """Sentences about rejected loops that agree with each other, against odometry or with it."""

    @staticmethod
    def of(problem: Problem, kept: Mask, fit: GraphFit) -> Selection:
        """Return a set of edges (m,) with its fit, whose innovations are its residuals."""
        return Selection(kept, fit, np.linalg.norm(problem.residuals(fit.w_T), axis=1))
