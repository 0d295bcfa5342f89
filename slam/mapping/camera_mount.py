"""A camera mounted askew on the body: when its mounting is estimated, and what was found.

A wrong mounting and a wrong zero of the attitude look alike. But the accelerometer does not share the
attitude's zero: where both are tilted against the floor by the same angle, it is the camera.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from backend.bundle.refinement import Bundle
from backend.measurements import GRAVITY_M_S2
from frontend.camera import Camera
from slam.core.estimate import MountTilt
from slam.mapping.attitude_floor_tilt import CLEARLY, SURE, AttitudeFloorTilt
from slam.mapping.inertial_scale import AccelerometerScale

_FREE_RAD = 0.1
"""Uncertainty of a mount that was told wrong."""


def estimated_mount(
    camera: Camera, lean: AttitudeFloorTilt | None, by_inertia: AccelerometerScale | None
) -> Camera | None:
    """The camera with its mount turned by the lean and free, where attitude and accelerometer agree that it
    is the mount that leans; else None."""
    if lean is None or by_inertia is None or not lean.turns_with_body:
        return None
    size = float(np.linalg.norm(lean.in_body))
    if size < max(SURE * lean.body_std, CLEARLY * lean.wander):
        return None
    # Read in axes that lean, gravity looks like an offset.
    leaning = GRAVITY_M_S2 * lean.in_body
    found = np.array(by_inertia.found.offset_m_s2[:2])
    std = float(np.max(by_inertia.found.offset_std_m_s2[:2]))
    if np.linalg.norm(found - leaning) > np.linalg.norm(leaning) / 2 or std > np.linalg.norm(leaning) / SURE:
        return None
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([-lean.in_body[1], lean.in_body[0], 0.0]).as_matrix()
    mount = turn @ camera.b_T_c
    mount[:3, 3] = camera.b_T_c[:3, 3]
    return replace(camera, b_T_c=mount, mount_std_rad=max(camera.mount_std_rad, _FREE_RAD))


def mount_tilt(told: Camera | None, bundle: Bundle | None) -> MountTilt | None:
    """How the refinement found the mount against what was told of it; None where it was held."""
    if told is None or bundle is None or bundle.mount_std_rad == 0.0:
        return None
    turn = Rotation.from_matrix(bundle.b_T_c[:3, :3] @ told.b_T_c[:3, :3].T).as_rotvec()
    rows = tuple(tuple(float(x) for x in row) for row in bundle.b_T_c)
    return MountTilt((float(turn[0]), float(turn[1])), bundle.mount_std_rad, rows)


def mount_warning(tilt: MountTilt | None) -> str:
    """In words, where the mount was found to lean; else empty."""
    if tilt is None:
        return ""
    size = float(np.linalg.norm(tilt.tilt_rad))
    if size < SURE * tilt.std_rad:
        return ""
    rows = ", ".join(f"{x:.5g}" for row in tilt.b_T_c for x in row)
    return (
        f"cam0 is mounted {np.degrees(size):.1f} ± {np.degrees(tilt.std_rad):.1g}° askew of its T_BS, as "
        f"floor and instruments show: corrected in the map; for other programs write T_BS data: [{rows}] "
        "into cam0/sensor.yaml"
    )
