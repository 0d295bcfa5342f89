"""Whether a step of odometry may be wrong, by how well the loops over it agree with each other without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem
from backend.pose_graph.selection.chains import Chain, Joining, chain_members
from backend.pose_graph.selection.growth import anchored_part, coarse_solver, part_samples
from backend.pose_graph.selection.prediction import noise_scale

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def may_be_wrong(gauge_fixed: GaugeFixedProblem, step: Mask, kept: Mask, w_T: Array) -> bool:
    """Return False if rejected loops over a step of odometry support each other no more than kept ones do.

    ``step`` (m,) are the trusted edges over the step, ``kept`` (m,) the selected edges, and ``w_T``
    (n, 4, 4) their solution. Without the step and the loops over it, the poses fall into two parts. True
    loops agree about where the parts lie, whatever the step is; false ones hardly do. With more parts than
    two the answer is True: the loops of another chain of odometry may say more about the step.
    """
    problem = gauge_fixed.problem
    parts = chain_members(replace(problem, trusted=problem.trusted & ~step))
    if len(parts) != 2:
        return True
    frames = [_solved_part(gauge_fixed, part, kept, w_T, number) for number, part in enumerate(parts)]
    joining = Joining(problem, frames, noise_scale(problem, kept, w_T))
    over = (joining.label[problem.i] != joining.label[problem.j]) & ~problem.trusted

    def support(loops: Mask) -> float:
        found = np.flatnonzero(loops)
        return joining.most_supported(found, gauge_fixed.options.out_of_time)[1] if len(found) else 0.0

    return support(over & ~kept) > support(over & kept)


def _solved_part(gauge_fixed: GaugeFixedProblem, part: Index, kept: Mask, w_T: Array, number: int) -> Chain:
    """Solve the kept edges within a ``part`` of the poses, with its first pose fixed."""
    own = anchored_part(gauge_fixed, part, w_T[part[0]])
    kept = kept[gauge_fixed.problem.edges_among(part)]
    at = coarse_solver(own)(kept, w_T[part])
    return Chain(part, at, part_samples(own, kept, at, number))
