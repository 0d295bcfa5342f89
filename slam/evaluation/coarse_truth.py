"""Keyframes between rows of a truth that are too far apart for the motion: no error tells anything there.

Only the truth's own curvature leaves a keyframe out. Where the map alone leaves the line between two rows,
either may be wrong: an error of the map must not hide itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.errors import InputError
from slam.core.estimate import Estimate
from slam.core.units import length
from slam.evaluation.aligned_maps import aligned_maps
from slam.evaluation.association import Association
from slam.evaluation.chord import stated_deviations
from slam.evaluation.trajectory import ErrorSummary, position_error, umeyama

Array = NDArray[np.float64]

_MOST_SHARE, _LEFT_SHARE = 0.5, 0.1
"""Share of the error that interpolation may be of all keyframes together, and of one where it is more."""
BETWEEN_ROWS = "between rows of the truth that are too far apart for how the vehicle moves"


@dataclass(frozen=True)
class FewRows:
    """Errors that are those of the map between rows of the truth, or of the line between these rows."""

    keyframes: int
    """Number of keyframes that leave the line between the rows by more than the noise that the map states."""
    off_line_deg: float
    off_line_m: float
    """Largest turn and distance from that line."""
    at_rows: int
    """Number of keyframes within half a median interval between keyframes of a row."""
    ate_at_rows_m: ErrorSummary
    """Position errors of these, aligned rigidly, or with scale for a map without metres. NaN for too few."""


def judged_by_truth(estimate: Estimate, association: Association) -> Association:
    """Return the keyframes whose errors are those of the map.

    Where interpolation of the truth explains most of the error, the keyframes that it moves further than
    their stated deviations, and by more than a tenth of the error, are left out. Raises ``InputError`` where
    fewer than two are left.
    """
    first_m = 0.0
    while association.between_rows is not None and len(association.keyframe) > 2:
        missed_m, error_m = association.between_rows[:, 1], _error_m(estimate, association)
        if _root_mean_square(missed_m) <= _MOST_SHARE * error_m:
            break
        drop = too_coarse(estimate, association) & (missed_m > _LEFT_SHARE * error_m)
        if not drop.any():
            break
        first_m = first_m or float(missed_m.max())
        if np.count_nonzero(~drop) < 2:
            raise InputError(
                "the errors cannot be judged: the truth has too few rows for how the vehicle moves, which"
                f" leaves a straight line between two of them by {length(first_m)}; give more of its rows"
            )
        association = association.of(~drop, BETWEEN_ROWS)
    return association


def too_few_rows(estimate: Estimate, association: Association) -> FewRows | None:
    """Return what to doubt where the truth is too coarse to tell whether the map is wrong or the truth is.

    That is where the map's way between rows explains most of the error of position or turn, and the error
    near the rows is less than half of the whole. None where the errors are those of the map, and for GPS.
    """
    off, to_row_s = association.map_off_line, association.to_row_s
    if off is None or to_row_s is None or not off.any():
        return None
    step_s = float(np.median(np.diff(estimate.stamps_s[association.keyframe])))
    at_row = to_row_s <= 0.5 * step_s
    near = association.of(at_row, BETWEEN_ROWS)
    whole = _errors(estimate, association)
    explained = _root_mean_square(off) > _MOST_SHARE * whole
    if at_row.any():
        explained &= _errors(estimate, near) <= _MOST_SHARE * whole
    if not explained.any():
        return None
    largest = off.max(axis=0)
    fitted = 6 if estimate.metric else 7
    moved_m = _aligned_m(estimate, near) if len(near.keyframe) else near.position_m
    return FewRows(
        keyframes=int(np.count_nonzero(off.any(axis=1))),
        off_line_deg=float(np.degrees(largest[0])),
        off_line_m=float(largest[1]),
        at_rows=int(at_row.sum()),
        ate_at_rows_m=position_error(moved_m, near.position_m, fitted),
    )


def _errors(estimate: Estimate, association: Association) -> Array:
    """Return (2,) root mean squares of the errors of turn, in rad, and of position, in m."""
    assert association.w_T_b is not None
    turned = aligned_maps(estimate, association).loops.w_T_b[:, :3, :3].transpose(0, 2, 1)
    turns = np.atleast_1d(Rotation.from_matrix(turned @ association.w_T_b[:, :3, :3]).magnitude())
    return np.array([_root_mean_square(turns), _error_m(estimate, association)])


def _error_m(estimate: Estimate, association: Association) -> float:
    """Return the root mean square distance after the similarity that fits best, which no gauge changes."""
    off_m = _aligned_m(estimate, association) - association.position_m
    return float(_root_mean_square(np.linalg.norm(off_m, axis=1)))


def _aligned_m(estimate: Estimate, association: Association) -> Array:
    """Return positions (m, 3) of the map on those of the truth, as the similarity that fits best has them."""
    moving_m = estimate.w_T_b[association.keyframe, :3, 3]
    return umeyama(moving_m, association.position_m, with_scale=not estimate.metric).apply(moving_m)


def _root_mean_square(values: Array) -> Array:
    """Return that of (m,) values as a number, or of each column (m, k) as (k,)."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def too_coarse(estimate: Estimate, association: Association) -> NDArray[np.bool_]:
    """(m,) whether interpolation errors of the truth are as large as the estimate's own deviations.

    The error of such a keyframe would be mostly the truth's. The first keyframe, the gauge of all, is
    compared with the usual deviation.
    """
    coarse = np.zeros(len(association.keyframe), dtype=bool)
    if association.between_rows is None or len(coarse) < 2:
        return coarse
    deviations = stated_deviations(estimate, association.keyframe)
    deviations[0] = np.median(deviations[1:], axis=0)
    return np.asarray((association.between_rows > deviations).any(axis=1))
