"""A recorded flight as a phone and an autopilot would have it: a video, and a log on another clock."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from slam.core.flight import Flight

IMU = "float[3] gyro_rad;float[3] accelerometer_m_s2"


def video_of(flight: Flight, path: Path, first: int, count: int, rate_hz: float) -> float:
    """Write ``count`` pictures from number ``first`` on; return the time of the first."""
    pictures = [flight.frames[k].read() for k in range(first, first + count)]
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), rate_hz, (width, height))
    assert writer.isOpened()
    for picture in pictures:
        writer.write(picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    return float(flight.frames.stamps_s[first])


def imu_rows(flight: Flight, begin_s: float, boot_s: float) -> tuple[list[tuple], float]:
    """Return rows of ``sensor_combined`` from ``begin_s`` on, and the time of the first one.

    The autopilot was started ``boot_s`` before ``begin_s``; its axes are forward-right-down.
    """
    stamps_s = flight.imu.stamps_s
    rows = np.flatnonzero(stamps_s >= begin_s)
    signs = np.array([1.0, -1.0, -1.0])
    values = np.hstack([flight.imu.gyro_rad_s[rows] * signs, flight.imu.accel_m_s2[rows] * signs])
    first_s = float(stamps_s[rows[0]])
    micros = np.round((stamps_s[rows] - first_s + boot_s) * 1e6).astype(int)
    return [(m, *map(float, v)) for m, v in zip(micros.tolist(), values, strict=True)], first_s
