"""Gross disagreement of an instrument with the map: rotations, tilts and displacements are compared.

It finds pictures in another order and a wrong sign, axis or unit, not noise, gains or small delays. The map
of such a flight is consistent in itself, so that only another instrument can reveal the error.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.flight import Flight
from slam.core.rotations import roll_pitch_yaw_of

Array = NDArray[np.float64]

LONGEST_STEP_S = 2.0
LEAST_STEPS = 6
"""Over fewer steps, healthy recorded flights (AR.Drone 2, stretches of its truth) show other lengths too."""
ENOUGH_STEPS = 15
"""Fewer steps must hold as much evidence: a motion larger by the root of what they lack."""
LEAST_TURN_RAD, LEAST_WAY_M = np.radians(1.0), 0.05
"""Root mean square of what the map does in a step: below it, noise hides the instrument's motion."""
ABOVE_NOISE = 2.0
"""Multiple of an attitude's nominal noise: an attitude three times as noisy still correlates."""
ALIKE, AGAINST = 0.5, -0.5
"""Correlations of one motion, and of one with its sign turned."""
FAR = 1.5
"""Gains of flow and sonar are within a fourth."""


def contradictions(flight: Flight, stamps_s: Array, w_T_b: Array, metric: bool) -> list[str]:
    """Return a line for each instrument whose motion differs from the map's.

    ``w_T_b`` (n, 4, 4) at ``stamps_s`` (n,), NaN where a keyframe is not in the map; ``metric``: whether its
    lengths are metres.
    """
    placed = np.isfinite(w_T_b).all(axis=(1, 2))
    at_s, poses = stamps_s[placed], w_T_b[placed]
    near = np.flatnonzero((np.diff(at_s) > 0) & (np.diff(at_s) <= LONGEST_STEP_S))
    if len(near) < LEAST_STEPS:
        return []
    begin_s, end_s = at_s[near], at_s[near + 1]
    w_R_b = Rotation.from_matrix(poses[:, :3, :3])
    first, last = w_R_b[near], w_R_b[near + 1]
    turned = (first.inv() * last).as_rotvec()
    span_s = (end_s - begin_s)[:, None]
    lines: list[str] = []
    if flight.imu is not None:
        read = _mean(flight.imu.stamps_s, flight.imu.gyro_rad_s, begin_s, end_s) * span_s
        lines += _contradiction("imu0 (gyro)", read, turned, LEAST_TURN_RAD) or _gain(
            "imu0 (gyro)", read, turned
        )
    if flight.attitude is not None:
        angles = np.unwrap(flight.attitude.roll_pitch_yaw_rad, axis=0)
        read = np.subtract(*(_at(flight.attitude.stamps_s, angles, at) for at in (end_s, begin_s)))
        made = np.diff(np.unwrap(roll_pitch_yaw_of(poses[:, :3, :3]), axis=0), axis=0)[near]
        noise_rad = np.sqrt(2.0) * max(flight.attitude.noise_std_rad)
        least = max(LEAST_TURN_RAD, ABOVE_NOISE * noise_rad)
        lines += _contradiction("attitude0 (roll, pitch)", read[:, :2], made[:, :2], least)
        lines += _contradiction("attitude0 (yaw)", read[:, 2:], made[:, 2:], least)
    if flight.velocity is not None:
        read = _mean(flight.velocity.stamps_s, flight.velocity.v_m_s, begin_s, end_s) * span_s
        half_way = first * Rotation.from_rotvec(0.5 * turned)
        level_R_w = Rotation.from_euler("z", -roll_pitch_yaw_of(half_way.as_matrix())[:, 2:])
        made = level_R_w.apply(np.diff(poses[:, :3, 3], axis=0)[near])[:, :2]
        lines += _contradiction("velocity0", read, made, LEAST_WAY_M, metric)
    return [*_common_cause(lines), *lines]


