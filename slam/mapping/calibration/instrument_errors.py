"""The instruments' errors as the finished map shows them.

Perspective gives the tilt against the floor without drift, and loop closures give the heading; the
instruments are compared with both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.bundle.residual_spread import autocorrelated_std
from slam.core.flight import Flight
from slam.core.instrument_errors import AccelerometerErrors, AttitudeErrors, ClockErrors
from slam.core.rotations import roll_pitch_yaw_of
from slam.mapping.calibration.attitude_floor_tilt import LEAST_KEYFRAMES
from slam.mapping.calibration.inertial_scale import AccelerometerScale
from slam.mapping.keyframe_readings import attitudes_at

Array = NDArray[np.float64]


def attitude_errors(
    flight: Flight, stamps_s: Array, w_T_b: Array, level: bool = True
) -> AttitudeErrors | None:
    """Hold a flight's attitude against the poses (n, 4, 4) of its keyframes; None where that shows nothing.

    ``level``: whether the poses stand over a level floor, and not in a frame of their own.
    """
    placed = np.isfinite(w_T_b).all(axis=(1, 2))
    stamps_s, w_T_b = stamps_s[placed], w_T_b[placed]
    if flight.attitude is None or not level or len(stamps_s) < LEAST_KEYFRAMES:
        return None
    readings = attitudes_at(flight.attitude, stamps_s, 0.0)
    if len(readings) < LEAST_KEYFRAMES:
        return None
    k = np.array([a.k for a in readings])
    off = np.array([a.roll_pitch_yaw_rad for a in readings]) - roll_pitch_yaw_of(w_T_b[k, :3, :3])
    off = np.unwrap(off, axis=0)
    headed = all(np.isfinite(a.std_rad[2]) for a in readings)
    tilt = off[:, :2]
    mean = tilt.mean(axis=0)
    std = [autocorrelated_std(tilt[:, a : a + 1] - mean[a]) / np.sqrt(len(k)) for a in (0, 1)]
    return AttitudeErrors(
        (float(mean[0]), float(mean[1])),
        (float(std[0]), float(std[1])),
        float(np.sqrt(np.mean((tilt - mean) ** 2))),
        float(np.abs(tilt).max()),
        float(np.ptp(off[:, 2])) if headed else None,
    )


def accelerometer_errors(
    by_inertia: AccelerometerScale | None, clock: ClockErrors | None
) -> AccelerometerErrors | None:
    """Summarise bias, lever arm and scale of the accelerometer, and the delay of the pictures' clock before
    any step."""
    if by_inertia is None:
        return None
    found, lengths = by_inertia.found, by_inertia.lengths
    first = clock.spans[0] if clock else None
    delay_s, delay_std_s = (first.delay_s, first.delay_std_s) if first else (0.0, float("inf"))
    return AccelerometerErrors(
        offset_m_s2=found.offset_m_s2,
        offset_std_m_s2=found.offset_std_m_s2,
        arm_m=found.arm_m,
        arm_std_m=found.arm_std_m,
        scale=lengths.ratio,
        scale_std=lengths.ratio * lengths.log_std,
        used=by_inertia.helps,
        others_std=by_inertia.map_std,
        delay_s=delay_s,
        delay_std_s=delay_std_s,
        delay_taken_out_s=delay_s if first and first.taken_out else 0.0,
        lag_s=found.lag.lag_s if found.lag else 0.0,
        lag_std_s=found.lag.std_s if found.lag else float("inf"),
        lag_taken_out=found.lag is not None and found.lag.believed,
    )
