"""Measurements that the back end accepts, as frozen dataclasses over numpy.

Conventions, defined only here:

* ``a_T_b`` is a (4, 4) rigid transform that takes coordinates in b to coordinates in a.
* Covariances of poses are 6x6, **rotation first** (rad, then m), of a right perturbation in body
  axes: ``w_T_b = w_T_b_hat Exp(xi)`` with ``xi = (rotation, translation)``. This is gtsam's order.
* World ``w``: z up, the mean floor at ``z = floor_z`` (0 by default).
  Body ``b``: x forward, y left, z up.
* Keyframes are numbered 0..n-1 in order of time; every measurement names them by that number.

Only numpy and `backend.aligned_pair` are imported, so that the front end can use this module without the
rest of the back end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from backend.aligned_pair import AlignedPair

Array = NDArray[np.float64]

GRAVITY_M_S2 = 9.80665
"""Standard acceleration of gravity."""
EdgeKind = Literal["odometry", "loop", "inertial"]


@dataclass(frozen=True)
class RelativePose:
    """Pose of keyframe ``j`` relative to keyframe ``i``."""

    i: int
    j: int
    i_T_j: Array
    """(4, 4), metres."""
    covariance: Array
    """(6, 6), rotation first, right perturbation of ``i_T_j``."""
    kind: EdgeKind


@dataclass(frozen=True)
class Attitude:
    """Roll, pitch, yaw of the body at keyframe ``k``: ``R_wb = Rz(yaw) Ry(pitch) Rx(roll)``."""

    k: int
    roll_pitch_yaw_rad: Array
    """(3,)."""
    std_rad: Array
    """(3,) standard deviation per axis; ``inf`` for an axis that was not measured."""


@dataclass(frozen=True)
class SlantRange:
    """Distance from the rangefinder to the floor along its -z axis at keyframe ``k``."""

    k: int
    range_m: float
    std_m: float
    b_T_s: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) pose of the rangefinder on the body."""


@dataclass(frozen=True)
class Position:
    """Position of the body origin in the world at keyframe ``k`` (GPS after conversion)."""

    k: int
    w_p_b_m: Array
    """(3,)."""
    std_m: Array
    """(3,) standard deviation per axis; ``inf`` for an axis that was not measured."""


@dataclass(frozen=True)
class BarometerHeight:
    """Height of the body by its barometer at keyframe ``k``, above an unknown level."""

    k: int
    height_m: float
    std_m: float


@dataclass(frozen=True)
class ControlPoint:
    """A surveyed point of the ground, and where the pictures show it."""

    name: str
    w_p_m: Array
    """(3,) place in the world."""
    std_m: Array
    """(3,) standard deviation of the survey along each axis; ``inf`` for an axis that was not surveyed."""
    keyframe: NDArray[np.int64]
    """(m,) number of each keyframe that shows it."""
    pixel: Array
    """(m, 2) pixel coordinates as recorded, with the distortion of the lens."""
    std_px: float
    """Standard deviation of each coordinate."""

    def of_keyframes(self, number: Mapping[int, int]) -> ControlPoint:
        """Return the point with the views from some keyframes, which are renumbered: old -> new."""
        mine = np.array([k in number for k in self.keyframe.tolist()], dtype=bool)
        keyframe = np.array([number[k] for k in self.keyframe[mine].tolist()], dtype=np.int64)
        return replace(self, keyframe=keyframe, pixel=self.pixel[mine])


LensModel = Literal["brown", "equidistant"]
"""Models of a lens: radial and tangential distortion of a pinhole (Brown 1966), or an equidistant fisheye
(Kannala and Brandt 2006; OpenCV's fisheye)."""


@dataclass(frozen=True)
class PinholeModel:
    """Mounting and projection of a camera with distortion, and how well each number is known.

    Pixel coordinates follow OpenCV (the centre of the first pixel is (0, 0)) and are those of the recorded
    picture. A standard deviation of 0 holds the numbers that it belongs to; others are estimated.
    """

    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    b_T_c: Array
    """(4, 4)."""
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """OpenCV's (k1, k2, p1, p2, k3), or (k1, k2, k3, k4) of an equidistant fisheye."""
    focal_std_ratio: float = 0.0
    """Relative standard deviation of the focal length."""
    aspect_std_ratio: float = 0.0
    """Relative standard deviation of either focal length about what both have in common."""
    center_std_px: float = 0.0
    """Standard deviation of the principal point along either axis."""
    radial_std: float = 0.0
    """Standard deviation of k1, k2, k3 and k4."""
    tangential_std: float = 0.0
    """Standard deviation of p1 and p2."""
    mount_std_rad: float = 0.0
    """Standard deviation of the mount's tilt about the camera's x and y; 0 fixes the mount."""
    lens: LensModel = "brown"
    told: tuple[float, ...] | None = None
    """(fx, fy, cx, cy) and coefficients about which the deviations are; None: they are about those above."""


