"""Motions between neighbouring keyframes, on the map and by the other instruments."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.measurements import SlantRange
from backend.preintegration.integrals import integrate
from slam.core.flight import Flight
from slam.core.instrument_readings import MAX_GAP_S
from slam.core.rotations import roll_pitch_yaw_of
from slam.core.streams import Imu
from slam.mapping.keyframe_readings import heights_at, ranges_at
from slam.mapping.obstacles import poses_between

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LONGEST_STEP_S = 2.0
GYRO = "imu0 (gyro)"


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
    """Whether it is a way (m), and not a turn (rad)."""
    noise: float = 0.0
    """Nominal standard deviation (rad or m) of the reading of a step, where it is known."""
    gain: float | None = None
    """Ratio of the reading to the motion of the map; None where the steps have to tell it."""
    is_judged_as_whole: bool = True
    """Whether the readings as a whole show the motion of the map. Ranges do not: the floor has steps too."""
    by_acceleration: bool = False
    """Whether it is integrated twice: noise makes it longer, and the step before has a part in it."""

    def only(self, chosen: NDArray[np.bool_]) -> StepMotion:
        """Return the motion in some of the steps, ``chosen`` (n,)."""
        return replace(self, read=self.read[chosen], made=self.made[chosen], lasts_s=self.lasts_s[chosen])

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
    metric: bool
    """Whether the map's lengths are metres."""

    @staticmethod
    def of(flight: Flight, stamps_s: Array, w_T_b: Array, metric: bool) -> KeyframeSteps:
        """Compare the poses ``w_T_b`` (n, 4, 4) at ``stamps_s`` (n,), NaN where a keyframe is not placed.

        ``metric``: whether the map's lengths are metres. Only then are changes of height compared.
        """
        placed = np.flatnonzero(np.isfinite(w_T_b).all(axis=(1, 2)))
        at_s, poses = stamps_s[placed], w_T_b[placed]
        near = np.flatnonzero((np.diff(at_s) > 0) & (np.diff(at_s) <= LONGEST_STEP_S))
        keyframe = np.column_stack([placed[near], placed[near + 1]]).astype(np.int64)
        if not len(near):
            return KeyframeSteps(keyframe, (), metric)
        motions = _motions(flight, at_s, poses, near)
        if metric:
            motions += _climbs(flight, at_s, poses, near)
        return KeyframeSteps(keyframe, tuple(motions), metric)

    def only(self, chosen: NDArray[np.bool_]) -> KeyframeSteps:
        """Return some of the steps, ``chosen`` (n,)."""
        return replace(
            self, keyframe=self.keyframe[chosen], motions=tuple(one.only(chosen) for one in self.motions)
        )


def _motions(flight: Flight, at_s: Array, poses: Array, near: Index) -> list[StepMotion]:
    begin_s, end_s = at_s[near], at_s[near + 1]
    w_R_b = Rotation.from_matrix(poses[:, :3, :3])
    first, last = w_R_b[near], w_R_b[near + 1]
    turned = (first.inv() * last).as_rotvec()
    lasts_s = end_s - begin_s
    span_s = lasts_s[:, None]
    motions: list[StepMotion] = []
    if flight.imu is not None:
        b_gyro = flight.imu.gyro_rad_s @ flight.imu.b_T_s[:3, :3].T
        read = _mean(flight.imu.stamps_s, b_gyro, begin_s, end_s) * span_s
        motions.append(StepMotion(GYRO, read, turned, lasts_s))
    if flight.attitude is not None:
        angles = np.unwrap(flight.attitude.roll_pitch_yaw_rad, axis=0)
        read = np.subtract(*(_at(flight.attitude.stamps_s, angles, at) for at in (end_s, begin_s)))
        made = np.diff(np.unwrap(roll_pitch_yaw_of(poses[:, :3, :3]), axis=0), axis=0)[near]
        read = made + np.angle(np.exp(1j * (read - made)))  # half a turn to the left is one to the right
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


def _climbs(flight: Flight, at_s: Array, poses: Array, near: Index) -> list[StepMotion]:
    """Return the changes of height by each instrument that measures heights or vertical accelerations."""
    height_m, lasts_s = poses[:, 2, 3], np.diff(at_s)[near]
    falls = [(one.k, _fall(one, poses), one.std_m) for one in ranges_at(flight.sonar, at_s, 0.0)]
    heights = [(one.k, one.height_m, one.std_m) for one in heights_at(flight.barometer, at_s, 0.0)]
    motions: list[StepMotion] = []
    for who, readings in (("sonar0 (height)", falls), ("barometer0 (height)", heights)):
        if readings:
            number, value, std_m = zip(*readings, strict=True)
            read = np.full(len(at_s), np.nan)
            read[list(number)] = value
            motions.append(
                StepMotion(
                    who,
                    np.diff(read)[near, None],
                    np.diff(height_m)[near, None],
                    lasts_s,
                    is_way=True,
                    noise=np.sqrt(2.0) * float(np.median(std_m)),
                    gain=1.0,
                    is_judged_as_whole=False,
                )
            )
    if flight.imu is not None:
        by_acceleration = _second_differences(at_s, _heights_by_acceleration(flight.imu, at_s, poses))
        known = np.isfinite(flight.imu.accel_m_s2).all(axis=1)
        lost = _crosses_gap(flight.imu.stamps_s[known], at_s[:-1], at_s[1:])
        by_acceleration[lost | np.append(False, lost[:-1])] = np.nan
        read = by_acceleration[near, None]
        made = _second_differences(at_s, height_m)[near, None]
        who = "imu0 (vertical acceleration)"
        motions.append(StepMotion(who, read, made, lasts_s, is_way=True, gain=1.0, by_acceleration=True))
    return motions


