"""Rows exposed one after the other, put back: floor points seen by a camera that moves while it reads."""

from __future__ import annotations

from dataclasses import replace
from functools import partial, reduce
from itertools import pairwise

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from frontend.homography import transfer
from frontend.rolling_shutter import NeighbourView, RowMotion, global_shutter_homography

CAMERA = Camera((180.0, 182.0), (87.5, 71.5), (176, 144), readout_s=0.03)
BENT = replace(CAMERA, distortion=(-0.2, 0.05, 0.001, -0.001))
EVERY_S = 1 / 15


class Flown:
    """A camera over the floor: brisk, turning about all axes, gaining height, with jerks."""

    def __init__(self, camera: Camera, rng: np.random.Generator) -> None:
        self.camera = camera
        self.speed, self.accel = rng.normal(0, 0.6, 3), rng.normal(0, 1.5, 3)
        self.rate, self.rate_grows = rng.normal(0, 0.8, 3), rng.normal(0, 4.0, 3)
        self.lean = rng.normal(0, 0.1, 3)

    def turned(self, at_s: float, since_s: np.ndarray) -> np.ndarray:
        """Rotation vectors in the camera's axes, as a gyro adds them up."""
        later = at_s + since_s
        return since_s[:, None] * self.rate + 0.5 * (later**2 - at_s**2)[:, None] * self.rate_grows

    def w_T_c(self, t: float) -> np.ndarray:
        steps = np.linspace(0, t, 41)
        turns = [self.turned(a, np.array([b - a]))[0] for a, b in pairwise(steps)]
        R = Rotation.from_rotvec(self.lean) * Rotation.from_euler("x", 180, degrees=True)
        pose = np.eye(4)
        pose[:3, :3] = reduce(np.matmul, Rotation.from_rotvec(turns).as_matrix(), R.as_matrix())
        pose[:3, 3] = [0, 0, 1.1] + self.speed * t + 0.5 * self.accel * t**2
        return pose

    def at_once(self, floor: np.ndarray, t: float) -> np.ndarray:
        """Undistorted pixels of floor points (n, 2)."""
        body = replace(self.camera, b_T_c=np.eye(4))
        return transfer(np.linalg.inv(body.floor_H_image(self.w_T_c(t))), floor)

    def in_rows(self, floor: np.ndarray, t: float) -> np.ndarray:
        """The same, each point in its row's own time; t is that of the middle row."""
        pixel = self.at_once(floor, t)
        for _ in range(6):
            row = self.camera.project(self.camera.rays(pixel))[:, 1]
            late = self.camera.readout_s * (row / (self.camera.size_px[1] - 1) - 0.5)
            pixel = np.vstack([self.at_once(p[None], t + s) for p, s in zip(floor, late, strict=True)])
        return pixel

    def H(self, a_s: float, b_s: float) -> np.ndarray:
        """a_H_b of pictures taken at once."""
        body = replace(self.camera, b_T_c=np.eye(4))
        floor_H_a, floor_H_b = (body.floor_H_image(self.w_T_c(t)) for t in (a_s, b_s))
        return np.linalg.solve(floor_H_a, floor_H_b)


@pytest.mark.parametrize(
    ("camera", "with_gyro"),
    [
        (BENT, True),
        pytest.param(CAMERA, False, marks=pytest.mark.slow),
        pytest.param(CAMERA, True, marks=pytest.mark.slow),
        pytest.param(BENT, False, marks=pytest.mark.slow),
    ],
)
def test_points_come_to_where_the_middle_row_has_them(camera: Camera, with_gyro: bool) -> None:
    rng, before, after = np.random.default_rng(3), [], []
    for _ in range(12):
        flown = Flown(camera, rng)
        floor = rng.uniform(-0.35, 0.35, (30, 2))
        seen, true = flown.in_rows(floor, 0.0), flown.at_once(floor, 0.0)
        beside = [NeighbourView(s, flown.H(s, 0.0)) for s in (-EVERY_S, EVERY_S)]
        gyro = partial(flown.turned, 0.0) if with_gyro else (lambda s: np.zeros((len(s), 3)))
        motion = RowMotion.estimate(camera, beside, gyro)
        before.append(np.linalg.norm(seen - true, axis=1).max())
        after.append(np.linalg.norm(motion.to_global_shutter(seen) - true, axis=1).max())
        np.testing.assert_allclose(motion.to_rolling_shutter(motion.to_global_shutter(seen)), seen, atol=0.05)
    assert np.median(before) > 2.0
    assert np.median(after) < 0.1 * np.median(before)


