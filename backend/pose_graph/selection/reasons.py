"""Why edges were rejected, in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.measurements import LinkCheck, Misfit, Rejection
from backend.pose_graph.chi_square import chi_square_gate
from backend.pose_graph.problem import Problem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def reasons(
    problem: Problem, kept: Mask, w_T: Array, sigma: Array, noise: float
) -> tuple[Rejection | None, ...]:
    """Return why each rejected edge was: ``disagrees by 7.3 sigma (limit 4.1): 1.2 m, 14 deg``.

    The result is (m,), None for the ``kept`` edges; ``sigma`` (m,) holds the innovations, in
    deviations of ``noise`` times the stated ones. Where these are others, the reason says so.
    """
    whose = "" if noise == 1 else f"each {noise:.2g} of a stated one, as the loops show"
    rejected, limit = np.flatnonzero(~kept), float(np.sqrt(chi_square_gate(problem.dof)))
    i, j = problem.i[rejected], problem.j[rejected]
    off = se3.log(se3.inverse(problem.ij_T[rejected]) @ se3.inverse(w_T[i]) @ w_T[j])
    lengths, degrees = np.linalg.norm(off[:, 3:], axis=1), np.degrees(np.linalg.norm(off[:, :3], axis=1))
    found = list[Rejection | None]([None] * len(kept))
    for e, length, angle in zip(rejected.tolist(), lengths.tolist(), degrees.tolist(), strict=True):
        if sigma[e] <= limit:
            found[e] = Rejection(LinkCheck.KNOWN_PLACE, f"{sigma[e]:.1f} sigma{f' ({whose})' * bool(whose)}")
        else:
            found[e] = Rejection(
                LinkCheck.GRAPH,
                f"{sigma[e]:.1f} sigma ({f'{whose}; ' * bool(whose)}limit {limit:.1f}): "
                f"{Misfit(length, problem.length_unit, angle)}",
            )
    return tuple(found)
