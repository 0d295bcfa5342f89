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
from slam.core.instrument_errors import MountTilt
from slam.core.messages import Message, note
from slam.mapping.calibration.attitude_floor_tilt import CLEARLY, SURE, AttitudeFloorTilt
from slam.mapping.calibration.inertial_scale import AccelerometerScale

_FREE_RAD = 0.1
"""Prior standard deviation of a mount whose nominal value is wrong."""


def estimated_mount(
    camera: Camera, tilt: AttitudeFloorTilt | None, by_inertia: AccelerometerScale | None
) -> Camera | None:
    """Return the camera with a corrected, free mount if attitude and accelerometer agree on its tilt."""
    if tilt is None or by_inertia is None or not tilt.turns_with_body:
        return None
    size = float(np.linalg.norm(tilt.in_body))
    if size < max(SURE * tilt.body_std, CLEARLY * tilt.wander):
        return None
    # In tilted axes, gravity looks like a bias.
    tilted_gravity = GRAVITY_M_S2 * tilt.in_body
    found = np.array(by_inertia.found.offset_m_s2[:2])
    std = float(np.max(by_inertia.found.offset_std_m_s2[:2]))
    if (
        np.linalg.norm(found - tilted_gravity) > np.linalg.norm(tilted_gravity) / 2
        or std > np.linalg.norm(tilted_gravity) / SURE
    ):
        return None
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([-tilt.in_body[1], tilt.in_body[0], 0.0]).as_matrix()
    mount = turn @ camera.b_T_c
    mount[:3, 3] = camera.b_T_c[:3, 3]
    return replace(camera, b_T_c=mount, mount_std_rad=max(camera.mount_std_rad or 0.0, _FREE_RAD))


def mount_tilt(nominal: Camera | None, bundle: Bundle | None) -> MountTilt | None:
    """Return the estimated mount relative to the nominal one; None if it was fixed."""
    if nominal is None or bundle is None or bundle.mount_std_rad == 0.0:
        return None
    turn = Rotation.from_matrix(bundle.b_T_c[:3, :3] @ nominal.b_T_c[:3, :3].T).as_rotvec()
    rows = tuple(tuple(float(x) for x in row) for row in bundle.b_T_c)
    return MountTilt((float(turn[0]), float(turn[1])), bundle.mount_std_rad, rows)


def mount_warning(tilt: MountTilt | None, camera_file: str) -> Message | None:
    """Return a warning if the mount is tilted; otherwise None.

    ``camera_file`` says where the mount is declared.
    """
    if tilt is None:
        return None
    size = float(np.linalg.norm(tilt.tilt_rad))
    if size < SURE * tilt.std_rad:
        return None
    rows = ", ".join(f"{x:.5g}" for row in tilt.b_T_c for x in row)
    return note(
        f"cam0 is mounted {np.degrees(size):.1f} ± {np.degrees(tilt.std_rad):.1g}° askew of its T_BS, as "
        f"floor and instruments show: corrected in the map",
        f"for other programs write T_BS data: [{rows}] into {camera_file}",
    )