def test_one_picture_beside_is_enough_where_nothing_jerks_and_none_leaves_the_turning() -> None:
    flown = Flown(CAMERA, np.random.default_rng(5))
    flown.accel, flown.rate_grows = np.zeros(3), np.zeros(3)
    floor = np.random.default_rng(6).uniform(-0.3, 0.3, (20, 2))
    seen, true = flown.in_rows(floor, 0.0), flown.at_once(floor, 0.0)

    def off(motion: RowMotion) -> float:
        return float(np.linalg.norm(motion.to_global_shutter(seen) - true, axis=1).max())

    turned = partial(flown.turned, 0.0)
    nothing = off(RowMotion.estimate(replace(CAMERA, readout_s=0.0), [], turned))
    turning = off(RowMotion.estimate(CAMERA, [], turned))
    one = off(RowMotion.estimate(CAMERA, [NeighbourView(-EVERY_S, flown.H(-EVERY_S, 0.0))], turned))
    assert one < 0.15 * nothing
    assert one < turning < nothing


def test_homographies_lose_what_the_rows_did() -> None:
    rng = np.random.default_rng(8)
    for _ in range(5):
        flown = Flown(CAMERA, rng)
        times = (0.0, 2 * EVERY_S)
        motions = [
            RowMotion.estimate(
                CAMERA,
                [NeighbourView(s, flown.H(t + s, t)) for s in (-EVERY_S, EVERY_S)],
                partial(flown.turned, t),
            )
            for t in times
        ]
        corners = CAMERA.corners_px
        body = replace(CAMERA, b_T_c=np.eye(4))
        there = transfer(body.floor_H_image(flown.w_T_c(times[1])), corners)
        rolled = [flown.in_rows(there, t) for t in times]
        as_seen = cv2.getPerspectiveTransform(rolled[1].astype(np.float32), rolled[0].astype(np.float32))
        true = flown.H(*times)
        straight = global_shutter_homography(as_seen, *motions)
        wrong = np.linalg.norm(transfer(as_seen, corners) - transfer(true, corners), axis=1).max()
        left = np.linalg.norm(transfer(straight, corners) - transfer(true, corners), axis=1).max()
        assert left < 0.35 * wrong


def test_neighbour_with_the_same_readout_gives_the_true_speed_of_a_vertical_motion() -> None:
    """The time between two views of a point is not that between the middle rows."""
    flown = Flown(CAMERA, np.random.default_rng(9))
    flown.speed = np.array([0.0, 1.5, 0.0])
    flown.accel, flown.rate, flown.rate_grows, flown.lean = np.zeros((4, 3))
    floor = 0.35 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    before, here = (flown.in_rows(floor, t).astype(np.float32) for t in (-EVERY_S, 0.0))
    neighbour = NeighbourView(-EVERY_S, cv2.getPerspectiveTransform(here, before))
    motion = RowMotion.estimate(CAMERA, [neighbour], lambda s: np.zeros((len(s), 3)))
    seen, true = flown.in_rows(floor, 0.0), flown.at_once(floor, 0.0)
    assert np.abs(seen - true).max() > 1.0
    np.testing.assert_allclose(motion.to_global_shutter(seen), true, atol=0.02)
