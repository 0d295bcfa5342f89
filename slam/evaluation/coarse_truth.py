"""Keyframes between rows of a truth that are too far apart for the motion: no error tells anything there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.core.errors import InputError
from slam.core.estimate import Estimate
from slam.core.units import length
from slam.evaluation.association import Association
from slam.evaluation.chord import stated_deviations
from slam.evaluation.trajectory import umeyama

Array = NDArray[np.float64]

_MOST_SHARE, _LEFT_SHARE = 0.5, 0.1
"""Share of the error that interpolation may be of all keyframes together, and of one where it is more."""
BETWEEN_ROWS = "between rows of the truth that are too far apart for how the vehicle moves"


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


def _error_m(estimate: Estimate, association: Association) -> float:
    """Return the root mean square distance after the similarity that fits best, which no gauge changes."""
    moving_m = estimate.w_T_b[association.keyframe, :3, 3]
    moved_m = umeyama(moving_m, association.position_m, with_scale=not estimate.metric).apply(moving_m)
    return _root_mean_square(np.linalg.norm(moved_m - association.position_m, axis=1))


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


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
