"""The change of a path by loop closures: what all of it shares, and the drift that is left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LEAST_POINTS = 3
"""Keyframes without which a common change explains everything."""


@dataclass(frozen=True)
class LoopChange:
    """The common change from the path without loop closures to the one with them, and what it leaves."""

    scale: float
    """Lengths without loop closures over those with them."""
    turn_rad: float
    """Heading without them less that with them, counterclockwise."""
    shift_m: float
    """Distance between the middles of both paths."""
    typical_m: float
    largest_m: float
    """Distances that are left after the common change."""
    share: float
    """Share of the squared distances that the common change explains."""


def loop_change(before_m: Array, after_m: Array) -> LoopChange | None:
    """Return what turned and scaled the path (n, 3) as a whole, and what bent it; None where that is not
    known.

    Turn, scale and shift along the ground are those of least squares. Heights share the scale, and their
    shift is that of their mean. ``before_m`` lies beside ``after_m`` as a report shows it.
    """
    known = np.isfinite(before_m + after_m).all(axis=1)
    if known.sum() < _LEAST_POINTS:
        return None
    shift_m = float(np.linalg.norm((before_m - after_m)[known].mean(axis=0)))
    before, after = (each[known] - each[known].mean(axis=0) for each in (before_m, after_m))
    flat_before, flat_after = (each[:, 0] + 1j * each[:, 1] for each in (before, after))
    size = float(np.sum(np.abs(flat_after) ** 2))
    if size <= 0:
        return None
    ratio = complex(np.sum(flat_before * flat_after.conj()) / size)
    if ratio == 0:
        return None
    left = np.column_stack(
        [(v := flat_before / ratio - flat_after).real, v.imag, before[:, 2] / abs(ratio) - after[:, 2]]
    )
    left_m = np.linalg.norm(left, axis=1)
    moved = float(np.sum((before_m - after_m)[known] ** 2))
    share = max(0.0, 1.0 - float(np.sum(left_m**2)) / moved) if moved > 0 else 0.0
    return LoopChange(
        abs(ratio), float(np.angle(ratio)), shift_m, float(np.median(left_m)), float(np.max(left_m)), share
    )
