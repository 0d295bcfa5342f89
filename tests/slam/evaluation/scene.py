"""Flights and estimates made by hand: smooth random motion over a floor, with errors that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from frontend.camera import Camera
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.streams import Truth

CAMERA = Camera((300.0, 300.0), (159.5, 119.5), (320, 240))


def smooth_poses(rng: np.random.Generator, count: int, size_m: float = 3.0) -> np.ndarray:
    """(count, 4, 4) random smooth motion about 0.8 m above the floor, little tilt, any yaw."""
    phase = np.linspace(0, 2 * np.pi, count)[:, None]
    waves = sum(rng.normal(size=6) / k * np.sin(k * phase + rng.uniform(0, 6, 6)) for k in (1, 2, 3, 5))
    w_T_b = np.tile(np.eye(4), (count, 1, 1))
    w_T_b[:, :3, :3] = Rotation.from_euler("ZYX", waves[:, :3] * [2.0, 0.05, 0.05]).as_matrix()
    w_T_b[:, :3, 3] = waves[:, 3:] * [size_m, size_m, 0.05] + [0, 0, 0.8]
    return w_T_b


def disturbed(rng: np.random.Generator, w_T_b: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Poses right-multiplied by Exp of Gaussian errors of (6,) standard deviations, rotation first."""
    return w_T_b @ exponential(rng.normal(size=(len(w_T_b), 6)) * std)


def exponential(xi: np.ndarray) -> np.ndarray:
    return RigidTransform.from_exp_coords(xi).as_matrix()


def yaw_shift(turn_rad: float, shift_m: np.ndarray) -> np.ndarray:
    G = np.eye(4)
    G[:3, :3] = Rotation.from_euler("z", turn_rad).as_matrix()
    G[:3, 3] = shift_m
    return G


def estimate_of(w_T_b: np.ndarray, step_s: float = 0.25, **changes: object) -> Estimate:
    n = len(w_T_b)
    made = Estimate(
        name="made",
        epoch_ns=1_700_000_000_123_456_789,
        stamps_s=np.arange(n) * step_s,
        frame_names=tuple(f"{k:06d}.png" for k in range(n)),
        frame_index=np.arange(n),
        w_T_b=w_T_b,
        covariances=np.tile(np.eye(6) * 1e-4, (n, 1, 1)),
        over_floor_covariances=np.tile(np.eye(6) * 0.5e-4, (n, 1, 1)),
        component=np.zeros(n, dtype=np.int64),
        camera=CAMERA,
        floor_z_m=0.0,
        origin=None,
        relative_poses=(),
        loops=(),
        chain_w_T_b=w_T_b.copy(),
        odometry_w_T_b=w_T_b.copy(),
    )
    return replace(made, **changes)


def flight_of(w_T_b: np.ndarray, step_s: float = 0.25, **changes: object) -> Flight:
    made = Flight(
        name="made",
        epoch_ns=1_700_000_000_123_456_789,
        camera=CAMERA,
        truth=Truth(np.arange(len(w_T_b)) * step_s, w_T_b),
    )
    return replace(made, **changes)
