"""A second motion in a registered pair of pictures, however small its share is.

Tracking searches for one only where much does not follow the floor. If the thing that moves fills most of the
pictures, the little that does not follow it is the floor.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from frontend.camera import Camera
from frontend.cells import cells, occupied
from frontend.features import Features
from frontend.homography import HomographyConfig, fit_homography, transfer
from frontend.matching import match
from frontend.motions import OtherMotion
from frontend.registration import Registration

_LEAST_CELLS = 3
"""Fewest cells that nothing of the first motion is in: two rows of a thing may be one edge of the picture."""
_ITERATIONS = 300


def second_motion(
    a: Features, b: Features, link: Registration, camera: Camera, config: HomographyConfig, least: int
) -> OtherMotion | None:
    """Return the motion of at least ``least`` features that do not follow a ``link``; None without one."""
    size_px, cell = camera.size_px, cells(b.pixel, camera.size_px)
    filled = occupied(cell[link.matches[:, 1]])
    at = transfer(link.i_H_j, b.pixel)
    free = ~filled[cell] & ((at >= 0) & (at < size_px)).all(axis=1)
    if occupied(cell[free]).sum() < _LEAST_CELLS:
        return None
    others = a[np.setdiff1d(np.arange(len(a)), link.matches[:, 0])], b[free]
    pairs = match(*others)
    if len(pairs) < least:
        return None
    points_i, points_j = (each.points[pairs[:, side]] for side, each in enumerate(others))
    corners_px = camera.undistort(camera.corners_px)
    quick = replace(config, max_iterations=min(config.max_iterations, _ITERATIONS))
    fit = fit_homography(points_i, points_j, corners_px, quick)
    if fit is None or fit.inlier.sum() < least:
        return None
    return OtherMotion.of(fit.i_H_j, points_j.pixel[fit.inlier], link.i_H_j, filled, size_px)
