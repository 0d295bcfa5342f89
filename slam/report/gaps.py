"""Stretches of a path that no usable picture shows: the pictures on either side are not linked over them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from frontend.camera import Camera
from slam.core.estimate import Estimate
from slam.core.flight import Flight


@dataclass(frozen=True)
class Gap:
    """A stretch between two successive keyframes of one part of the map."""

    i: int
    j: int
    """The keyframes before and behind it."""
    length_m: float
    """Distance between them."""
    shows_nothing: bool
    """Whether it is longer than a picture, so that ground on it is missing."""
    ends_m: tuple[tuple[float, float], tuple[float, float]]
    """x and y of both keyframes."""
    width_m: float
    """Shorter side of a picture on the ground there; 0 where it is not known."""


def gaps(estimate: Estimate, flight: Flight | None) -> tuple[Gap, ...]:
    """Return the stretches; none of a pose graph and of photographs, which have no order."""
    if flight is None or flight.all_keyframes:
        return ()
    n, placed = len(estimate.stamps_s), np.flatnonzero(estimate.placed)
    # Over a hover, two successive keyframes are as far apart in time as two visits. The IMU shows no ground.
    spans = [
        (min(e.i, e.j), max(e.i, e.j))
        for e in estimate.relative_poses
        if e.kind == "odometry" or (e.kind == "loop" and abs(e.i - e.j) == 1)
    ]
    begin, end = np.array(spans, dtype=np.int64).reshape(-1, 2).T
    linked = np.cumsum(np.bincount(begin, minlength=n) - np.bincount(end, minlength=n)) > 0
    found = []
    for i, j in zip(placed[:-1].tolist(), placed[1:].tolist(), strict=True):
        if estimate.component[i] == estimate.component[j] and not linked[i:j].all():
            length_m = float(np.linalg.norm(estimate.w_T_b[j, :3, 3] - estimate.w_T_b[i, :3, 3]))
            width_m = _picture_m(estimate, i)
            (x0, y0), (x1, y1) = (estimate.w_T_b[k, :2, 3].tolist() for k in (i, j))
            found.append(Gap(i, j, length_m, length_m > width_m, ((x0, y0), (x1, y1)), width_m))
    return tuple(found)


def _picture_m(estimate: Estimate, k: int) -> float:
    """Return the shorter side of the ground in the picture of keyframe ``k``; 0 where it is not known."""
    camera = estimate.camera
    if camera is None:
        return 0.0
    height_m = float(estimate.over_floor_T_b[k, 2, 3]) - estimate.floor_z_m
    return height_m * picture_over_height(camera)


def picture_over_height(camera: Camera) -> float:
    """Return the shorter side of the ground in a picture over the height from which it was taken."""
    return min(size / focal for size, focal in zip(camera.size_px, camera.focal_px, strict=True))