@dataclass(frozen=True)
class FloorTracks:
    """Floor points seen from several keyframes: one row per observation."""

    keyframe: NDArray[np.int64]
    """(m,) number of the keyframe that saw the point."""
    track: NDArray[np.int64]
    """(m,) number of the point, 0..t-1; each has two observations or more."""
    pixel: Array
    """(m, 2) pixel coordinates as recorded, with the distortion of the lens."""
    std_px: Array
    """(m,) standard deviation of each coordinate."""

    def of_keyframes(self, members: Sequence[int], count: int) -> FloorTracks:
        """Return the observations from some of ``count`` keyframes; keyframes and points are renumbered."""
        number = np.full(count, -1, dtype=np.int64)
        number[list(members)] = np.arange(len(members))
        mine = number[self.keyframe] >= 0
        _, track = np.unique(self.track[mine], return_inverse=True)
        return FloorTracks(number[self.keyframe[mine]], track, self.pixel[mine], self.std_px[mine])


@dataclass(frozen=True)
class TrackedFrame:
    """A picture between keyframes, registered to keyframe ``k`` by a homography over the floor.

    The homography is given by four points of the picture and their places in the keyframe.
    """

    k: int
    stamp_s: float
    pixel: Array
    """(4, 2) undistorted pixel coordinates in the picture."""
    k_pixel: Array
    """(4, 2) the same points in the keyframe."""
    covariance: Array
    """(8, 8) of ``k_pixel``, px²."""


@dataclass(frozen=True)
class InertialReadings:
    """Gyro and accelerometer in body axes; finite, in order of time."""

    stamps_s: Array
    """(k,)."""
    gyro_rad_s: Array
    """(k, 3)."""
    accel_m_s2: Array
    """(k, 3)."""


@dataclass(frozen=True)
class InertialNoise:
    """Noise and unknown constants of gyro and accelerometer, as standard deviations."""

    gyro_density: float = 1.5e-3
    """White noise, rad/s/sqrt(Hz)."""
    accel_density: float = 5.0e-2
    """m/s²/sqrt(Hz)."""
    gyro_walk: float = 1e-4
    """Random walk of the bias, rad/s²/sqrt(Hz)."""
    accel_walk: float = 1e-3
    """m/s³/sqrt(Hz)."""
    gyro_offset_rad_s: float = 0.02
    accel_offset_m_s2: float = 0.3
    gain_ratio: float = 0.02
    """Error of the accelerometer's gain on each axis. Half of its variance is common to all axes."""
    gyro_gain_ratio: float = 0.03
    """Relative error of the gains of the gyro: the tolerance of common sensors (InvenSense MPU-6050 product
    specification 3.4, section 6.1)."""
    arm_m: float = 0.1
    """Error of the position of the accelerometer on the body, on each axis."""
    delay_s: float = 0.0125
    """Delay of the keyframes' stamps behind the readings."""


