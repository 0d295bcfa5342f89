"""The three maps of one flight, each aligned with the reference's world frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.core.estimate import Estimate
from slam.evaluation.association import Association
from slam.evaluation.trajectory import gauge

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AlignedMap:
    """Keyframe poses of one map and the height of its floor."""

    w_T_b: Array
    """(m, 4, 4) poses of the associated keyframes; NaN where a keyframe is not placed."""
    floor_z_m: float


@dataclass(frozen=True)
class AlignedMaps:
    """The three maps. The first keyframe's position and yaw of each are those of the truth.

    With GPS as the reference nothing is aligned.
    """

    chain: AlignedMap
    """Composed homographies of neighbouring frames: the paper's map stitching."""
    odometry: AlignedMap
    """Poses optimized without loops."""
    loops: AlignedMap
    """Poses optimized with loops: the estimate."""


def aligned_maps(estimate: Estimate, association: Association) -> AlignedMaps:
    """Align each map by its own first associated keyframe."""
    return AlignedMaps(
        chain=_map(estimate.chain_w_T_b, estimate.floor_z_m, association),
        odometry=_map(estimate.odometry_w_T_b, estimate.floor_z_m, association),
        loops=_map(estimate.w_T_b, estimate.floor_z_m, association),
    )


def chain_on_result(estimate: Estimate) -> Array:
    """Return the plain chain (n, 4, 4) with its first keyframe's position and heading on the result's."""
    return _on_result(estimate, estimate.chain_w_T_b)


def odometry_on_result(estimate: Estimate) -> Array:
    """Return the poses without loops (n, 4, 4) beside the result: on Earth as they are, and elsewhere with
    the first keyframe's position and heading on the result's."""
    on_earth = estimate.origin is not None
    return estimate.odometry_w_T_b if on_earth else _on_result(estimate, estimate.odometry_w_T_b)


def _on_result(estimate: Estimate, w_T_b: Array) -> Array:
    known = np.flatnonzero(np.isfinite(w_T_b.sum(axis=(1, 2))) & estimate.placed)
    if len(known) == 0:
        return np.full_like(w_T_b, np.nan)
    first = known[0]
    return np.asarray(gauge(w_T_b[first], estimate.w_T_b[first]) @ w_T_b)


def _map(w_T_b: Array, floor_z_m: float, association: Association) -> AlignedMap:
    poses = w_T_b[association.keyframe]
    placed = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    if association.w_T_b is None or len(placed) == 0:
        return AlignedMap(poses, floor_z_m)
    G = gauge(poses[placed[0]], association.w_T_b[placed[0]])
    # A rotation about z and a translation keep the floor level.
    return AlignedMap(G @ poses, floor_z_m + float(G[2, 3]))
