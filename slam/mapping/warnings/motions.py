"""Motions between neighbouring keyframes, on the map and by the other instruments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.flight import Flight
from slam.core.rotations import roll_pitch_yaw_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LONGEST_STEP_S = 2.0


@dataclass(frozen=True)
class StepMotion:
    """The motion of each step from one keyframe to the next, by an instrument and by the map."""

    who: str
    """Name of the instrument, and of the motion."""
    read: Array
    """(n, c) by the instrument, NaN where it has no reading; rad or m."""
    made: Array
    """(n, c) by the map."""
    lasts_s: Array
    """(n,) duration of each step."""
    is_way: bool = False
    """Whether it is a way on the ground (m), and not a turn (rad)."""
    noise: float = 0.0
    """Nominal standard deviation (rad or m) of the reading of a step, where it is known."""

    @property
    def stream(self) -> str:
        """Name of the stream: ``imu0``."""
        return self.who.split(" ")[0]


@dataclass(frozen=True)
class KeyframeSteps:
    """Steps between placed keyframes that follow each other closely."""

    keyframe: Index
    """(n, 2) the keyframes at both ends of each step."""
    motions: tuple[StepMotion, ...]

    @staticmethod
    def of(flight: Flight, stamps_s: Array, w_T_b: Array) -> KeyframeSteps:
        """Compare the poses ``w_T_b`` (n, 4, 4) at ``stamps_s`` (n,), NaN where a keyframe is not placed."""
        placed = np.flatnonzero(np.isfinite(w_T_b).all(axis=(1, 2)))
        at_s, poses = stamps_s[placed], w_T_b[placed]
        near = np.flatnonzero((np.diff(at_s) > 0) & (np.diff(at_s) <= LONGEST_STEP_S))
        keyframe = np.column_stack([placed[near], placed[near + 1]]).astype(np.int64)
        return KeyframeSteps(keyframe, tuple(_motions(flight, at_s, poses, near)) if len(near) else ())


def _motions(flight: Flight, at_s: Array, poses: Array, near: Index) -> list[StepMotion]:
    begin_s, end_s = at_s[near], at_s[near + 1]
    w_R_b = Rotation.from_matrix(poses[:, :3, :3])
    first, last = w_R_b[near], w_R_b[near + 1]
    turned = (first.inv() * last).as_rotvec()
    lasts_s = end_s - begin_s
    span_s = lasts_s[:, None]
    motions: list[StepMotion] = []
    if flight.imu is not None:
        read = _mean(flight.imu.stamps_s, flight.imu.gyro_rad_s, begin_s, end_s) * span_s
        motions.append(StepMotion("imu0 (gyro)", read, turned, lasts_s))
    if flight.attitude is not None:
        angles = np.unwrap(flight.attitude.roll_pitch_yaw_rad, axis=0)
        read = np.subtract(*(_at(flight.attitude.stamps_s, angles, at) for at in (end_s, begin_s)))
        made = np.diff(np.unwrap(roll_pitch_yaw_of(poses[:, :3, :3]), axis=0), axis=0)[near]
        noise_rad = np.sqrt(2.0) * max(flight.attitude.noise_std_rad)
        motions += [
            StepMotion("attitude0 (roll, pitch)", read[:, :2], made[:, :2], lasts_s, noise=noise_rad),
            StepMotion("attitude0 (yaw)", read[:, 2:], made[:, 2:], lasts_s, noise=noise_rad),
        ]
    if flight.velocity is not None:
        read = _mean(flight.velocity.stamps_s, flight.velocity.v_m_s, begin_s, end_s) * span_s
        half_way = first * Rotation.from_rotvec(0.5 * turned)
        level_R_w = Rotation.from_euler("z", -roll_pitch_yaw_of(half_way.as_matrix())[:, 2:])
        made = level_R_w.apply(np.diff(poses[:, :3, 3], axis=0)[near])[:, :2]
        motions.append(StepMotion("velocity0", read, made, lasts_s, is_way=True))
    return motions


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