def _common_cause(lines: list[str]) -> list[str]:
    """Doubt the camera where several instruments contradict it: they hardly fail together."""
    streams = list(dict.fromkeys(line.split(" ")[0].rstrip(":") for line in lines))
    if len(streams) < 2:
        return []
    return [
        f"cam0: {' and '.join(streams)} contradict the pictures; check first which way the camera is mounted "
        "(T_BS), its intrinsics, and whether its pictures are mirrored, turned or in another order"
    ]


def _gain(who: str, read: Array, made: Array) -> list[str]:
    """Describe turns (n, 3) by a sensor that are in proportion to the map's, but of another size.

    The proportion is by least squares, to which a bias of the sensor adds nothing.
    """
    known = np.isfinite(read).all(axis=1)
    read, made = read[known], made[known]
    if len(read) < ENOUGH_STEPS or np.sqrt(np.mean((made**2).sum(axis=1))) < LEAST_TURN_RAD:
        return []
    times = float((read * made).sum() / (made**2).sum())
    if 1 / FAR < times < FAR:
        return []
    return [
        f"{who}: turns {times:.2g} times as far as the pictures show; check its unit (rad/s, not deg/s) and "
        "focal length and distortion of cam0"
    ]


def _contradiction(who: str, read: Array, made: Array, least: float, by_length: bool = False) -> list[str]:
    return list(_contradictions(who, read, made, least, by_length))


def _contradictions(who: str, read: Array, made: Array, least: float, by_length: bool) -> Iterator[str]:
    """Compare the readings of each step with the map's, both (n, c), and describe a contradiction."""
    known = np.isfinite(read).all(axis=1)
    read, made = read[known], made[known]
    if len(read) < LEAST_STEPS:
        return
    least *= np.sqrt(max(1.0, ENOUGH_STEPS / len(read)))
    if np.sqrt(np.mean((made**2).sum(axis=1))) < least:
        return
    of_read, of_made = float((read**2).sum()), float((made**2).sum())
    if of_read == 0.0:
        yield f"{who}: reads no motion while the pictures show some; check whether the sensor is stuck"
        return
    alike = float((read * made).sum()) / np.sqrt(of_read * of_made)
    further = np.sqrt(of_made / of_read)
    if alike < AGAINST:
        yield (
            f"{who}: opposite in sign to the motion seen in the pictures (correlation {alike:.2f}); "
            "check the axis signs in docs/flight-format.md"
        )
    elif alike < ALIKE:
        yield (
            f"{who}: does not match the motion seen in the pictures (correlation {alike:.2f}); check stamps, "
            "signs and axes, and the order of the pictures"
        )
    elif by_length and not 1 / FAR < further < FAR:
        yield (
            f"{who}: the path on the map is {further:.2g} times as long as this sensor says; check its unit, "
            "the focal length of cam0, and whether the height sensor is stuck or in another unit"
        )


def _at(stamps_s: Array, values: Array, at_s: Array) -> Array:
    """(m, c) between readings (n, c); NaN beyond them."""
    known = np.isfinite(values).all(axis=1)
    if known.sum() < 2:
        return np.full((len(at_s), values.shape[1]), np.nan)
    return np.column_stack(
        [np.interp(at_s, stamps_s[known], column, np.nan, np.nan) for column in values[known].T]
    )


def _mean(stamps_s: Array, values: Array, begin_s: Array, end_s: Array) -> Array:
    """(m, c) mean of readings (n, c) over each time, by trapezoids; NaN beyond them."""
    known = np.isfinite(values).all(axis=1)
    stamps_s, values = stamps_s[known], values[known]
    if len(stamps_s) < 2:
        return np.full((len(begin_s), values.shape[1]), np.nan)
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(stamps_s)[:, None]
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(steps, axis=0)])
    return (_at(stamps_s, sums, end_s) - _at(stamps_s, sums, begin_s)) / (end_s - begin_s)[:, None]
