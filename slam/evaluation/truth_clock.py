"""Whether the truth's stamps are late or early: the shift at which the path of the map fits it best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation.association import Association, stamps_on_clock
from slam.evaluation.trajectory import position_error, umeyama

Array = NDArray[np.float64]

FARTHEST_S, STEP_S = 2.0, 0.05
"""Shifts that are tried. A vehicle that turns back and forth within twice the step would hide its shift."""
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
    truth = flight.truth
    if truth is None or association.w_T_b is None or len(association.keyframe) < FEWEST:
        return None
    known = np.isfinite(truth.w_T_b).all(axis=(1, 2)) & np.isfinite(truth.stamps_s)
    rows_s, true_m = truth.stamps_s[known], truth.w_T_b[known, :3, 3]
    at_s = stamps_on_clock(estimate, flight)[association.keyframe]
    place_m = estimate.w_T_b[association.keyframe, :3, 3]

    def error_m(late_s: float) -> float:
        shifted_s = at_s + late_s
        inside = (shifted_s >= rows_s[0]) & (shifted_s <= rows_s[-1])
        if inside.sum() < max(FEWEST, len(at_s) / 2):
            return float("inf")
        reference_m = np.column_stack([np.interp(shifted_s[inside], rows_s, axis) for axis in true_m.T])
        moved = umeyama(place_m[inside], reference_m, with_scale=not estimate.metric)
        rmse = position_error(moved.apply(place_m[inside]), reference_m).rmse
        return rmse if np.isfinite(rmse) else float("inf")

    shifts_s = np.arange(-FARTHEST_S, FARTHEST_S + STEP_S / 2, STEP_S)
    best_s = shifts_s[int(np.argmin([error_m(shift) for shift in shifts_s]))]
    late_s = float(minimize_scalar(error_m, bounds=(best_s - STEP_S, best_s + STEP_S), method="bounded").x)
    least_m = error_m(late_s)
    rounding_m = np.sqrt(np.finfo(float).eps) * float(np.ptp(true_m, axis=0).max())
    between_rows = abs(late_s) < float(np.median(np.diff(rows_s)))
    halved = least_m < error_m(0.0) / 2 and error_m(0.0) > rounding_m
    return TruthClock(late_s, least_m) if halved and not between_rows else None
