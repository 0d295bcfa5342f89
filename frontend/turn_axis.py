"""The vertical in the axes of a camera, without any instrument: the axis about which the vehicle turns on.

A vehicle keeps its tilt within some degrees, but may turn about the vertical without bound. Over some seconds
the only axis about which the pictures of its camera turn far is therefore the vertical. Neither a plane in
the picture nor the way of travel tells as much: a front that is flown along looks as a floor does.

Source: Hartley and Zisserman 2004, sections 9.6.2 and 13.3 (turns from an essential matrix, and from a
homography; Faugeras and Lustman 1988).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.ray_pairs import RayPair

Array = NDArray[np.float64]

_TILT_STD_RAD = 0.1
"""Standard deviation of a vehicle's tilt, as of `level_std_rad` of the settings."""
_AXES = 2000
"""Directions over half the sphere, some 3 degrees apart: less than the tilt of a vehicle."""
_PLANE_SHARE = 0.8
"""Share of the matches that a plane must explain, so that turns as over a plane are possible."""


def step_turns(rays: RayPair, threshold_rad: float) -> list[Array]:
    """Return the turns (3, 3) of the camera, from the first picture to the second, that explain matches.

    A general scene gives one turn; a plane gives two, of which only one is right.
    """
    i, j = rays.flat
    found = []
    essential, agree = rays.essential(threshold_rad)
    if essential is not None:
        found.append(np.asarray(cv2.recoverPose(essential, i[agree], j[agree], np.eye(3))[1]))
    plane, mask = cv2.findHomography(i, j, cv2.RANSAC, threshold_rad)
    if plane is not None and mask.mean() >= _PLANE_SHARE:
        found += [np.asarray(turn) for turn in cv2.decomposeHomographyMat(plane, np.eye(3))[1]]
    return found


def vertical_evidence(
    chains: Sequence[Sequence[Sequence[Array]]], most_tilt_rad: float
) -> tuple[Array, float]:
    """Compare verticals within ``most_tilt_rad`` of the optical axis with all others.

    ``chains``: stretches of successive steps, each with its possible turns (`step_turns`). Return (b,) twice
    the difference of the log-likelihoods of each stretch, and the angle of the best vertical to the axis.
    """
    axes = _half_sphere(_AXES)
    cost = np.array([_tilted(chain, axes) ** 2 / (2.0 * _TILT_STD_RAD**2) for chain in chains])
    total, angle = cost.sum(axis=0), np.arccos(axes[:, 2])
    near = angle <= most_tilt_rad
    inside, outside = (np.flatnonzero(side)[total[side].argmin()] for side in (near, ~near))
    return cost[:, outside] - cost[:, inside], float(angle[total.argmin()])


def _tilted(chain: Sequence[Sequence[Array]], axes: Array) -> Array:
    """Return by how much each vertical (a, 3) tilts over a chain, in rad, with the turns that tilt least."""
    direction = axes
    for turns in chain:
        moved = np.array([direction @ turn.T for turn in turns])
        least = np.einsum("tai,ai->ta", moved, direction).argmax(axis=0)
        direction = moved[least, np.arange(len(axes))]
    return np.asarray(np.arccos(np.clip((direction * axes).sum(axis=1), -1.0, 1.0)))


def _half_sphere(count: int) -> Array:
    k = np.arange(count) + 0.5
    z, turn = 1.0 - k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - z**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
