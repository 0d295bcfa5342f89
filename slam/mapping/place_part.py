"""The start of a part of the map in the world: on GPS positions, on control points, or over its origin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.measurements import Position
from frontend.camera import Camera
from slam.mapping.control_points import ControlComparison
from slam.mapping.gps.consensus import rough_agreement
from slam.mapping.gps.georeferencing import align_with_places, align_with_positions
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.level_motion import moved_level
from slam.mapping.map import Map
from slam.mapping.setup import Setup

Array = NDArray[np.float64]


def aligned_part(
    setup: Setup, members: NDArray[np.int64], w_T_b: Array, metric: bool, control: ControlComparison
) -> tuple[Array, float] | None:
    """Return level poses (m, 4, 4) on the positions, and the floor's height; None if they do not place them.

    Control points may refer to another datum, into which the poses are shifted by medians, as one of the
    points may be wrong. Fixes of few pictures tell lengths poorly: where the points alone leave smaller
    differences, the poses stand on them.
    """
    by_fixes = align_with_positions(w_T_b, _renumbered(setup, members), metric)
    by_control = aligned_with_control(setup.camera, w_T_b, metric, control)
    if by_fixes is None:
        return None
    placed, floor_z_m = by_fixes
    off = control.off_floor(setup.camera, placed, floor_z_m)
    if not len(off):
        return by_fixes
    shift = np.median(off, axis=0)
    placed[:, :3, 3] += shift
    if by_control is not None:
        left = np.median(np.linalg.norm((off - shift)[:, :2], axis=1))
        if np.median(np.linalg.norm(control.off_floor(setup.camera, *by_control)[:, :2], axis=1)) < left:
            return by_control
    return placed, floor_z_m + float(shift[2])


def aligned_with_control(
    camera: Camera, w_T_b: Array, metric: bool, control: ControlComparison
) -> tuple[Array, float] | None:
    """Return level poses (m, 4, 4) on the control points, and the floor's height; None if too few."""
    here, there = control.on_floor(camera, w_T_b, 0.0)
    if not len(here):
        return None
    used = rough_agreement(here, there, metric).used
    return align_with_places(w_T_b, here[used], there[used], metric)


def _renumbered(setup: Setup, members: NDArray[np.int64]) -> list[Position]:
    number = {int(k): m for m, k in enumerate(members)}
    return [replace(p, k=number[p.k]) for p in setup.readings.positions if p.k in number]


def comparable(w_T_b: Array, readings: KeyframeReadings, map_: Map) -> Array:
    """Return the poses (n, 4, 4) of a lesser method where the result stands, to compare the two.

    They are NaN on a map on Earth if the positions do not place them.
    """
    if map_.georeferenced:
        aligned = align_with_positions(w_T_b, readings.positions, metric=False)
        return (
            np.full_like(w_T_b, np.nan)
            if aligned is None
            else aligned[0] + _lift(map_.floor_z_m - aligned[1])
        )
    placed = np.flatnonzero(np.isfinite(w_T_b).all(axis=(1, 2)))
    comparable = w_T_b.copy()
    if len(placed):
        comparable[placed] = headed(w_T_b[placed], readings, placed)
    return comparable


def _lift(z_m: float) -> Array:
    shift = np.zeros((4, 4))
    shift[2, 3] = z_m
    return shift


def headed(w_T_b: Array, readings: KeyframeReadings, members: NDArray[np.int64]) -> Array:
    """Return level poses (m, 4, 4) with the first one above the origin and at the heading of its attitude.

    Without a measured attitude the heading is 0.
    """
    yaw = next((a.roll_pitch_yaw_rad[2] for a in readings.attitudes if a.k == members[0]), 0.0)
    return moved_level(w_T_b, yaw, np.zeros(2))
