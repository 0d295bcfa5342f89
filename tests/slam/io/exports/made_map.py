"""A map made by hand: a few keyframes with round numbers, on the equator at the prime meridian."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from frontend.camera import Camera
from slam.core.estimate import Estimate
from slam.core.geodesy import GeoOrigin
from slam.io.exports.exported_map import ExportedMap
from tests.slam.made_estimate import made_estimate

FIRST_NS = 1_714_979_289_250_000_000
"""6 May 2024, 07:08:09.25 UTC."""
NORTH: np.ndarray = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
"""Attitude of a level body whose nose points to the north: forward, left and up are the columns."""
CAMERA = Camera((100.0, 100.0), (31.5, 23.5), (64, 48))


def pose(position=(0.0, 0.0, 10.0), R=NORTH) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, position
    return T


def made_map(*poses: np.ndarray, **changes) -> Estimate:
    """An estimate with the poses a second apart; standard deviations of 1, 2, 3 m forward, left, up."""
    n = len(poses)
    fields = {
        "epoch_ns": FIRST_NS,
        "stamps_s": np.arange(n) * 1.0,
        "frame_names": tuple(f"P{k}.jpg" for k in range(n)),
        "frame_index": np.arange(n),
        "w_T_b": np.array(poses),
        "covariances": np.tile(np.diag([0.0, 0, 0, 1, 4, 9]), (n, 1, 1)),
        "over_floor_covariances": np.full((n, 6, 6), np.nan),
        "component": np.zeros(n, dtype=np.int64),
        "camera": CAMERA,
        "origin": GeoOrigin(0.0, 0.0, 0.0),
        "relative_poses": (),
        "loops": (),
        "chain_w_T_b": np.array(poses),
        "odometry_w_T_b": np.array(poses),
        "messages": (),
    }
    return replace(made_estimate(2, name="made map"), **{**fields, **changes})


def exported(estimate: Estimate, **more) -> ExportedMap:
    return ExportedMap(estimate, **more)
