"""What the map shows of the instruments' own errors, beyond what they were believed.

Perspective knows tilt against the floor without drift, and loops know heading; the instruments are held
against both. A mount that is tilted looks like an offset of the attitude, and is told as one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.bundle.noise import coloured_std
from slam.estimate import AccelerometerErrors, AttitudeErrors
from slam.flight import Flight
from slam.mapping.lengths import InertialLengths
from slam.mapping.synchronize import attitudes_at

Array = NDArray[np.float64]

_LEAST_KEYFRAMES = 8
_NOTABLE_RAD = np.radians(2.0)
"""A lean that is worth a word: an attitude's zero is seldom better than a degree."""
_SURE = 4.0
"""Standard deviations by which a lean must differ from none."""
_CLEARLY = 2.0
"""So many times steadier in the world's axes than in the body's, or the other way round."""


def attitude_errors(
    flight: Flight, stamps_s: Array, w_T_b: Array, level: bool = True
) -> AttitudeErrors | None:
    """Hold a flight's attitude against the poses (n, 4, 4) of its keyframes; None where that shows nothing.

    ``level``: whether the poses stand over a level floor, and not in a frame of their own.
    """
    placed = np.isfinite(w_T_b).all(axis=(1, 2))
    stamps_s, w_T_b = stamps_s[placed], w_T_b[placed]
    if flight.attitude is None or not level or len(stamps_s) < _LEAST_KEYFRAMES:
        return None
    told = attitudes_at(flight.attitude, stamps_s, 0.0)
    if len(told) < _LEAST_KEYFRAMES:
        return None
    k = np.array([a.k for a in told])
    angles = Rotation.from_matrix(w_T_b[k, :3, :3]).as_euler("ZYX")[:, ::-1]
    off = np.array([a.roll_pitch_yaw_rad for a in told]) - angles
    off = np.unwrap(off, axis=0)
    headed = all(np.isfinite(a.std_rad[2]) for a in told)
    tilt = off[:, :2]
    mean = tilt.mean(axis=0)
    std = [coloured_std(tilt[:, a : a + 1] - mean[a]) / np.sqrt(len(k)) for a in (0, 1)]
    return AttitudeErrors(
        (float(mean[0]), float(mean[1])),
        (float(std[0]), float(std[1])),
        float(np.sqrt(np.mean((tilt - mean) ** 2))),
        float(np.abs(tilt).max()),
        float(np.ptp(off[:, 2])) if headed else None,
    )


def lean_told(flight: Flight, stamps_s: Array, w_T_b: Array) -> str:
    """In words, where the attitude leans against the floor all along: a map without positions takes the
    ground for level. Empty where it does not; ``w_T_b`` (n, 4, 4) of keyframes, NaN where not placed.
    """
    placed = np.isfinite(w_T_b).all(axis=(1, 2))
    told = attitudes_at(flight.attitude, stamps_s[placed], 0.0) if flight.attitude is not None else ()
    if len(told) < _LEAST_KEYFRAMES:
        return ""
    w_R_b = w_T_b[placed][[a.k for a in told], :3, :3]
    roll_pitch = np.array([[0.0, *a.roll_pitch_yaw_rad[1::-1]] for a in told])
    b_up = Rotation.from_euler("ZYX", roll_pitch).as_matrix()[:, 2]
    # What the attitude has for upwards leans uphill where the ground slopes.
    in_world = np.einsum("nab,nb->na", w_R_b, b_up)[:, :2]
    heading = np.arctan2(w_R_b[:, 1, 0], w_R_b[:, 0, 0])
    in_body = Rotation.from_euler("z", -heading[:, None]).apply(np.pad(in_world, ((0, 0), (0, 1))))[:, :2]
    means = [lean.mean(axis=0) for lean in (in_world, in_body)]
    spreads = [
        coloured_std(lean - mean) / np.sqrt(len(told))
        for lean, mean in zip((in_world, in_body), means, strict=True)
    ]
    steadier = int(np.argmin(spreads))
    lean = float(np.linalg.norm(means[steadier]))
    if lean < max(_NOTABLE_RAD, _SURE * spreads[steadier]):
        return ""
    where, cause = "", "the ground slopes, the camera's mount leans or the attitude is off"
    if max(spreads) > _CLEARLY * min(spreads) and steadier == 0:
        uphill = np.degrees(np.arctan2(means[0][1], means[0][0]))
        where = f" towards {uphill:+.0f}° in the map whatever the heading"
        cause = "the ground slopes or wind misleads it"
    elif max(spreads) > _CLEARLY * min(spreads):
        where = " towards one side of the body whatever the heading"
        cause = "its zero or the camera's mount is off"
    return (
        f"attitude0 leans {np.degrees(lean):.1f}° against the floor{where}: {cause}; "
        "the map takes the ground for level"
    )


def accelerometer_errors(
    by_inertia: InertialLengths | None, taken_out_s: float
) -> AccelerometerErrors | None:
    """What the accelerometer was found to be off by, and what it says of lengths; of the delay of the
    pictures ``taken_out_s`` was taken out before."""
    if by_inertia is None:
        return None
    found, lengths = by_inertia.found, by_inertia.lengths
    return AccelerometerErrors(
        found.offset_m_s2,
        found.offset_std_m_s2,
        found.arm_m,
        found.arm_std_m,
        found.delay_s + taken_out_s,
        lengths.ratio,
        lengths.ratio * lengths.log_std,
        by_inertia.helps,
        found.delay_std_s,
        taken_out_s,
    )
