"""Absolute and relative trajectory errors.

Sturm, Engelhard, Endres, Burgard and Cremers, "A benchmark for the evaluation of RGB-D SLAM systems", 2012;
alignments: Umeyama, "Least-squares estimation of transformation parameters between two point patterns", 1991.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Pairs = NDArray[np.int64]

_DISTANCES_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
_STEP_S = 1.0


@dataclass(frozen=True)
class ErrorSummary:
    """Root mean square and largest of a set of errors; NaN where none is left to compare."""

    rmse: float
    max: float

    @staticmethod
    def of(errors: Array) -> ErrorSummary:
        """Summarise (n,) absolute errors."""
        if len(errors) == 0:
            return ErrorSummary(float("nan"), float("nan"))
        return ErrorSummary(float(np.sqrt(np.mean(errors**2))), float(errors.max()))


@dataclass(frozen=True)
class Similarity:
    """Similarity ``fixed = scale * R @ moving + t``."""

    scale: float
    R: Array
    t_m: Array

    def apply(self, points_m: Array) -> Array:
        """Apply the similarity: (n, 3) -> (n, 3)."""
        return self.scale * points_m @ self.R.T + self.t_m


@dataclass(frozen=True)
class RelativeError:
    """Errors of the motion over one step, independent of any alignment."""

    step: str
    """Step between the two poses of a pair: "1 keyframe", "1 s", "5 m"."""
    pairs: int
    translation_m: ErrorSummary
    translation_percent: float
    """Sum of translation errors in percent of the sum of true path lengths."""
    rotation_deg: ErrorSummary


def gauge(w_T_b_hat: Array, w_T_b_true: Array) -> Array:
    """Rotation about z and translation (4, 4) that align one estimated pose's position and yaw with the true
    ones.

    A camera over a floor with a known direction of gravity cannot observe these four degrees of freedom.
    """
    turn = _yaw(w_T_b_true) - _yaw(w_T_b_hat)
    G = np.eye(4)
    G[:3, :3] = Rotation.from_euler("z", turn).as_matrix()
    G[:3, 3] = w_T_b_true[:3, 3] - G[:3, :3] @ w_T_b_hat[:3, 3]
    return G


def _yaw(w_T_b: Array) -> float:
    return float(np.arctan2(w_T_b[1, 0], w_T_b[0, 0]))


def umeyama(moving_m: Array, fixed_m: Array, with_scale: bool) -> Similarity:
    """Fit the least-squares similarity (or rigid motion) that maps (n, 3) points to (n, 3) points.

    Source: Umeyama 1991, equations 34 to 43. The scale is NaN where all points of one set coincide.
    """
    mean_moving, mean_fixed = moving_m.mean(axis=0), fixed_m.mean(axis=0)
    centred = moving_m - mean_moving
    U, D, Vt = np.linalg.svd((fixed_m - mean_fixed).T @ centred / len(moving_m))
    S = np.ones(3)
    if np.linalg.det(U) * np.linalg.det(Vt) < 0:
        S[2] = -1.0
    R = (U * S) @ Vt
    scale = 1.0
    if with_scale:
        apart = np.ptp(moving_m, axis=0).any() and np.ptp(fixed_m, axis=0).any()
        scale = float(D @ S) / float(np.mean(np.sum(centred**2, axis=1))) if apart else float("nan")
    return Similarity(scale, R, mean_fixed - scale * R @ mean_moving)


def position_error(estimated_m: Array, true_m: Array, fitted: int = 0) -> ErrorSummary:
    """Compute the distances between (n, d) positions that were aligned by ``fitted`` unknowns.

    They are NaN where the alignment has as many unknowns as there are coordinates: it makes them fit anyhow.
    """
    if true_m.size <= fitted:
        return ErrorSummary(float("nan"), float("nan"))
    return ErrorSummary.of(np.linalg.norm(estimated_m - true_m, axis=1))


def relative_errors(
    stamps_s: Array, keyframe: NDArray[np.int64], w_T_b_hat: Array, w_T_b_true: Array
) -> tuple[RelativeError, ...]:
    """Compute errors over one keyframe, over 1 s, and over fixed lengths of the true path up to half of it.

    Source: Sturm et al. 2012, equation 2. ``stamps_s`` and ``keyframe`` are (n,), the poses (n, 4, 4).
    """
    path_m = path_length(w_T_b_true[:, :3, 3])
    steps = {
        "1 keyframe": _next_keyframe(keyframe),
        f"{_STEP_S:g} s": _after(stamps_s, _STEP_S, 1.5 * _STEP_S),
    }
    for distance_m in _DISTANCES_M:
        if distance_m <= 0.5 * path_m[-1]:
            steps[f"{distance_m:g} m"] = _after(path_m, distance_m, 1.5 * distance_m)
    return tuple(
        relative_error(step, pairs, path_m, w_T_b_hat, w_T_b_true)
        for step, pairs in steps.items()
        if len(pairs)
    )


def path_length(positions_m: Array) -> Array:
    """Return the length (n,) of the path from the first of (n, 3) positions to each."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions_m, axis=0), axis=1))])


def relative_error(
    step: str, pairs: Pairs, path_m: Array, w_T_b_hat: Array, w_T_b_true: Array
) -> RelativeError:
    """Compute the errors of the (m, 2) pairs of poses: ``(i_T_j true)^-1 (i_T_j estimated)``."""
    i, j = pairs.T
    true = np.linalg.inv(w_T_b_true[i]) @ w_T_b_true[j]
    estimated = np.linalg.inv(w_T_b_hat[i]) @ w_T_b_hat[j]
    error = np.linalg.inv(true) @ estimated
    translation_m = np.linalg.norm(error[:, :3, 3], axis=1)
    rotation_deg = np.rad2deg(Rotation.from_matrix(error[:, :3, :3]).magnitude())
    travelled_m = float(np.sum(path_m[j] - path_m[i]))
    percent = 100 * float(translation_m.sum()) / travelled_m if travelled_m > 0 else float("nan")
    return RelativeError(
        step, len(pairs), ErrorSummary.of(translation_m), percent, ErrorSummary.of(rotation_deg)
    )


def _next_keyframe(keyframe: NDArray[np.int64]) -> Pairs:
    i = np.flatnonzero(np.diff(keyframe) == 1)
    return np.column_stack([i, i + 1])


def _after(measure: Array, step: float, at_most: float) -> Pairs:
    """Pair each pose with the first one at least ``step`` later; much longer pairs are left out."""
    i = np.arange(len(measure))
    j = np.searchsorted(measure, measure + step * (1 - 1e-9))
    inside = j < len(measure)
    i, j = i[inside], j[inside]
    near = measure[j] - measure[i] <= at_most
    return np.column_stack([i[near], j[near]])
