"""A small flight with every stream, whose numbers agree with each other as a real one's do."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries, Command, Frames, Gps, Imu, Motor, Scalar, Sonar, Truth, Velocity

EPOCH_NS = 1_603_996_430_503_655_000
SIZE = (48, 36)


def ns(stamps_s):
    """Stamps that are whole nanoseconds, as they come back from disk."""
    return np.round(np.asarray(stamps_s) * 1e9) * 1e-9


def picture(k, size=SIZE, colour=True):
    rng = np.random.default_rng(k)
    shape = (size[1], size[0], 3) if colour else (size[1], size[0])
    return rng.integers(0, 256, shape, dtype=np.uint8)


def made_flight(seed=0, seconds=6.0):
    rng = np.random.default_rng(seed)

    def times(rate_hz, start=0.0):
        return ns(np.arange(start, seconds, 1 / rate_hz))

    def attitude(t):
        return np.column_stack([0.1 * np.sin(t), 0.15 * np.cos(1.3 * t), 0.4 * np.sin(0.7 * t)])

    t_imu, t_att, t_sonar, t_cam, t_gps = (
        times(100),
        times(50, 0.01),
        times(25, 0.02),
        times(5, 0.1),
        times(5),
    )
    rates = (attitude(t_imu + 5e-3) - attitude(t_imu - 5e-3)) / 1e-2
    ranges = 1.2 + 0.1 * np.sin(t_sonar) + rng.normal(0, 0.01, len(t_sonar))
    ranges[3:5] = np.nan
    altitude = 40 + rng.normal(0, 1, len(t_gps))
    altitude[-1] = np.nan
    w_T_b = np.tile(np.eye(4), (len(t_att), 1, 1))
    w_T_b[:, :3, :3] = Rotation.from_euler("ZYX", attitude(t_att)[:, ::-1]).as_matrix()
    w_T_b[:, :3, 3] = rng.normal(0, 1, (len(t_att), 3))
    mount = np.eye(4)
    mount[:3, :3], mount[:3, 3] = (
        Rotation.from_euler("xyz", [0.1, -0.2, 0.3]).as_matrix(),
        (0.01, 0.02, -0.03),
    )
    pictures = {k: picture(k) for k in range(len(t_cam))}
    return Flight(
        name="made: a 'flight' #1",
        epoch_ns=EPOCH_NS,
        camera=Camera((40.0, 41.5), (23.5, 17.5), SIZE, (0.01, -0.02, 1e-5, 0.0), mount, 0.02, 0.1),
        frames=Frames(t_cam, tuple(f"{k:03d}.png" for k in range(len(t_cam))), pictures.get),
        imu=Imu(t_imu, rates, [0, 0, 9.80665] + rng.normal(0, 0.1, (len(t_imu), 3)), 1e-3, 2e-2, 1e-5, 3e-4, mount),  # noqa: E501
        sonar=Sonar(t_sonar, ranges, 0.012, 0.2, 5.5, 0.5, scale_std=0.04, datum_std_m=0.03, b_T_s=mount),
        attitude=AttitudeSeries(t_att, attitude(t_att), (0.004, 0.005, 0.006)),
        velocity=Velocity(t_att, rng.normal(0, 0.5, (len(t_att), 2)), (0.02, 0.03), 0.07),
        command=Command(t_sonar, rng.uniform(-1, 1, (len(t_sonar), 4)), 0.21),
        battery=Scalar(t_gps, 12 - 0.01 * t_gps, 0.02),
        barometer=Scalar(t_gps, rng.normal(3, 1, len(t_gps)), 0.06),
        motor=Motor(t_att, rng.uniform(0, 1, (len(t_att), 4))),
        gps=Gps(t_gps, 47.3 + rng.normal(0, 1e-5, len(t_gps)), 8.5 + rng.normal(0, 1e-5, len(t_gps)), altitude, (2.0, 3.0, 7.0)),  # noqa: E501
        truth=Truth(t_att, w_T_b, rng.normal(0, 1, (len(t_att), 3))),
        landmarks={"A": np.array([0.1, 0.2, 0.0]), "B, too": np.array([1 / 3, -2.0, 0.0])},
        landmark_pairs=(("A", "B, too"),),
        gaps=(("B, too", "A"),),
        notes={"vehicle": "quadrotor: \"x\"", "date": "2026-01-02", "notes": "two\nlines, ümlaut and # hash"},
    )  # fmt: skip
