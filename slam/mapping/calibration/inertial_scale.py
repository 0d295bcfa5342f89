"""The metric scale from the accelerometer: the path at every frame compared with what it measured.

Keyframes alone are too few for that: a vehicle that hovers has one every few seconds, and accelerates in
between.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.bundle.problem import ScalePrior
from backend.bundle.refinement import Bundle
from backend.clocks.picture_clock import PictureClock, picture_clock
from backend.inertial_scale.scale import InertialScale, NoScale, inertial_scale
from backend.measurements import InertialReadings
from frontend.camera import Camera
from frontend.lift import lift
from slam.core.estimate import over_floor
from slam.core.imu_at_rest import NO_GRAVITY, GravityReading
from slam.core.messages import Message, warning
from slam.core.rotations import roll_pitch_yaw_of
from slam.mapping.front_end import Observations

Array = NDArray[np.float64]

_REFINED_RAD = 1e-3
"""Roll and pitch of a keyframe that was refined."""
_CONTRADICTED = 3.3
"""Standard deviations by which two instruments may differ on lengths: good ones do by more once in a thousand
flights."""
_HELPFUL = 3.0
"""Largest ratio to the map's own scale deviation at which the accelerometer is used: at this ratio it
sharpens the scale by a twentieth."""


@dataclass(frozen=True)
class AccelerometerScale:
    """Scale and bias from the accelerometer for a refined part of a map."""

    found: InertialScale
    lengths: ScalePrior
    """True ones over the map's, the accelerometer's own gains as uncertain as they are taken to be."""
    map_std: float | None
    """Relative deviation of the map's own scale; None if nothing else determines it."""

    @property
    def contradiction(self) -> Message | None:
        """In words, where the accelerometer contradicts the ranges, positions or velocity that tell the map's
        lengths; else None."""
        ratio, std = self.lengths.ratio, self.lengths.log_std
        if self.map_std is None or not abs(np.log(ratio)) > _CONTRADICTED * self.ratio_std:
            return None
        return warning(
            f"lengths by the accelerometer differ from the map's by {100 * (ratio - 1):+.0f} ± "
            f"{100 * std:.2g} %, though the map's are known to {100 * self.map_std:.2g} %: one of the "
            "instruments has a wrong scale",
            "the map's lengths are kept",
        )

    @property
    def ratio_std(self) -> float:
        """Relative deviation of the ratio of both lengths."""
        return float(np.hypot(self.lengths.log_std, self.map_std or 0.0))

    @property
    def share(self) -> float:
        """Weight of its lengths in those of a map that uses them beside its own."""
        if self.map_std is None:
            return 1.0
        return self.map_std**2 / (self.map_std**2 + self.lengths.log_std**2)

    @property
    def helps(self) -> bool:
        """Whether the map's scale would be known better with it."""
        return not self.contradiction and (
            self.map_std is None or self.lengths.log_std < _HELPFUL * self.map_std
        )


@dataclass(frozen=True)
class InertialComparison:
    """Results of comparing a refined part of a map with gyro and accelerometer."""

    clock: PictureClock | None
    scale: AccelerometerScale | NoScale


def velocity_contradicted(
    scale: AccelerometerScale | NoScale, gravity: GravityReading | None = None
) -> Message | None:
    """Return why a velocity that alone told a map's lengths cannot be right; None if it can be.

    An accelerometer whose reading of ``gravity`` is off may be the wrong one itself: it proves nothing.
    """
    if isinstance(scale, NoScale) or not scale.contradiction or gravity is not None:
        return None
    ratio, std = 1 / scale.lengths.ratio, scale.ratio_std
    return warning(
        f"velocity0 reads {ratio:.2f} (± {100 * std:.2g} %) times the speed that the accelerometer tells: it "
        "is left out of the map's lengths",
        "check its unit, scale_std in velocity0/sensor.yaml, and the unit and calibration of imu0",
    ).concerning("velocity0")