def _fall(one: SlantRange, poses: Array) -> float:
    """Return how far below the body the floor is by one range."""
    w_T_s = poses[one.k] @ one.b_T_s
    return float(one.range_m * w_T_s[2, 2] - (w_T_s[2, 3] - poses[one.k, 2, 3]))


def _heights_by_acceleration(imu: Imu, at_s: Array, poses: Array) -> Array:
    """Return (m,) the heights at ``at_s`` by integrated accelerations, but for an unknown height and speed.

    The mean acceleration over the flight is zero, which takes out gravity and a constant bias.
    """
    known = np.flatnonzero(np.isfinite(imu.accel_m_s2).all(axis=1))
    before, after = np.searchsorted(imu.stamps_s[known], at_s[[0, -1]]).tolist()
    known = known[max(before - 1, 0) : after + 1]
    stamps_s = imu.stamps_s[known]
    if len(stamps_s) < 2:
        return np.full(len(at_s), np.nan)
    w_T_b = poses_between(at_s, poses, np.clip(stamps_s, at_s[0], at_s[-1]))
    upward = np.einsum("nj,nj->n", (w_T_b[:, :3, :3] @ imu.b_T_s[:3, :3])[:, 2], imu.accel_m_s2[known])
    upward -= upward.mean()
    # The first and the last reading stand for the moments just before and after them.
    ends_s = np.clip(at_s[[0, -1]], stamps_s[0] - MAX_GAP_S, stamps_s[-1] + MAX_GAP_S)
    stamps_s = np.concatenate(
        [np.minimum(ends_s[:1], stamps_s[0]), stamps_s, np.maximum(ends_s[1:], stamps_s[-1])]
    )
    upward = np.pad(upward, 1, mode="edge")
    speed = integrate(stamps_s, upward[:, None])
    return _at(stamps_s, integrate(stamps_s, speed), at_s)[:, 0]


def _second_differences(at_s: Array, height_m: Array) -> Array:
    """Return (m - 1,) what each step climbs beyond the speed of the step before; NaN for the first.

    An unknown height and speed have no part in it.
    """
    lasts_s, climbed = np.diff(at_s), np.diff(height_m)
    beyond = np.full(len(climbed), np.nan)
    near = lasts_s[:-1] <= LONGEST_STEP_S
    beyond[1:][near] = (climbed[1:] - climbed[:-1] * lasts_s[1:] / lasts_s[:-1])[near]
    return beyond


def _at(stamps_s: Array, values: Array, at_s: Array) -> Array:
    """(m, c) between readings (n, c); NaN beyond them, and within a gap."""
    known = np.isfinite(values).all(axis=1)
    if known.sum() < 2:
        return np.full((len(at_s), values.shape[1]), np.nan)
    found = _interpolated(stamps_s[known], values[known], at_s)
    found[_crosses_gap(stamps_s[known], at_s, at_s)] = np.nan
    return found


def _interpolated(stamps_s: Array, values: Array, at_s: Array) -> Array:
    """(m, c) between finite readings (n, c); NaN beyond them."""
    return np.column_stack([np.interp(at_s, stamps_s, column, np.nan, np.nan) for column in values.T])


def _mean(stamps_s: Array, values: Array, begin_s: Array, end_s: Array) -> Array:
    """(m, c) mean of readings (n, c) over each time, by trapezoids; NaN beyond them and across a gap."""
    known = np.isfinite(values).all(axis=1)
    stamps_s, values = stamps_s[known], values[known]
    if len(stamps_s) < 2:
        return np.full((len(begin_s), values.shape[1]), np.nan)
    sums = integrate(stamps_s, values)
    begin, end = (_interpolated(stamps_s, sums, at_s) for at_s in (begin_s, end_s))
    mean = (end - begin) / (end_s - begin_s)[:, None]
    mean[_crosses_gap(stamps_s, begin_s, end_s)] = np.nan
    return mean


def _crosses_gap(stamps_s: Array, begin_s: Array, end_s: Array) -> NDArray[np.bool_]:
    """Return (m,) whether a moment of each time is farther from all readings than `MAX_GAP_S` and than the
    usual interval between them."""
    lasts_s = np.diff(stamps_s)
    far_s = max(MAX_GAP_S, float(np.median(lasts_s)) if len(lasts_s) else 0.0)
    gap = np.flatnonzero(lasts_s > 2 * far_s)
    lost_from_s, lost_to_s = stamps_s[gap] + far_s, stamps_s[gap + 1] - far_s
    return np.asarray(((begin_s[:, None] < lost_to_s) & (end_s[:, None] > lost_from_s)).any(axis=1))
