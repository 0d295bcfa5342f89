"""Measurements of single keyframes, and the pose of one relative to another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
    ground_m: float = 0.0
    """Distance by which ground above the floor's level shortens it, as far as the pictures show."""
    ground_std_m: float = 0.0
    """Standard deviation of ``ground_m``: at an edge, the beam may hear either side."""

    @property
    def to_level_m(self) -> float:
        """Distance along the beam to the level of the floor."""
        return self.range_m + self.ground_m

    @property
    def to_level_std_m(self) -> float:
        """Standard deviation of ``to_level_m``."""
        return float(np.hypot(self.std_m, self.ground_std_m))


@dataclass(frozen=True)
class Position:
    """Position of the antenna in the world at keyframe ``k`` (GPS after conversion).

    Its place on the body is `Measurements.antenna_m`.
    """

    k: int
    w_p_antenna_m: Array
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
