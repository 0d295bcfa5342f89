"""Georeferencing: a map in its own units turned, shifted and scaled onto measured positions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.measurements import Position

Array = NDArray[np.float64]


def align_with_positions(
    w_T_b: Array, positions: Sequence[Position], metric: bool
) -> tuple[Array, float] | None:
    """Turn, shift and (unless ``metric``) scale level poses (n, 4, 4), the floor at z = 0, onto positions.

    Returns what `align_with_places` does.
    """
    known = [p for p in positions if np.isfinite(w_T_b[p.k]).all()]
    high = any(np.isfinite(p.std_m[2]) for p in known)
    # Without any altitude the cameras stay at that of the origin.
    there = [
        p.w_p_antenna_m if np.isfinite(p.std_m[2]) or not high else [*p.w_p_antenna_m[:2], np.nan]
        for p in known
    ]
    here = np.array([w_T_b[p.k, :3, 3] for p in known]).reshape(-1, 3)
    return align_with_places(w_T_b, here, np.array(there).reshape(-1, 3), metric)


def align_with_places(w_T_b: Array, here: Array, there: Array, metric: bool) -> tuple[Array, float] | None:
    """Turn, shift and (unless ``metric``) scale level poses (n, 4, 4), the floor at z = 0.

    ``here`` (k, 3) of the map then lies on ``there`` (k, 3), whose heights may be NaN, but for one. Robust
    similarity in the plane, the floor's height from the median; the map stays level. Returns the poses and
    the floor's height in the frame of ``there``, or None for fewer than two places, or for equal ones.
    Source: Horn 1987, for the plane.
    """
    if len(here) < 2:
        return None
    a, b = here[:, :2] @ [1, 1j], there[:, :2] @ [1, 1j]
    weight = np.ones(len(here))
    for _ in range(20):
        a0, b0 = np.average(a, weights=weight), np.average(b, weights=weight)
        spread = float(np.sum(weight * np.abs(a - a0) ** 2))
        turn = np.sum(weight * np.conj(a - a0) * (b - b0)) / spread if spread > 0 else 0.0
        if abs(turn) < 1e-9:
            return None
        if metric:
            turn /= abs(turn)
        off = np.abs(b - b0 - turn * (a - a0))
        weight = 1.0 / np.maximum(off, np.median(off) + 1e-9)
    scale, yaw = float(abs(turn)), float(np.angle(turn))
    R = Rotation.from_euler("z", yaw).as_matrix()
    placed = w_T_b.copy()
    placed[:, :3, :3] = R @ w_T_b[:, :3, :3]
    placed[:, :3, 3] = scale * w_T_b[:, :3, 3] @ R.T
    shift = b0 - turn * a0
    floor_z = float(np.nanmedian(there[:, 2] - scale * here[:, 2]))
    placed[:, :3, 3] += [shift.real, shift.imag, floor_z]
    return placed, floor_z
