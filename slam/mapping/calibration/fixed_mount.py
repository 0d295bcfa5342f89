"""How uncertain a camera's mount is that is fixed at its nominal value, and a floor that counts as level.

Pictures show how the camera leans against the floor, and not how the body does: a wrong mount turns all
poses about the camera, and no residual shows it. A floor that slopes turns all poses as well, and no
residual shows that. What shows both are instruments that measure which way is up. Each has a zero of its
own, so that the lean between such an instrument and the floor is the sum of the mount's error, or the slope,
and the instrument's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2
from slam.mapping.calibration.attitude_floor_tilt import SURE, AttitudeFloorTilt
from slam.mapping.calibration.inertial_scale import AccelerometerScale

Array = NDArray[np.float64]


def fixed_mount_covariance(
    tilt: AttitudeFloorTilt | None,
    by_inertia: AccelerometerScale | None,
    stated_exact: bool = False,
    causes: int = 2,
) -> Array:
    """Return the covariance (2, 2) of the error of a fixed mount, a rotation about the body's x and y in rad.

    Accelerometer and attitude have different zeros but one camera: the mount is off by no more than either of
    them allows, by its lean and its noise. The covariance is zero where no instrument measures which way is
    up, and for a mount that is stated as exact, unless all instruments lean significantly. ``causes``: how
    many errors may share the lean, 3 where the floor may slope too.
    """
    seen = [] if tilt is None else [(tilt.in_body, tilt.body_std)]
    if by_inertia is not None:
        seen.append(_lean_of(by_inertia))
    if stated_exact and any(lean @ lean < SURE**2 * std**2 for lean, std in seen):
        return np.zeros((2, 2))
    return _share(seen, causes)


def level_floor_covariance(
    tilt: AttitudeFloorTilt | None, by_inertia: AccelerometerScale | None, causes: int = 2
) -> Array:
    """Return the covariance (2, 2) of the slope of a floor that counts as level, a rotation about the map's x
    and y in rad.

    Slope and zero of an instrument make it lean as mount and zero do. A lean of the attitude that turns with
    the body is none of the floor. The accelerometer allows no larger slope than it shows without an offset,
    and than it shows beside one, which many headings tell from a slope. ``causes``: how many errors may share
    the lean, 3 where the mount is uncertain too.
    """
    seen = list[tuple[Array, float]]()
    if tilt is not None:
        if tilt.turns_with_body:
            return np.zeros((2, 2))
        seen.append((tilt.in_world, tilt.world_std))
    if by_inertia is not None:
        shown = by_inertia.found.slope_without_offset, by_inertia.found.slope
        seen += [(np.array(slope.rad), slope.std_rad) for slope in shown]
    return _share(seen, causes)


def _lean_of(by_inertia: AccelerometerScale) -> tuple[Array, float]:
    """Return how an accelerometer leans against the floor, forward and left, and its deviation.

    In leaning axes, gravity looks like a bias.
    """
    found = by_inertia.found
    lean = np.array(found.level_floor_offset_m_s2[:2]) / GRAVITY_M_S2
    return lean, float(np.max(found.level_floor_offset_std_m_s2[:2])) / GRAVITY_M_S2


def _share(seen: Sequence[tuple[Array, float]], causes: int) -> Array:
    """Return the covariance (2, 2) of a rotation that has its share of the leans (2,) of all instruments.

    It and the other ``causes``, such as the zero of an instrument, are normal errors of mean zero and of one
    unknown size. Their sum is the measured lean, whose square, less that of its noise, determines the size.
    The second moment of the rotation's share is the covariance. That of two shares together is as large as if
    they were independent.
    """
    # The noise is that of two components: twice the variance of one.
    shown = [(float(lean @ lean), 2 * std**2, lean) for lean, std in seen]
    leaning = [each for each in shown if each[0] > each[1]]
    if not leaning:
        return np.zeros((2, 2))
    allowed = min(square + noise for square, noise, _ in shown)
    square = min(allowed, max(square - noise for square, noise, _ in leaning))
    x, y = min(leaning, key=lambda each: each[1])[2]
    # The axis about which the up direction leans there.
    axis = np.array([-y, x]) / np.hypot(x, y)
    # With the variance s² of each of k errors along each axis, the square of their sum is 2 k s² on average.
    # The share of one is a k-th of the sum, and varies about it by s² (1 - 1/k) along each axis.
    return np.asarray(square * (np.outer(axis, axis) + np.eye(2) * (causes - 1) / 2) / causes**2)


def level_floor_displacements(w_T_b: Array, component: NDArray[np.int64], slope_covariance: Array) -> Array:
    """Return (n, 6, 2) right perturbations of poses (n, 4, 4) by the slope of a floor that counts as level.

    The poses of each ``component`` (n,) turn about the first of them, whose place is given. They keep their
    places over the floor.
    """
    found = np.zeros((len(w_T_b), 6, 2))
    variance, about = np.linalg.eigh(slope_covariance)
    axes = np.eye(3)[:2].T @ about * np.sqrt(np.maximum(variance, 0.0))
    placed = np.isfinite(w_T_b).all(axis=(1, 2))
    for part in np.unique(component[placed]):
        rows = np.flatnonzero(placed & (component == part))
        b_R_w = np.swapaxes(w_T_b[rows, :3, :3], 1, 2)
        away_m = w_T_b[rows, :3, 3] - w_T_b[rows[0], :3, 3]
        found[rows, :3] = b_R_w @ axes
        found[rows, 3:] = b_R_w @ np.cross(axes.T, away_m[:, None]).swapaxes(1, 2)
    return found


def mount_displacements(b_T_c: Array, mount_covariance: Array) -> Array:
    """Return (6, 2) right perturbations of a body pose by the independent errors of its camera's mount.

    ``mount_covariance`` (2, 2) is that of the rotation of the mount ``b_T_c`` (4, 4) about the body's x and
    y. The camera stays where it is, and the body turns about it.
    """
    variance, about = np.linalg.eigh(mount_covariance)
    axes = np.eye(3)[:2]
    J = np.concatenate([axes.T, np.cross(b_T_c[:3, 3], axes).T])
    return np.asarray(J @ about * np.sqrt(np.maximum(variance, 0.0)))
