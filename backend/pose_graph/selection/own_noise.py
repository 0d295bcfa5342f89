"""The noise of the edges themselves, where their stated covariances are far too large.

All gates measure in standard deviations. Where these are stated so large that a false loop agrees with the
others by chance, nothing tells it from a true one. How far the loops lie from what odometry predicts tells
their noise, whatever is stated: the selection then works with that noise.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from backend.pose_graph.chi_square import SIGNIFICANCE, chi_square_gate
from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, initial_poses
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.chains import chain_members
from backend.pose_graph.selection.growth import anchored_part, odometry_poses, part_samples
from backend.pose_graph.selection.prediction import (
    LoopInnovations,
    innovations,
    likely_scale,
    log_prior_volume,
    log_volume,
)

Array = NDArray[np.float64]


def own_noise(gauge_fixed: GaugeFixedProblem, w_T: Array) -> float:
    """Return the factor of the edges' noise over the stated one, where that may change which are kept.

    ``w_T`` (n, 4, 4) are poses of the size of the map. The factor is the most likely one by the loops within
    the chains of odometry. It is 1 where that is more, where no chain has a loop, and where the stated
    covariances tell a false loop from a true one.
    """
    if are_selective(gauge_fixed.problem, w_T):
        return 1.0
    found = list(_innovations(gauge_fixed))
    return likely_scale(_joined(found)) if found else 1.0


def are_selective(problem: Problem, w_T: Array) -> bool:
    """Return whether a false loop anywhere in the map hardly passes the gate of most of the loops.

    The gate is at least as wide as the loop's own covariance makes it.
    """
    volume = log_prior_volume(problem, w_T)[~problem.trusted]
    chance = log_volume(np.eye(problem.dof), chi_square_gate(problem.dof)) - volume
    return len(chance) == 0 or float(np.median(chance)) <= np.log(SIGNIFICANCE)


def _innovations(gauge_fixed: GaugeFixedProblem) -> Iterator[LoopInnovations]:
    """Yield the innovations of the loops within each chain."""
    start = initial_poses(gauge_fixed.problem)
    for number, members in enumerate(chain_members(gauge_fixed.problem)):
        part = anchored_part(gauge_fixed, members, start[members[0]])
        own = part.problem
        loops = np.flatnonzero(~own.trusted)
        if len(loops) == 0:
            continue
        try:
            w_T = odometry_poses(part)
            samples = part_samples(part, own.trusted, w_T, number)
        except BackendError:
            continue
        yield innovations(own, w_T, samples, loops)


def _joined(parts: list[LoopInnovations]) -> LoopInnovations:
    """Return the innovations of all chains; the numbers of their edges are those within each chain."""
    return LoopInnovations(
        np.concatenate([each.edges for each in parts]),
        np.concatenate([each.residual for each in parts]),
        np.concatenate([each.spread for each in parts]),
        np.concatenate([each.log_prior_volume for each in parts]),
    )
