"""Bags of a made flight with several cameras over a floor between walls, as they would see it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tests.slam.io.recordings.ros.made_bag import ROS1, START_NS, Maker, write

SIZE_PX, FOCAL_PX = (160, 120), 110.0
NADIR = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])
"""Mount (3, 3) of a camera that looks straight down."""
AHEAD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Mount (3, 3) of a camera that looks along the body's x."""
ROOM_M = 5.0
"""Distance of the four walls from the middle."""
_PX_PER_M = 60.0


@dataclass(frozen=True)
class MadeFlight:
    """Motion of a vehicle that wanders through the room 1.5 m above its floor."""

    lasts_s: float = 16.0
    turns: float = 1.0
    """Size of the turns; 0 for a vehicle that keeps its attitude."""
    moves: float = 1.0
    """Size of the way; 0 for a vehicle that stands."""

    def attitude(self, t: np.ndarray) -> Rotation:
        roll, pitch = 0.12 * np.sin(1.9 * t), 0.1 * np.sin(1.3 * t + 1.0)
        return Rotation.from_euler("ZYX", self.turns * np.column_stack([0.9 * np.sin(0.7 * t), pitch, roll]))

    def position(self, t: np.ndarray) -> np.ndarray:
        way = np.column_stack([2.0 * np.sin(0.4 * t), 2.0 * np.sin(0.31 * t + 0.5), 0.3 * np.sin(0.6 * t)])
        return self.moves * way + [0.0, 0.0, 1.5]

    def gyro(self, t: np.ndarray) -> np.ndarray:
        step = 1e-4
        return (self.attitude(t - step).inv() * self.attitude(t + step)).as_rotvec() / (2 * step)

    def accel(self, t: np.ndarray) -> np.ndarray:
        step = 1e-2
        second = self.position(t + step) - 2 * self.position(t) + self.position(t - step)
        return self.attitude(t).inv().apply(second / step**2 + [0.0, 0.0, 9.81])


def texture(seed: int) -> np.ndarray:
    """Return a picture of 20 x 20 m with detail of several sizes."""
    rng, side = np.random.default_rng(seed), int(4 * ROOM_M * _PX_PER_M)
    layers = [
        cv2.resize(rng.normal(size=(side // n, side // n)).astype(np.float32), (side, side))
        for n in (3, 8, 30)
    ]
    return np.clip(128 + 45 * sum(layers), 0, 255).astype(np.uint8)


def seen(w_R_c: np.ndarray, at: np.ndarray, surfaces: list[np.ndarray]) -> np.ndarray:
    """Return the grey picture of a camera in the room: floor, four walls and the ceiling 4 m above."""
    u, v = np.meshgrid(np.arange(SIZE_PX[0]), np.arange(SIZE_PX[1]))
    middle = (np.array(SIZE_PX) - 1) / 2
    ray = np.stack([(u - middle[0]) / FOCAL_PX, (v - middle[1]) / FOCAL_PX, np.ones(u.shape)], -1) @ w_R_c.T
    low, high = np.array([-ROOM_M, -ROOM_M, 0.0]), np.array([ROOM_M, ROOM_M, 4.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(ray > 0, (high - at) / ray, (low - at) / ray)
    axis = np.nan_to_num(reach, nan=np.inf).argmin(-1)
    point = at + np.take_along_axis(reach, axis[..., None], -1) * ray
    surface = 2 * axis + (np.take_along_axis(ray, axis[..., None], -1)[..., 0] > 0)
    picture = np.zeros(u.shape, np.uint8)
    for k, paint in enumerate(surfaces):
        flat = np.delete(point, k // 2, axis=-1).astype(np.float32)
        x, y = np.moveaxis((flat + 2 * ROOM_M) * _PX_PER_M, -1, 0)
        painted = cv2.remap(paint, np.ascontiguousarray(x), np.ascontiguousarray(y), cv2.INTER_LINEAR)
        picture = np.where(surface == k, painted, picture)
    return picture


def made_bag(
    path: Path,
    mounts: dict[str, np.ndarray],
    flight: MadeFlight = MadeFlight(),
    body: str = "imu",
    imu_R_b: np.ndarray = np.eye(3),
    rate_hz: float = 5.0,
) -> Path:
    """Write a bag with a camera of each name and mount (3, 3), in this order, without their transforms.

    ``body``: "imu", "attitude" or "" for the instrument that shows how the vehicle turns.
    """
    maker, surfaces = Maker(ROS1), [texture(seed) for seed in range(6)]
    times = np.arange(0.0, flight.lasts_s, 1 / rate_hz)
    attitude, place = flight.attitude(times).as_matrix(), flight.position(times)
    rng = np.random.default_rng(3)
    messages = []
    for k, t in enumerate(times):
        stamp_ns = START_NS + int(t * 1e9)
        for name, mount in mounts.items():
            header = maker.header(stamp_ns, name)
            pixels = seen(attitude[k] @ mount, place[k], surfaces)
            pixels = np.clip(pixels + rng.normal(0, 2.0, pixels.shape), 0, 255).astype(np.uint8)
            info = maker.info(header, FOCAL_PX)
            info.width, info.height = SIZE_PX
            (info.K if maker.is_1 else info.k)[[2, 5]] = (np.array(SIZE_PX) - 1) / 2
            messages += [
                (f"/{name}/image_raw", stamp_ns, maker.image(header, pixels, "mono8")),
                (f"/{name}/camera_info", stamp_ns, info),
            ]
    at = np.arange(0.0, flight.lasts_s, 0.01)
    gyro, accel = flight.gyro(at) @ imu_R_b.T, flight.accel(at) @ imu_R_b.T
    quaternion = flight.attitude(at).as_quat(scalar_first=True)
    for k, t in enumerate(at):
        stamp_ns = START_NS + int(t * 1e9)
        header = maker.header(stamp_ns, "sensor")
        noisy = (gyro[k] + rng.normal(0, 0.01, 3), accel[k] + rng.normal(0, 0.3, 3))
        if body == "imu":
            messages.append(("/imu", stamp_ns, maker.imu(header, *map(tuple, noisy))))
        elif body == "attitude":
            nothing = maker.imu(header, (0.0,) * 3, (0.0,) * 3, tuple(quaternion[k]))
            nothing.angular_velocity_covariance[0] = nothing.linear_acceleration_covariance[0] = -1
            messages.append(("/attitude", stamp_ns, nothing))
    messages.sort(key=lambda each: each[1])
    return write(path, maker, messages)