@dataclass(frozen=True)
class Inertial:
    """Readings of an IMU, to be integrated between the pictures."""

    readings: InertialReadings
    noise: InertialNoise = InertialNoise()
    b_p_imu_m: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) nominal position of the accelerometer in body axes."""
    invalid_s: Array = field(default_factory=lambda: np.zeros(0))
    """Increasing times of readings that are wrong, such as saturated ones."""


class ReportedNoise(NamedTuple):
    """Errors of velocity forward, velocity left and yaw rate: white noise, and an error that fades.

    The error that fades is a Gauss-Markov process. The tuples hold one number for each of the three.
    """

    density: tuple[float, float, float]
    """White noise, m/s/sqrt(Hz) twice and rad/s/sqrt(Hz)."""
    error: tuple[float, float, float]
    """Standard deviation of the error that fades, m/s twice and rad/s."""
    time_s: tuple[float, float, float]
    """Its correlation time."""


NO_REPORTED_NOISE = ReportedNoise((0.0,) * 3, (0.0,) * 3, (1.0,) * 3)


@dataclass(frozen=True)
class ReportedMotion:
    """Readings, finite and in order of time, and their assumed errors."""

    stamps_s: Array
    """(k,) times of the velocities."""
    v_m_s: Array
    """(k, 2) forward and left in level axes along the heading."""
    yaw_stamps_s: Array
    yaw_rad: Array
    """(l,) without jumps by whole turns."""
    noise: ReportedNoise
    """Nominal noise, where the pictures tell too little."""
    gain_std: float = 0.1
    """Relative error that all velocities along an axis share."""
    bias_m_s: float = 0.06
    """Standard deviation of a constant error of the velocity, on each axis."""
    drift_rad_s: float = 0.02
    """Standard deviation of a constant drift of the yaw."""
    lag_s: float = 0.1
    """Standard deviation of the time by which the velocities are late."""
    tells_turns: bool = True
    """Whether the changes of yaw are measurements; false where a gyro tells them, from which they come."""


@dataclass(frozen=True)
class Measurements:
    """All measurements of a flight's keyframes: the input of the back end."""

    stamps_s: Array
    """(n,) times of the keyframes on the flight's clock."""
    relative_poses: tuple[RelativePose, ...] = ()
    attitudes: tuple[Attitude, ...] = ()
    ranges: tuple[SlantRange, ...] = ()
    positions: tuple[Position, ...] = ()
    heights: tuple[BarometerHeight, ...] = ()
    control: tuple[ControlPoint, ...] = ()
    tracks: FloorTracks | None = None
    camera: PinholeModel | None = None
    inertial: Inertial | None = None
    reported: ReportedMotion | None = None
    frames: tuple[TrackedFrame, ...] = ()
    """Pictures between keyframes at which motion by instruments is compared, in order of time."""
    aligned: tuple[AlignedPair, ...] = ()
    range_gain_std: float = 0.05
    """Relative standard deviation of the scale error that all ranges share (temperature, calibration)."""
    range_datum_std_m: float = 0.02
    """Standard deviation of the zero offset that all ranges share."""
    antenna_m: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) point of the body that ``positions`` belong to."""
    antenna_std_m: float = 0.0
    """Its standard deviation along each body axis; 0 holds it."""
    names: tuple[str, ...] = field(default=())
    """Name of each keyframe in messages; empty: its number."""
    length_unit: str = "m"
    """Name of the unit of all lengths in messages. Without a metric measurement it is another one."""

    @property
    def count(self) -> int:
        """Number of keyframes."""
        return len(self.stamps_s)

    @property
    def placed(self) -> bool:
        """Whether positions or control points place the map in the world."""
        return bool(self.positions or self.control)

    def of_keyframes(self, members: Sequence[int]) -> Measurements:
        """Return the measurements of some keyframes alone, numbered in the order of ``members`` (m,).

        What names another keyframe is left out. Inertial readings and reported motion belong to no keyframe
        and stay.
        """
        number = {k: place for place, k in enumerate(members)}
        return replace(
            self,
            stamps_s=self.stamps_s[list(members)],
            relative_poses=tuple(
                replace(e, i=number[e.i], j=number[e.j])
                for e in self.relative_poses
                if e.i in number and e.j in number
            ),
            tracks=None if self.tracks is None else self.tracks.of_keyframes(members, self.count),
            names=tuple(self.names[k] for k in members) if self.names else (),
            attitudes=tuple(replace(a, k=number[a.k]) for a in self.attitudes if a.k in number),
            ranges=tuple(replace(r, k=number[r.k]) for r in self.ranges if r.k in number),
            positions=tuple(replace(p, k=number[p.k]) for p in self.positions if p.k in number),
            heights=tuple(replace(h, k=number[h.k]) for h in self.heights if h.k in number),
            control=tuple(c for c in (c.of_keyframes(number) for c in self.control) if len(c.keyframe)),
            aligned=tuple(a.renumbered(number) for a in self.aligned if set(a.keyframes) <= number.keys()),
            frames=tuple(replace(f, k=number[f.k]) for f in self.frames if f.k in number),
        )
