"""How uncertain the mount of a camera is that is fixed at its nominal value.

Pictures show how the camera leans against the floor, and not how the body does: a wrong mount turns all
poses about the camera, and no residual shows it. What shows it are instruments that measure which way is up.
Each has a zero of its own, so that the lean between such an instrument and the floor is the sum of the
mount's error and the instrument's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2
from slam.mapping.calibration.attitude_floor_tilt import SURE, AttitudeFloorTilt
from slam.mapping.calibration.inertial_scale import AccelerometerScale

Array = NDArray[np.float64]


def fixed_mount_covariance(
    tilt: AttitudeFloorTilt | None, by_inertia: AccelerometerScale | None, stated_exact: bool = False
) -> Array:
    """Return the covariance (2, 2) of the error of a fixed mount, a rotation about the body's x and y in rad.

    Mount and zero of the instrument are two normal errors of mean zero and of one unknown size. Their sum is
    the measured lean, whose square, less that of its noise, determines the size. The second moment of the
    mount's share is the covariance. Accelerometer and attitude have different zeros but one camera: the mount
    is off by no more than either of them allows, by its lean and its noise. The covariance is zero where no
    instrument measures which way is up, and for a mount that is stated as exact, unless all instruments lean
    significantly.
    """
    seen = list[tuple[Array, float]]()
    if tilt is not None:
        seen.append((tilt.in_body, tilt.body_std))
    if by_inertia is not None:
        found = by_inertia.found
        # In leaning axes, gravity looks like a bias.
        std = float(np.max(found.level_floor_offset_std_m_s2[:2])) / GRAVITY_M_S2
        seen.append((np.array(found.level_floor_offset_m_s2[:2]) / GRAVITY_M_S2, std))
    # The noise is that of two components: twice the variance of one.
    shown = [(float(lean @ lean), 2 * std**2, lean) for lean, std in seen]
    leaning = [each for each in shown if each[0] > each[1]]
    if not leaning or (stated_exact and any(square < 0.5 * SURE**2 * noise for square, noise, _ in shown)):
        return np.zeros((2, 2))
    allowed = min(square + noise for square, noise, _ in shown)
    square = min(allowed, max(square - noise for square, noise, _ in leaning))
    forward, left = min(leaning, key=lambda each: each[1])[2]
    # The axis about which the body's up direction leans forward and left.
    axis = np.array([-left, forward]) / np.hypot(forward, left)
    # With the variance s² of either error along each axis, the square of their sum is 4 s² on average. The
    # share of one is half of the sum, and varies about it by s²/2 along each axis.
    return np.asarray(square * (np.outer(axis, axis) / 4 + np.eye(2) / 8))


def mount_displacements(b_T_c: Array, mount_covariance: Array) -> Array:
    """Return (6, 2) right perturbations of a body pose by the independent errors of its camera's mount.

    ``mount_covariance`` (2, 2) is that of the rotation of the mount ``b_T_c`` (4, 4) about the body's x and
    y. The camera stays where it is, and the body turns about it.
    """
    variance, about = np.linalg.eigh(mount_covariance)
    axes = np.eye(3)[:2]
    J = np.concatenate([axes.T, np.cross(b_T_c[:3, 3], axes).T])
    return np.asarray(J @ about * np.sqrt(np.maximum(variance, 0.0)))
