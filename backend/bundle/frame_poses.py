"""Pictures between the keyframes: each has a pose that its homography ties to its keyframe."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np
from gtsam.symbol_shorthand import F as FRAME
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.homography_factor import (
    POINTS,
    ROWS,
    ImagePlane,
    homography_factor,
    homography_whitening,
    place,
    transfer,
)
from backend.bundle.lens import FOCAL
from backend.bundle.pose_side_factors import PoseSideFactors
from backend.measurements import PinholeModel, TrackedFrame
from backend.robust import robust_unit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FramePoses:
    """Pictures between the keyframes, and the camera of a round."""

    frames: tuple[TrackedFrame, ...]
    plane: ImagePlane

    @staticmethod
    def of(frames: tuple[TrackedFrame, ...], camera: PinholeModel) -> FramePoses:
        """Return the pictures with the nominal camera."""
        return FramePoses(frames, ImagePlane(np.array(camera.focal_px), np.array(camera.center_px)))

    def calibrated(self, values: gtsam.Values) -> FramePoses:
        """Return the same with the focal lengths of the variables, where these are estimated."""
        if not values.exists(CALIBRATION(0)):
            return self
        return replace(self, plane=replace(self.plane, focal_px=values.atVector(CALIBRATION(0))[FOCAL]))

    @property
    def keys(self) -> list[int]:
        """Keys of their poses."""
        return [FRAME(number) for number in range(len(self.frames))]

    @cached_property
    def _rays(self) -> Array:
        return self.plane.rays(np.array([frame.pixel for frame in self.frames]).reshape(-1, POINTS, 2))

    @cached_property
    def _k_pixel(self) -> Array:
        return np.array([frame.k_pixel for frame in self.frames]).reshape(-1, ROWS)

    def _keyframes(self, values: gtsam.Values) -> Array:
        poses = [values.atPose3(POSE(frame.k)).matrix() for frame in self.frames]
        return np.array(poses).reshape(-1, 4, 4)

    def placed(self, values: gtsam.Values) -> gtsam.Values:
        """Return the variables with the poses that the homographies give."""
        poses = place(self._keyframes(values), self._rays, self._k_pixel, self.plane)
        out = gtsam.Values(values)
        for key, pose in zip(self.keys, poses, strict=True):
            out.insert(key, gtsam.Pose3(pose))
        return out

    def add(
        self,
        pose_side: PoseSideFactors,
        at: gtsam.Values,
        noise_factor: float,
    ) -> None:
        """Add the robust factors, for noise larger by a factor and the effect of the floor's slope at
        ``at``."""
        model = robust_unit(ROWS)
        f_T_j = np.array([at.atPose3(key).matrix() for key in self.keys]).reshape(-1, 4, 4)
        by_slope = transfer(self._keyframes(at), f_T_j, self._rays, self.plane).by_slope
        for number, frame in enumerate(self.frames):
            whitening = homography_whitening(noise_factor**2 * frame.covariance, by_slope[number])
            keys = POSE(frame.k), FRAME(number)
            rays, pixel = self._rays[number], self._k_pixel[number]
            factor = homography_factor(keys, rays, pixel, self.plane, whitening, model)
            pose_side.add("frame homography", factor)
