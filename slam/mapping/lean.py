"""By how much the attitude leans against the floor all along, and whose fault that is.

Ground that slopes leans to one side of the world, a camera that is mounted askew to one side of the body: a
vehicle that turns tells them apart. An attitude whose zero is off does so too, but the accelerometer knows
nothing of that zero: what leans against the floor with both of them is the camera.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.bundle.noise import coloured_std
from backend.bundle.refinement import Bundle
from backend.measurements import GRAVITY_M_S2
from frontend.camera import Camera
from slam.estimate import MountTilt
from slam.flight import Flight
from slam.mapping.lengths import InertialLengths
from slam.mapping.synchronize import attitudes_at

Array = NDArray[np.float64]

LEAST_KEYFRAMES = 8
_NOTABLE_RAD = np.radians(2.0)
"""A lean that is worth a word: an attitude's zero is seldom better than a degree."""
_SURE = 4.0
"""Standard deviations by which a lean must differ from none."""
_CLEARLY = 2.0
"""So many times steadier in the world's axes than in the body's, or the other way round; larger than what
the attitude wanders about it."""
_FREE_RAD = 0.1
"""Uncertainty of a mount that was told wrong."""


@dataclass(frozen=True)
class Lean:
    """What the attitude has for upwards, less what the floor has; rad, the level parts of it."""

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
        """Whether it clearly does; neither this nor ``turns_not`` where the heading hardly changes."""
        return self.world_std > _CLEARLY * self.body_std

    @property
    def turns_not(self) -> bool:
        """Whether it clearly stays where it is when the vehicle turns."""
        return self.body_std > _CLEARLY * self.world_std

    @property
    def steadier(self) -> tuple[float, float]:
        """Size, and its standard deviation, in the axes in which it is the steadier."""
        mean = self.in_world if self.world_std <= self.body_std else self.in_body
        return float(np.linalg.norm(mean)), min(self.world_std, self.body_std)


def lean_of(flight: Flight, stamps_s: Array, w_T_b: Array) -> Lean | None:
    """The lean over a level floor; None where too few of the keyframes (n, 4, 4), NaN where not placed, have
    an attitude."""
    placed = np.isfinite(w_T_b).all(axis=(1, 2))
    told = attitudes_at(flight.attitude, stamps_s[placed], 0.0) if flight.attitude is not None else ()
    if len(told) < LEAST_KEYFRAMES:
        return None
    w_R_b = w_T_b[placed][[a.k for a in told], :3, :3]
    roll_pitch = np.array([[0.0, *a.roll_pitch_yaw_rad[1::-1]] for a in told])
    b_up = Rotation.from_euler("ZYX", roll_pitch).as_matrix()[:, 2]
    # What the attitude has for upwards leans uphill where the ground slopes.
    in_world = np.einsum("nab,nb->na", w_R_b, b_up)[:, :2]
    heading = np.arctan2(w_R_b[:, 1, 0], w_R_b[:, 0, 0])
    in_body = Rotation.from_euler("z", -heading[:, None]).apply(np.pad(in_world, ((0, 0), (0, 1))))[:, :2]
    means = [lean.mean(axis=0) for lean in (in_world, in_body)]
    stds = [
        coloured_std(lean - mean) / np.sqrt(len(told))
        for lean, mean in zip((in_world, in_body), means, strict=True)
    ]
    wander = float(np.sqrt(np.mean((in_body - means[1]) ** 2)))
    return Lean(means[0], means[1], stds[0], stds[1], wander)


def lean_told(lean: Lean | None) -> str:
    """In words, where that is notable: a map without positions takes the ground for level. Else empty."""
    if lean is None:
        return ""
    size, std = lean.steadier
    if size < max(_NOTABLE_RAD, _SURE * std):
        return ""
    where, cause = "", "the ground slopes, the camera's mount leans or the attitude is off"
    if lean.turns_not:
        uphill = np.degrees(np.arctan2(lean.in_world[1], lean.in_world[0]))
        where = f" towards {uphill:+.0f}° in the map whatever the heading"
        cause = "the ground slopes or wind misleads it"
    elif lean.turns_with_body:
        where = " towards one side of the body whatever the heading"
        cause = "its zero or the camera's mount is off"
    return (
        f"attitude0 leans {np.degrees(size):.1f}° against the floor{where}: {cause}; "
        "the map takes the ground for level"
    )


def remounted(camera: Camera, lean: Lean | None, by_inertia: InertialLengths | None) -> Camera | None:
    """The camera with its mount turned by the lean and free, where attitude and accelerometer agree that it
    is the mount that leans; else None."""
    if lean is None or by_inertia is None or not lean.turns_with_body:
        return None
    size = float(np.linalg.norm(lean.in_body))
    if size < max(_SURE * lean.body_std, _CLEARLY * lean.wander):
        return None
    # Read in axes that lean, gravity looks like an offset.
    leaning = GRAVITY_M_S2 * lean.in_body
    found = np.array(by_inertia.found.offset_m_s2[:2])
    std = float(np.max(by_inertia.found.offset_std_m_s2[:2]))
    if np.linalg.norm(found - leaning) > np.linalg.norm(leaning) / 2 or std > np.linalg.norm(leaning) / _SURE:
        return None
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([-lean.in_body[1], lean.in_body[0], 0.0]).as_matrix()
    mount = turn @ camera.b_T_c
    mount[:3, 3] = camera.b_T_c[:3, 3]
    return replace(camera, b_T_c=mount, mount_std_rad=max(camera.mount_std_rad, _FREE_RAD))


def mount_tilt(told: Camera, bundle: Bundle | None) -> MountTilt | None:
    """How the refinement found the mount against what was told of it; None where it was held."""
    if bundle is None or bundle.mount_std_rad == 0.0:
        return None
    turn = Rotation.from_matrix(bundle.b_T_c[:3, :3] @ told.b_T_c[:3, :3].T).as_rotvec()
    rows = tuple(tuple(float(x) for x in row) for row in bundle.b_T_c)
    return MountTilt((float(turn[0]), float(turn[1])), bundle.mount_std_rad, rows)


def mount_told(tilt: MountTilt | None) -> str:
    """In words, where the mount was found to lean; else empty."""
    if tilt is None:
        return ""
    size = float(np.linalg.norm(tilt.tilt_rad))
    if size < _SURE * tilt.std_rad:
        return ""
    rows = ", ".join(f"{x:.5g}" for row in tilt.b_T_c for x in row)
    return (
        f"cam0 is {np.degrees(size):.1f} ± {np.degrees(tilt.std_rad):.1g}° askew by floor and instruments: "
        f"taken out of the map; for other programs write T_BS data: [{rows}] "
        "into cam0/sensor.yaml"
    )
