"""How long a metre is: the path at every frame, held against the accelerometer.

Keyframes alone are too few for that: a vehicle that hovers has one every few seconds, and accelerates in
between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.bundle.graph import ScalePrior
from backend.bundle.refinement import Bundle
from backend.inertial_scale import InertialScale, inertial_scale
from backend.preintegration import InertialReadings
from frontend.camera import Camera
from frontend.lift import lift
from slam.estimate import over_floor
from slam.mapping.sightings import Sightings

Array = NDArray[np.float64]

_REFINED_RAD = 1e-3
"""Roll and pitch of a keyframe that was refined."""
_CONTRADICTED = 4.0
"""Standard deviations by which two instruments may differ on lengths."""
_HELPFUL = 3.0
"""What is known so many times worse than the map's scale would sharpen it by a twentieth."""


@dataclass(frozen=True)
class InertialLengths:
    """What the accelerometer tells of a refined part of a map."""

    found: InertialScale
    lengths: ScalePrior
    """True ones over the map's, the accelerometer's own gain as uncertain as it is taken to be."""
    map_std: float | None
    """Relative, of the map's scale; None where nothing else tells it."""

    @property
    def contradiction(self) -> str:
        """In words, where ranges or positions and the accelerometer cannot all be right; else empty."""
        ratio, std = self.lengths.ratio, self.lengths.log_std
        if self.map_std is None or not abs(np.log(ratio)) > _CONTRADICTED * np.hypot(std, self.map_std):
            return ""
        return (
            f"the accelerometer has lengths {100 * (ratio - 1):+.0f} ± {100 * std:.2g} % off the map's, "
            f"known to {100 * self.map_std:.2g} %: one instrument is off; lengths stay as they were"
        )

    @property
    def helps(self) -> bool:
        """Whether the map's scale would be known better with it."""
        believed = not self.contradiction
        return believed and (self.map_std is None or self.lengths.log_std < _HELPFUL * self.map_std)


def inertial_lengths(
    readings: InertialReadings,
    sightings: Sightings,
    members: NDArray[np.int64],
    bundle: Bundle,
    camera: Camera,
    gain_std: float,
) -> InertialLengths | None:
    """Hold the refined keyframes ``members`` against the accelerometer; None where it tells nothing."""
    w_T_b = np.full((len(sightings.stamps_s), 4, 4), np.nan)
    w_T_b[members] = over_floor(bundle.w_T_b, bundle.floor_slope_rad, bundle.floor_z_m)
    w_T_b[members, 2, 3] -= bundle.floor_z_m
    stamps_s, path = path_at_frames(sightings, w_T_b, camera)
    lean = np.eye(4)
    lean[:3, :3] = Rotation.from_rotvec([*bundle.floor_slope_rad, 0.0]).as_matrix()
    found = inertial_scale(stamps_s, lean @ path, readings)
    if found is None:
        return None
    std = float(np.hypot(found.scale_std / found.scale, gain_std))
    return InertialLengths(found, ScalePrior(found.scale, std), bundle.scale_std)


def path_at_frames(sightings: Sightings, w_T_b: Array, camera: Camera) -> tuple[Array, Array]:
    """Times (m,) in order and poses (m, 4, 4) of keyframes and of the frames between them.

    ``w_T_b`` (n, 4, 4): of the keyframes, over a floor at z = 0; NaN where not placed.
    """
    placed = np.isfinite(w_T_b).all(axis=(1, 2))
    between = [p for p in sightings.passed if np.isfinite(w_T_b[p.keyframe]).all()]
    frames, path = sightings.frame_index[placed], w_T_b[placed]
    if between:
        k = np.array([p.keyframe for p in between])
        lifted = lift(
            np.array([p.i_H_j for p in between]),
            np.array([p.corner_covariance for p in between]),
            camera,
            Rotation.from_matrix(w_T_b[k, :3, :3]).as_euler("ZYX")[:, [2, 1]],
            np.full((len(k), 2), _REFINED_RAD),
        )
        height_m, good = w_T_b[k, 2, 3], np.flatnonzero(lifted.usable)
        i_T_j = lifted.scale(height_m, np.zeros_like(height_m))[0]
        frames = np.concatenate([frames, np.array([p.frame for p in between])[good]])
        path = np.concatenate([path, (w_T_b[k] @ i_T_j)[good]])
    stamps_s, first = np.unique(sightings.frame_stamps_s[frames], return_index=True)
    return stamps_s, path[first]
