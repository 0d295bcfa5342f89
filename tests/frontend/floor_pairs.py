"""Pairs of poses over a floor, and the homographies and matches that they imply by projection alone."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.camera import Camera

Array = NDArray[np.float64]

CAMERA = Camera((300.0, 305.0), (161.0, 117.5), (320, 240))
FISHY = replace(CAMERA, distortion=(-0.25, 0.06, 0.002, -0.003))
FISHEYE = replace(CAMERA, distortion=(0.05, -0.03, 0.02, -0.01), lens="equidistant")


def mounted(turn_rad: tuple[float, float, float], b_p_c_m: tuple[float, float, float]) -> Camera:
    """The camera turned by intrinsic x-y-z angles from looking straight down, away from the body's origin."""
    mount = CAMERA.b_T_c.copy()
    mount[:3, :3] = mount[:3, :3] @ Rotation.from_euler("XYZ", turn_rad).as_matrix()
    mount[:3, 3] = b_p_c_m
    return replace(CAMERA, b_T_c=mount)


def body(x: float, y: float, z: float, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Array:
    w_T_b = np.eye(4)
    w_T_b[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    w_T_b[:3, 3] = x, y, z
    return w_T_b


def pair(rng: np.random.Generator, height_m: float, ratio: float, tilt_rad: float) -> tuple[Array, Array]:
    """Two bodies, the second ``ratio`` times as high, any yaw, sharing much of their view."""
    i = body(*rng.normal(0, 5, 2), height_m, rng.uniform(-np.pi, np.pi), *rng.normal(0, tilt_rad, 2))
    j = body(0, 0, height_m * ratio, rng.uniform(-np.pi, np.pi), *rng.normal(0, tilt_rad, 2))
    j[:2, 3] = i[:2, 3] + rng.normal(0, 0.12 * height_m, 2)
    return i, j


def look(camera: Camera, w_T_b: Array, w_p: Array) -> Array:
    """Undistorted pixels (n, 2) of floor points (n, 2): point by point, without homographies."""
    w_T_c = w_T_b @ camera.b_T_c
    points = np.column_stack([w_p, np.zeros(len(w_p))])
    c_p = (points - w_T_c[:3, 3]) @ w_T_c[:3, :3]
    return c_p[:, :2] / c_p[:, 2:] * camera.focal_px + camera.center_px


def true_homography(camera: Camera, w_T_i: Array, w_T_j: Array) -> Array:
    """i_H_j from four floor points by the linear equations that they give."""
    corners = w_T_i[:2, 3] + w_T_i[2, 3] * 0.2 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    return homography_of(look(camera, w_T_j, corners), look(camera, w_T_i, corners))


def homography_of(source: Array, target: Array) -> Array:
    """The map of four points (4, 2) onto four others in double precision, which OpenCV's is not."""
    rows = []
    for (x, y), (u, v) in zip(source, target, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y])
    return np.append(np.linalg.solve(np.array(rows), target.ravel()), 1.0).reshape(3, 3)


def texture(rng: np.random.Generator, width: int, height: int, finest_px: float = 1.2) -> NDArray[np.uint8]:
    """Grey detail of all sizes."""
    blurs = (finest_px, 3.0, 8.0, 20.0)
    octaves = [cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), s) * s for s in blurs]
    total = sum(octaves)
    return np.clip(np.rint(125 + 50 * total / total.std()), 0, 255).astype(np.uint8)
