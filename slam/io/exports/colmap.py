"""COLMAP's sparse model as text: ``cameras.txt``, ``images.txt`` and ``points3D.txt``.

An image has the rotation and translation from world to camera, as a quaternion with w first; COLMAP's camera
axes are OpenCV's. The centre of its first pixel is (0.5, 0.5), ours is (0, 0). Its distortion models are
OpenCV's with fewer or more coefficients. Source: COLMAP's documentation, "Output Format" and "Camera Models".
"""

from __future__ import annotations

from pathlib import Path

from scipy.spatial.transform import Rotation

from backend.se3 import inverse
from frontend.camera import Camera
from slam.io.exports.exported_map import ExportedMap

_PIXEL_CENTER = 0.5
_CAMERA_ID = 1


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write the model into a folder; it has no points, since a map keeps none."""
    camera = exported.estimate.camera
    assert camera is not None
    frames, notes = exported.keyframes.with_plain_names("COLMAP")
    c_T_w = inverse(frames.of_sensor(camera.b_T_c).w_T_b)
    quaternions = Rotation.from_matrix(c_T_w[:, :3, :3]).as_quat(canonical=True, scalar_first=True)
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"]
    for number, (name, q, t) in enumerate(zip(frames.names, quaternions, c_T_w[:, :3, 3], strict=True), 1):
        pose = " ".join(f"{value:.12g}" for value in (*q, *t))
        images += [f"{number} {pose} {_CAMERA_ID} {name}", ""]  # the second line has the points, here none
    texts = {
        "cameras.txt": ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", _camera_line(camera)],
        "images.txt": images,
        "points3D.txt": ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"],
    }
    for name, lines in texts.items():
        (target / name).write_text("\n".join([*lines, ""]), encoding="utf-8")
    return notes


def _camera_line(camera: Camera) -> str:
    model, params = camera_model(camera)
    return " ".join(
        [str(_CAMERA_ID), model, *map(str, camera.size_px), *(f"{value:.12g}" for value in params)]
    )


def camera_model(camera: Camera) -> tuple[str, tuple[float, ...]]:
    """Return COLMAP's name and parameters of the smallest model that describes a camera exactly."""
    fx, fy = camera.focal_px
    center = tuple(value + _PIXEL_CENTER for value in camera.center_px)
    if camera.lens == "equidistant":
        return "OPENCV_FISHEYE", (fx, fy, *center, *camera.distortion)
    k1, k2, p1, p2, k3 = camera.all_distortion
    if k3:
        return "FULL_OPENCV", (fx, fy, *center, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0)
    if p1 or p2 or (fx != fy and (k1 or k2)):
        return "OPENCV", (fx, fy, *center, k1, k2, p1, p2)
    if fx != fy:
        return "PINHOLE", (fx, fy, *center)
    if k2:
        return "RADIAL", (fx, *center, k1, k2)
    if k1:
        return "SIMPLE_RADIAL", (fx, *center, k1)
    return "SIMPLE_PINHOLE", (fx, *center)
