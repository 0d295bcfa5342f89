"""Measurements by pictures of the floor, and the camera that took them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
    stated: tuple[float, ...] | None = None
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
class RowExposure:
    """Pictures of which the rows may be exposed one after the other, from the top to the bottom."""

    rows: int
    """Height of a picture in pixels."""
    readout_s: float | None
    """Time from the exposure of the first row to that of the last; None where nobody states it."""
    w_v_m_s: Array
    """(n, 3) velocity at each exposure, east, north and up, as the vehicle reports it; NaN without."""
    corrected_s: float = 0.0
    """Read-out time by which the pixels of the tracks are corrected already, in pictures with a known
    ``floor_speed``."""
    is_refuted: bool = False
    """Whether an earlier map has refuted the stated time, or 0 where none is stated. The time is then a
    variable from the start, with the initial value ``corrected_s``."""
    xy: Array | None = None
    """(4, 2) directions in the picture at depth 1."""
    floor_speed: Array | None = None
    """(n, 4, 2) speeds of what is seen in the directions ``xy`` of the frames of a video, at depth 1 per
    second, turns of the camera included; NaN where unknown. None for photographs."""

    @property
    def fixed_s(self) -> float:
        """Time that holds unless the pictures refute it."""
        return self.readout_s or 0.0

    def of_keyframes(self, members: Sequence[int]) -> RowExposure:
        """Return the same of some keyframes."""
        speed = None if self.floor_speed is None else self.floor_speed[list(members)]
        return replace(self, w_v_m_s=self.w_v_m_s[list(members)], floor_speed=speed)


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
class AlignedPair:
    """Keyframe ``j``, aligned with keyframe ``k`` by grey levels: a homography over the floor.

    Four points of j and their places in k give it. Lines leave directions open, in which the covariance is
    as large as the picture.
    """

    k: int
    j: int
    pixel: Array
    """(4, 2) undistorted pixel coordinates in j."""
    k_pixel: Array
    """(4, 2) the same points in k."""
    covariance: Array
    """(8, 8) of ``k_pixel``, px²."""

    @property
    def keyframes(self) -> tuple[int, int]:
        """Numbers of both keyframes."""
        return self.k, self.j

    def renumbered(self, number: Mapping[int, int]) -> AlignedPair:
        """Return the pair with other numbers of its keyframes: old -> new."""
        return replace(self, k=number[self.k], j=number[self.j])