def compare_with_inertia(
    readings: InertialReadings,
    observations: Observations,
    members: NDArray[np.int64],
    bundle: Bundle,
    camera: Camera,
    gain_std: float,
    gravity: GravityReading | None,
) -> InertialComparison:
    """Compare refined keyframes ``members`` with gyro and accelerometer.

    The accelerometer is read at the times of the pictures on the gyro's clock, as far as that is known. The
    path is that of the camera: its unit is not the metre, in which the camera's place on the body is told.
    Readings in which ``gravity`` is missing tell no lengths.
    """
    mount, b_p_c_m = camera.b_T_c.copy(), camera.b_T_c[:3, 3]
    mount[:3, 3] = 0.0
    w_T_c = np.full((len(observations.stamps_s), 4, 4), np.nan)
    w_T_c[members] = over_floor(bundle.w_T_b, bundle.floor_slope_rad, bundle.floor_z_m)
    w_T_c[members, 2, 3] -= bundle.floor_z_m
    w_T_c[:, :3, 3] += w_T_c[:, :3, :3] @ b_p_c_m
    stamps_s, path, covariances = path_at_frames(observations, w_T_c, replace(camera, b_T_c=mount))
    if len(covariances) == 0:
        return InertialComparison(None, NoScale("no picture shows motion relative to its neighbours"))
    clock = picture_clock(stamps_s, path[:, :3, :3], np.zeros(len(stamps_s), np.int64), readings)
    if clock is not None:
        stamps_s = stamps_s - clock.delays_at(stamps_s)
        order = np.argsort(stamps_s, kind="stable")
        stamps_s, path = stamps_s[order], path[order]
    level_T = np.eye(4)
    level_T[:3, :3] = Rotation.from_rotvec([*bundle.floor_slope_rad, 0.0]).as_matrix()
    if gravity is not None and gravity.is_missing:
        return InertialComparison(clock, NoScale("; ".join(NO_GRAVITY)))
    found = inertial_scale(stamps_s, level_T @ path, readings, _typical(covariances), b_p_c_m)
    if isinstance(found, NoScale):
        return InertialComparison(clock, found)
    # Readings that are clipped act as a gain that is short by their share (Bussgang 1952, for normal ones).
    gain_std = float(np.hypot(gain_std, readings.accel_clipped))
    lengths = ScalePrior(found.scale, found.log_std(gain_std))
    return InertialComparison(clock, AccelerometerScale(found, lengths, bundle.scale_std))


def path_at_frames(observations: Observations, w_T_b: Array, camera: Camera) -> tuple[Array, Array, Array]:
    """Return times (m,) in order and poses (m, 4, 4) of keyframes and of the frames between them. Return
    also the covariances (l, 6, 6) of single pictures: of the frames between, or of the keyframes if there
    are none.

    ``w_T_b`` (n, 4, 4): of the keyframes, over a floor at z = 0; NaN where not placed.
    """
    placed = np.asarray(np.isfinite(w_T_b).all(axis=(1, 2)))
    frames, path = observations.frame_index[placed], w_T_b[placed]
    between = [p for p in observations.passed if placed[p.keyframe]]
    links = [link for link in observations.links if link is not None and placed[link.i]]
    k = np.array([p.keyframe for p in between] or [link.i for link in links], dtype=np.int64)
    seen = between or links
    lifted = lift(
        np.array([p.i_H_j for p in seen]).reshape(-1, 3, 3),
        np.array([p.corner_covariance for p in seen]).reshape(-1, 8, 8),
        camera,
        roll_pitch_yaw_of(w_T_b[k, :3, :3])[:, :2],
        np.full((len(k), 2), _REFINED_RAD),
    )
    height_m, good = w_T_b[k, 2, 3], np.flatnonzero(lifted.usable)
    i_T_j, covariances = lifted.scale(height_m, np.zeros_like(height_m))
    if between:
        frames = np.concatenate([frames, np.array([p.frame for p in between])[good]])
        path = np.concatenate([path, (w_T_b[k] @ i_T_j)[good]])
    stamps_s, first = np.unique(observations.frame_stamps_s[frames], return_index=True)
    return stamps_s, path[first], covariances[good]


def _typical(covariances: Array) -> Array:
    """(6, 6) mean of the half of (m, 6, 6) covariances whose size is nearest to the median."""
    by_size = np.argsort(np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2))
    quarter = len(by_size) // 4
    return np.asarray(covariances[by_size[quarter : len(by_size) - quarter]].mean(axis=0))
