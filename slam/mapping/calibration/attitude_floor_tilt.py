"""A constant tilt between the attitude sensor and the floor seen in the pictures, and where it comes from.

Sloping ground tilts towards one side of the world; a camera mounted askew, or an attitude with a wrong zero,
towards one side of the body. A vehicle that turns shows which of the two it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.bundle.problem import LARGEST_SLOPE_RAD
from backend.bundle.residual_spread import autocorrelated_std
from slam.core.flight import Flight
from slam.core.messages import Message, warning
from slam.core.rotations import rotation_of
from slam.mapping.keyframe_readings import attitudes_at
from slam.mapping.map import Map

Array = NDArray[np.float64]

LEAST_KEYFRAMES = 8
NOTABLE_RAD = np.radians(2.0)
"""Smallest tilt that is reported: the zero of an attitude is seldom better than a degree."""
SURE = 4.0
"""Significance of a reported tilt, in standard deviations."""
ZERO_STDS = 2.0
"""A tilt within so many stated deviations may be that of the zero: it is as good as the readings, no better.
Those of a gimbal are assumed to be good to 2 degrees."""
CLEARLY = 2.0
"""So many times steadier in the world's axes than in the body's, or the other way round; larger than what
the attitude wanders about it."""


@dataclass(frozen=True)
class AttitudeFloorTilt:
    """Upward direction of the attitude minus that of the floor: the level components, in rad."""

    in_world: Array
    """(2,) on average, in the map's axes."""
    in_body: Array
    """(2,) on average, forward and left."""
    world_std: float
    body_std: float
    wander: float
    """Root mean square about ``in_body``, an axis."""

    @property
    def turns_with_body(self) -> bool:
        """Whether it clearly does; neither this nor ``stays_in_world`` where the heading hardly changes."""
        return self.world_std > CLEARLY * self.body_std

    @property
    def stays_in_world(self) -> bool:
        """Whether it clearly stays where it is when the vehicle turns."""
        return self.body_std > CLEARLY * self.world_std

    @property
    def is_too_large(self) -> bool:
        """Whether neither ground nor a usual mount lean so far, beyond the tilt's own uncertainty."""
        size, std = self.steadier
        return size > LARGEST_SLOPE_RAD + SURE * std

    @property
    def steadier(self) -> tuple[float, float]:
        """Size, and its standard deviation, in the axes in which it is the steadier."""
        mean = self.in_world if self.world_std <= self.body_std else self.in_body
        return float(np.linalg.norm(mean)), min(self.world_std, self.body_std)


def attitude_floor_tilt(flight: Flight, stamps_s: Array, w_T_b: Array) -> AttitudeFloorTilt | None:
    """Estimate the tilt over a level floor from poses (n, 4, 4), NaN where not placed.

    Return None where too few keyframes have an attitude.
    """
    placed = np.isfinite(w_T_b).all(axis=(1, 2))
    readings = attitudes_at(flight.attitude, stamps_s[placed], 0.0) if flight.attitude is not None else ()
    if len(readings) < LEAST_KEYFRAMES:
        return None
    w_R_b = w_T_b[placed][[a.k for a in readings], :3, :3]
    roll_pitch = np.array([[*a.roll_pitch_yaw_rad[:2], 0.0] for a in readings])
    b_up = rotation_of(roll_pitch)[:, 2]
    # Over a slope the upward direction of the attitude points uphill.
    in_world = np.einsum("nab,nb->na", w_R_b, b_up)[:, :2]
    heading = np.arctan2(w_R_b[:, 1, 0], w_R_b[:, 0, 0])
    in_body = Rotation.from_euler("z", -heading[:, None]).apply(np.pad(in_world, ((0, 0), (0, 1))))[:, :2]
    means = [tilt.mean(axis=0) for tilt in (in_world, in_body)]
    stds = [
        autocorrelated_std(tilt - mean) / np.sqrt(len(readings))
        for tilt, mean in zip((in_world, in_body), means, strict=True)
    ]
    wander = float(np.sqrt(np.mean((in_body - means[1]) ** 2)))
    return AttitudeFloorTilt(means[0], means[1], stds[0], stds[1], wander)


def tilt_over_map(flight: Flight, map_: Map) -> AttitudeFloorTilt | None:
    """Return the tilt over the floor of a map; None in a joint map: each flight may have its own."""
    if flight.parts:
        return None
    return attitude_floor_tilt(flight, map_.observations.stamps_s, map_.of_main(map_.w_T_b))


def attitude_floor_tilt_warning(tilt: AttitudeFloorTilt | None) -> Message | None:
    """In words, where that is notable: a map without positions takes the ground for level. Else None."""
    if tilt is None:
        return None
    size, std = tilt.steadier
    if size < max(NOTABLE_RAD, SURE * std):
        return None
    where, cause = "", "the ground slopes, or the camera's mounting (T_BS) or the attitude is off"
    if tilt.stays_in_world:
        uphill = np.degrees(np.arctan2(tilt.in_world[1], tilt.in_world[0]))
        where = f" towards {uphill:+.0f}° in the map whatever the heading"
        cause = "the ground slopes, or wind disturbs it"
    elif tilt.turns_with_body:
        where = " towards one side of the body whatever the heading"
        cause = "its zero or the camera's mounting (T_BS) is off"
    return warning(
        f"attitude0 is tilted by {np.degrees(size):.1f}° against the floor seen in the pictures{where}: "
        f"{cause}",
        "roll and pitch are trusted only as far as they agree with the map",
        "the map assumes level ground: horizontal distances stay right, but if it slopes, heights may be "
        "wrong",
        "check what attitude0 reads with the vehicle level: if roll and pitch are not 0 there, calibrate "
        "its level, else compare T_BS in cam0/sensor.yaml with how the camera is mounted, and until then "
        "measure heights on the ground yourself",
    ).concerning("attitude0")
