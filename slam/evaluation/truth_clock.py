"""Whether the truth's stamps are late or early: the shift at which the path of the map fits it best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation.association import Association, complete_rows, covered_by, stamps_on_clock
from slam.evaluation.trajectory import position_error, umeyama

Array = NDArray[np.float64]

FARTHEST_S, STEP_S = 2.0, 0.05
"""Shifts that are tried. A vehicle that turns back and forth within twice the step would hide its shift."""
MOST_SHARE = 0.5
"""Share of the position error that is left with the shift, from which on no shift is told."""
FEWEST = 8
"""Keyframes below which no shift is looked for: similarity and shift together have eight unknowns."""


@dataclass(frozen=True)
class TruthClock:
    """A shift of the truth's stamps at which the errors are less than half as large."""

    late_s: float
    """How late the stamps are; negative where they are early."""
    ate_aligned_m: float
    """Root mean square position error with the shift taken out, after the least-squares rigid motion (in a
    map without metres the similarity)."""


def truth_clock(estimate: Estimate, flight: Flight, association: Association) -> TruthClock | None:
    """Return the shift of the truth's stamps that at least halves the position errors; None without one.

    A straight flight at a constant speed shows none: a translation has the same effect.
    """
    if flight.truth is None or association.w_T_b is None or len(association.keyframe) < FEWEST:
        return None
    rows = complete_rows(flight.truth)
    rows_s, true_m = rows.stamps_s, rows.w_T_b[:, :3, 3]
    at_s = stamps_on_clock(estimate, flight)[association.keyframe]
    place_m = estimate.w_T_b[association.keyframe, :3, 3]

    rounding_m = np.sqrt(np.finfo(float).eps) * float(np.ptp(true_m, axis=0).max())

    def covered(late_s: float) -> NDArray[np.bool_]:
        return np.asarray(np.logical_and(*covered_by(rows_s, at_s + late_s)))

    def error_m(late_s: float, of: NDArray[np.bool_]) -> float:
        reference_m = np.column_stack([np.interp(at_s[of] + late_s, rows_s, axis) for axis in true_m.T])
        moved = umeyama(place_m[of], reference_m, with_scale=not estimate.metric)
        return position_error(moved.apply(place_m[of]), reference_m).rmse

    def share(late_s: float) -> float:
        """Return the error with a shift over that without, of the same keyframes."""
        of = covered(late_s)
        if of.sum() < max(FEWEST, len(at_s) / 2):
            return np.inf
        shifted_m, unshifted_m = error_m(late_s, of), error_m(0.0, of)
        return shifted_m / unshifted_m if unshifted_m > rounding_m else np.inf

    shifts_s = np.arange(-FARTHEST_S, FARTHEST_S + STEP_S / 2, STEP_S)
    best_s = shifts_s[int(np.nanargmin([share(shift) for shift in shifts_s]))]
    late_s = float(minimize_scalar(share, bounds=(best_s - STEP_S, best_s + STEP_S), method="bounded").x)
    beyond_a_row = abs(late_s) >= float(np.median(np.diff(rows_s)))
    if not (beyond_a_row and share(late_s) < MOST_SHARE):
        return None
    return TruthClock(late_s, error_m(late_s, covered(late_s)))
