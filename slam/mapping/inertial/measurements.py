"""Readings of the IMU with their noise, and the pictures between keyframes that they are compared with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.measurements import Inertial, InertialNoise, TrackedFrame
from frontend.camera import Camera
from frontend.homography import transfer
from slam.core.flight import Imu
from slam.inertial.variogram import noise_and_power
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import Observations
from slam.mapping.keyframe_readings import inertial_readings

_SPACING_S = 0.2
"""Spacing of pictures, as far as there are so many: it resolves motion up to 2.5 Hz, faster than a small
vehicle turns its thrust. Closer ones share their errors."""


def inertial_measurements(imu: Imu | None, config: PipelineConfig) -> Inertial | None:
    """Return the readings in body axes with their noise; None without an IMU.

    The noise is the nominal one, or that of the recording where it is clearly larger. The residuals of the
    refinement show what vibration adds.
    """
    readings = inertial_readings(imu)
    if imu is None or readings is None:
        return None
    step_s, trust = float(np.median(np.diff(readings.stamps_s))), config.inertial
    densities = [
        noise_and_power(values, step_s, nominal / np.sqrt(step_s))[0] * np.sqrt(step_s)
        for values, nominal in (
            (readings.gyro_rad_s, imu.gyro_noise_density),
            (readings.accel_m_s2, imu.accel_noise_density),
        )
    ]
    noise = InertialNoise(
        gyro_density=float(densities[0]),
        accel_density=float(densities[1]),
        gyro_walk=max(imu.gyro_random_walk, trust.gyro_walk_rad_s2),
        accel_walk=max(imu.accel_random_walk, trust.accel_walk_m_s3),
        gyro_offset_rad_s=trust.gyro_offset_rad_s,
        accel_offset_m_s2=trust.accel_offset_m_s2,
        gain_ratio=config.trust.accel_gain_std,
        gyro_gain_ratio=config.trust.gyro_gain_std,
    )
    return Inertial(readings, noise, np.asarray(imu.b_T_s[:3, 3], dtype=float))


def tracked_frames(
    observations: Observations, members: NDArray[np.int64], camera: Camera
) -> tuple[TrackedFrame, ...]:
    """Return pictures between the keyframes ``members`` (m,), which are numbered from 0.

    Where there are enough pictures, successive ones are no farther apart than the spacing. The last picture
    before a gap and the first one after it are among them.
    """
    number = {k: m for m, k in enumerate(members.tolist())}
    corners = camera.undistort(camera.corners_px)
    passed = {p.frame: p for p in observations.passed if p.keyframe in number}
    frames = np.array(sorted({*passed, *observations.frame_index[members].tolist()}), dtype=np.int64)
    stamps_s = observations.frame_stamps_s[frames]
    found, last_s = [], -np.inf
    for frame, now_s, next_s in zip(frames.tolist(), stamps_s, [*stamps_s[1:], np.inf], strict=True):
        seen = passed.get(frame)
        if seen is None or next_s - last_s > _SPACING_S:
            last_s = now_s
            if seen is not None:
                at, k_pixel = number[seen.keyframe], transfer(seen.i_H_j, corners)
                found.append(TrackedFrame(at, float(now_s), corners, k_pixel, seen.corner_covariance))
    return tuple(found)
