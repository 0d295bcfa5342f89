"""An exact flight over a flat floor: its path, readings, registrations and views of floor points."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from frontend.registration import Registration
from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries, Sonar
from slam.mapping.config import PipelineConfig
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.setup import Setup

CAMERA = Camera((256.0, 250.0), (160.0, 118.0), (320, 240))
CONFIG = PipelineConfig()


def truth(seed: int = 0, n: int = 12) -> np.ndarray:
    """(n, 4, 4) there and back, first keyframe over the origin with heading 0, three seconds apart."""
    rng = np.random.default_rng(seed)
    k = np.arange(n)
    T = np.tile(np.eye(4), (n, 1, 1))
    angles = rng.normal(0, [0.1, 0.03, 0.03], (n, 3))
    angles[0, 0] = 0.0
    T[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
    T[:, :3, 3] = np.column_stack(
        [0.25 * np.minimum(k, n - 1 - k), 0.2 * (k >= n / 2), rng.uniform(0.7, 0.9, n)]
    )
    return T


def angles_of(w_T_b: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(w_T_b[:, :3, :3]).as_euler("ZYX")[:, ::-1]


def flight(
    w_T_b: np.ndarray, sonar: bool = True, attitude: bool = True, b_T_s: np.ndarray = np.eye(4)
) -> Flight:
    """Exact streams with a sample at each keyframe, and others halfway; the sonar at ``b_T_s``."""
    stamps_s = 3.0 * np.arange(len(w_T_b))
    near_s = (stamps_s[:, None] + [-0.1, 0.0, 0.1]).ravel()
    w_T_s = w_T_b @ b_T_s
    slant = np.repeat(w_T_s[:, 2, 3] / w_T_s[:, 2, 2], 3)
    return Flight(
        "made",
        camera=CAMERA,
        sonar=Sonar(near_s, slant, scale_std=0.02, b_T_s=b_T_s) if sonar else None,
        attitude=AttitudeSeries(near_s, np.repeat(angles_of(w_T_b), 3, axis=0)) if attitude else None,
    )


def setup_of(w_T_b: np.ndarray, **streams: bool) -> Setup:
    stamps_s = 3.0 * np.arange(len(w_T_b))
    return Setup(CAMERA, KeyframeReadings.at(flight(w_T_b, **streams), stamps_s, None, CONFIG), CONFIG)


def registration(
    w_T_b: np.ndarray, i: int, j: int, std_px: float = 0.1, camera: Camera = CAMERA
) -> Registration:
    """Exact; features on a grid of floor points, so that each point has one number everywhere."""
    H = np.linalg.inv(camera.floor_H_image(w_T_b[i])) @ camera.floor_H_image(w_T_b[j])
    seen_i, seen_j = (seen(w_T_b[k], camera)[0] for k in (i, j))
    both = np.intersect1d(seen_i, seen_j)
    rows = [np.searchsorted(numbers, both) for numbers in (seen_i, seen_j)]
    return Registration(i, j, None, np.column_stack(rows), H / H[2, 2], std_px**2 * np.eye(8), std_px, 0.5)


def seen(pose: np.ndarray, camera: Camera = CAMERA) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the floor points in view, and where."""
    grid = np.stack(np.meshgrid(np.arange(-1, 3, 0.1), np.arange(-1, 1.4, 0.1)), axis=-1).reshape(-1, 2)
    c_T_w = np.linalg.inv(pose @ camera.b_T_c)
    pixel = camera.project(np.column_stack([grid, np.zeros(len(grid))]) @ c_T_w[:3, :3].T + c_T_w[:3, 3])
    inside = ((pixel > 0) & (pixel < camera.size_px)).all(axis=1)
    return np.flatnonzero(inside), pixel[inside]
