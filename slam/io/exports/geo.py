"""OpenDroneMap's image geolocation file ``geo.txt``.

A line has the picture's name, longitude, latitude, altitude, yaw, pitch, roll in degrees, and horizontal and
vertical accuracy in metres. The angles are those of a vehicle in north-east-down axes whose camera looks
straight down, with the top of the picture forward; level to north they are all zero. Source: OpenDroneMap's
documentation, "Image Geolocation Files", and ``compute_opk`` in its ``opendm/photo.py``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frontend.camera import NADIR_B_T_C
from slam.core.geodesy import GeoOrigin, enu_R_enu
from slam.core.rotations import roll_pitch_yaw_of
from slam.io.body_axes import FRD_R_B, W_R_N
from slam.io.exports.exported_map import ExportedMap, Keyframes

Array = NDArray[np.float64]

_PROJECTION = "EPSG:4326"
_ONE_FOLDER = (
    "OpenDroneMap reads pictures from one folder: those of several flights have the flight's name before "
    "their own, as the copies of --to exif have"
)
"""Note about the names of pictures of several flights."""


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write the cameras' positions, angles and accuracies, as far as their uncertainty is known."""
    camera, origin = exported.estimate.camera, exported.estimate.origin
    assert camera is not None
    assert origin is not None
    named = exported.keyframes
    frames, notes = named.in_one_folder().with_plain_names("OpenDroneMap")
    if any("/" in name for name in named.names):
        notes = (*notes, _ONE_FOLDER)
    cameras = frames.of_sensor(camera.b_T_c)
    latitude, longitude, altitude = exported.geodetic(cameras)
    angles_deg = np.degrees(_yaw_pitch_roll(cameras, latitude, longitude, origin))
    east_m, north_m, up_m = cameras.position_stds_m.T
    accuracies_m = np.column_stack([np.sqrt((east_m**2 + north_m**2) / 2), up_m])
    lines = [_PROJECTION]
    for k, name in enumerate(cameras.names):
        words = [name, f"{longitude[k]:.10f}", f"{latitude[k]:.10f}"]
        if np.isfinite(altitude[k]):  # the place in the line tells what a number is
            words += [f"{altitude[k]:.4f}", *(f"{angle:.4f}" for angle in angles_deg[k])]
            if np.isfinite(accuracies_m[k]).all():
                words += [f"{std_m:.4f}" for std_m in accuracies_m[k]]
        lines.append(" ".join(words))
    target.write_text("\n".join([*lines, ""]), encoding="utf-8")
    if exported.estimate.altitude_known:
        return notes
    return (*notes, "geo.txt has neither angles nor accuracies, which may only follow an altitude")


def _yaw_pitch_roll(cameras: Keyframes, latitude: Array, longitude: Array, origin: GeoOrigin) -> Array:
    """Return angles (n, 3) in radians with respect to north at each camera; yaw lies in 0 to 2 pi."""
    places = zip(latitude.tolist(), longitude.tolist(), strict=True)
    local_R_w = np.array([enu_R_enu(GeoOrigin(*place, 0.0), origin) for place in places]).reshape(-1, 3, 3)
    local_R_b = local_R_w @ cameras.w_T_b[:, :3, :3] @ NADIR_B_T_C[:3, :3].T
    angles = roll_pitch_yaw_of(W_R_N.T @ local_R_b @ FRD_R_B)[:, ::-1]
    return np.column_stack([angles[:, 0] % (2 * np.pi), angles[:, 1:]])
