"""How far the map itself leaves the straight line between two moments, as rows of a truth far apart do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from slam.core.estimate import Estimate
from slam.evaluation.trajectory import umeyama

Array = NDArray[np.float64]

_FEWEST_BETWEEN = 2.0
"""Keyframes between two rows from which on the map tells how the vehicle moves there; before, the rows do."""
_NOISE_SIGMA = 5.0
"""Stated deviations up to which the distance from a line may be noise of the map: that of the middle of three
poses, in three axes, exceeds sqrt(1.5 * 16.3) of them once in a thousand."""


def stated_deviations(estimate: Estimate, keyframe: NDArray[np.int64]) -> Array:
    """Return (m, 2) the largest stated deviations of turn and position of keyframes; infinite if unknown."""
    covariances = estimate.covariances[keyframe]
    variances = np.diagonal(covariances, axis1=1, axis2=2).reshape(-1, 2, 3).max(axis=2)
    return np.asarray(np.sqrt(np.where(variances > 0, variances, np.inf)))


def off_the_chord(
    estimate: Estimate,
    keyframe: NDArray[np.int64],
    at_s: Array,
    true_w_T_b: Array,
    begin_s: Array,
    end_s: Array,
) -> Array:
    """Return (m, 2) how far keyframes of a map are from those on a line between two moments, in rad and m.

    ``at_s`` (m,) are the times of the keyframes in order, ``begin_s`` and ``end_s`` (m,) those of the rows
    of the truth about them, and ``true_w_T_b`` (m, 4, 4) the poses interpolated between these rows, for the
    scale of a map without metres. It is 0 where fewer than two keyframes fit between the rows, and where the
    noise of the map may be all of it.
    """
    off, w_T_b = np.zeros((len(at_s), 2)), estimate.w_T_b[keyframe]
    known_s, first_at = np.unique(at_s, return_index=True)
    if len(known_s) < 3:
        return off
    wide = end_s - begin_s >= _FEWEST_BETWEEN * float(np.median(np.diff(known_s)))
    if not wide.any():
        return off
    times_s = np.clip(np.stack([begin_s, end_s])[:, wide], known_s[0], known_s[-1])
    position, rotations = w_T_b[:, :3, 3], Rotation.from_matrix(w_T_b[:, :3, :3])
    turns = Slerp(known_s, rotations[first_at])
    span_s = times_s[1] - times_s[0]
    share = np.divide(at_s[wide] - times_s[0], span_s, out=np.zeros_like(span_s), where=span_s > 0)[:, None]
    ends = [np.column_stack([np.interp(t, known_s, axis) for axis in position[first_at].T]) for t in times_s]
    chord = ends[0] + share * (ends[1] - ends[0])
    first, last = turns(times_s[0]), turns(times_s[1])
    on_chord = first * Rotation.from_rotvec(share * (first.inv() * last).as_rotvec())
    off[wide, 0] = (on_chord.inv() * rotations[wide]).magnitude()
    off[wide, 1] = np.linalg.norm(chord - position[wide], axis=1)
    off[off <= _NOISE_SIGMA * stated_deviations(estimate, keyframe)] = 0.0
    unit_m = 1.0 if estimate.metric else umeyama(position, true_w_T_b[:, :3, 3], with_scale=True).scale
    return off * [1.0, unit_m]
