"""Readings of the IMU and motion that the vehicle reports, with their noise, and the pictures between
keyframes that both are compared with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.measurements import Inertial, InertialNoise, ReportedMotion, ReportedNoise, TrackedFrame
from frontend.camera import Camera
from frontend.homography import transfer
from slam.core.flight import Flight
from slam.core.instrument_readings import inertial_readings
from slam.core.stream_anomalies import at_range_end
from slam.core.streams import AttitudeSeries, Imu, Velocity
from slam.inertial.variogram import noise_and_power
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import Observations

Array = NDArray[np.float64]

_SPACING_S = 0.2
"""Spacing of pictures, as far as there are so many: it resolves motion up to 2.5 Hz, faster than a small
vehicle turns its thrust. Closer ones share their errors."""
_LEAST_MEANS = 20
"""Fewest means that tell a density, to a sixth of it."""
_LEAST_GAIN_STD = 1e-3
"""Least standard deviation of the gain of a velocity whose scale is stated as exact."""


def inertial_measurements(imu: Imu | None, config: PipelineConfig) -> Inertial | None:
    """Return the readings in body axes with their noise; None without an IMU.

    The noise is the nominal one, or that of the recording where it is clearly larger. The residuals of the
    refinement show what else adds to it.
    """
    stated = stated_inertial(imu, config)
    if stated is None:
        return None
    readings, noise = stated.readings, stated.noise
    step_s = float(np.median(np.diff(readings.stamps_s)))
    gyro = _density(readings.gyro_rad_s, step_s, noise.gyro_density)
    accel = _density(readings.accel_m_s2, step_s, noise.accel_density)
    return replace(stated, noise=replace(noise, gyro_density=gyro, accel_density=accel))


def _density(values: Array, step_s: float, nominal: float) -> float:
    """Return the density of white noise in readings (n, 3), ``nominal`` at least.

    Vibration looks like white noise from one reading to the next, but cancels in the integral between two
    pictures. So the means over that time limit the density; their second differences hide slow motion.
    """
    between = float(noise_and_power(values, step_s, nominal / np.sqrt(step_s))[0] * np.sqrt(step_s))
    count = max(1, round(_SPACING_S / step_s))
    means = values[: len(values) // count * count].reshape(-1, count, values.shape[1]).mean(axis=1)
    if len(means) < _LEAST_MEANS:
        return between
    # Of white noise they have 1 + 4 + 1 times the variance of a mean.
    of_means = np.mean(np.diff(means, 2, axis=0) ** 2) / 6
    return max(nominal, min(between, float(np.sqrt(of_means * count * step_s))))


def stated_inertial(imu: Imu | None, config: PipelineConfig) -> Inertial | None:
    """Return the readings in body axes with the noise that the sensor states; None without two readings.

    Those at an end of the sensor's range are invalid. A walk of a bias that is not stated is nominal.
    """
    readings, trust = inertial_readings(imu), config.inertial
    if imu is None or readings is None:
        return None
    noise = InertialNoise(
        gyro_density=imu.gyro_noise_density,
        accel_density=imu.accel_noise_density,
        gyro_walk=imu.gyro_random_walk or trust.gyro_walk_rad_s2,
        accel_walk=imu.accel_random_walk or trust.accel_walk_m_s3,
        gyro_offset_rad_s=trust.gyro_offset_rad_s,
        accel_offset_m_s2=trust.accel_offset_m_s2,
        gain_ratio=config.trust.accel_gain_std,
        gyro_gain_ratio=config.trust.gyro_gain_std,
    )
    clipped = (at_range_end(imu.gyro_rad_s) | at_range_end(imu.accel_m_s2)).any(axis=1)
    b_p_imu_m = np.asarray(imu.b_T_s[:3, 3], dtype=float)
    return Inertial(readings, noise, b_p_imu_m, np.unique(imu.stamps_s[clipped]))


def reported_motion(flight: Flight, config: PipelineConfig) -> ReportedMotion | None:
    """Return velocity and yaw as the vehicle reports them; None without both.

    The turns are no measurements beside a gyro, from which the vehicle has them. Their noise is nominal; the
    pictures show the actual one.
    """
    velocity, yaw = _velocity(flight.velocity), _yaw(flight.attitude)
    if velocity is None or yaw is None or flight.velocity is None:
        return None
    trust, (stamps_s, v_m_s) = config.inertial, velocity
    std = np.maximum(flight.velocity.noise_std_m_s, trust.velocity_floor_m_s)
    forward, left = (std * np.sqrt(np.median(np.diff(stamps_s)))).tolist()
    return ReportedMotion(
        stamps_s=stamps_s,
        v_m_s=v_m_s,
        yaw_stamps_s=yaw[0],
        yaw_rad=yaw[1],
        noise=ReportedNoise(
            density=(forward, left, trust.yaw_walk_rad),
            error=(trust.velocity_error_m_s, trust.velocity_error_m_s, 0.0),
            time_s=(1.0, 1.0, 1.0),
        ),
        gain_std=max(flight.velocity.scale_std, _LEAST_GAIN_STD),
        bias_m_s=trust.velocity_error_m_s,
        drift_rad_s=trust.gyro_offset_rad_s,
        tells_turns=flight.imu is None,
    )


def _velocity(velocity: Velocity | None) -> tuple[Array, Array] | None:
    """Return times (k,) and velocities (k, 2) that are known on both axes."""
    if velocity is None:
        return None
    known = np.isfinite(velocity.v_m_s).all(axis=1)
    stamps_s, first = np.unique(velocity.stamps_s[known], return_index=True)
    return (stamps_s, velocity.v_m_s[known][first]) if len(stamps_s) > 1 else None


def _yaw(attitude: AttitudeSeries | None) -> tuple[Array, Array] | None:
    """Return times (l,) and yaw (l,) without jumps by whole turns."""
    if attitude is None:
        return None
    known = np.isfinite(attitude.roll_pitch_yaw_rad[:, 2])
    stamps_s, first = np.unique(attitude.stamps_s[known], return_index=True)
    return (stamps_s, np.unwrap(attitude.roll_pitch_yaw_rad[known, 2][first])) if len(stamps_s) > 1 else None


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
