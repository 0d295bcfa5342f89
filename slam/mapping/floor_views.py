"""The place of each picture on the floor, as far as instruments alone tell the motion of the vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from frontend.camera import Camera
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.core.rotations import rotation_of
from slam.mapping.config import PipelineConfig
from slam.mapping.keyframe_readings import KeyframeReadings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FloorViews:
    """Homographies from the pictures of a flight to the floor."""

    flight: Flight
    camera: Camera
    config: PipelineConfig

    def __call__(self, frame: int) -> Array:
        """Return the homography (3, 3) from undistorted pixels of a frame to the floor in metres."""
        return self.camera.floor_H_image(self._poses[frame])

    @cached_property
    def _poses(self) -> Array:
        """(f, 4, 4) poses by the filter, or by readings of the tilt, heading and height above one place."""
        read, filtered = self._read(), self._filtered()
        if filtered is None or not (filtered[:, 2, 3] > 0).all():
            return read
        return filtered

    def _filtered(self) -> Array | None:
        """Return poses (f, 4, 4) by the filter; None where too little was recorded."""
        from slam.inertial.motion import filter_motion
        from slam.inertial.noise_identification import identify_noise

        assert self.flight.frames is not None
        at_s = self.flight.frames.stamps_s
        try:
            inputs = identify_noise(self.flight, self.config.inertial, silent, at_s, ())
            inside = (at_s >= inputs.start_s) & (at_s <= inputs.end_s)
            if not inside.any() or inputs.readings.range_m is None:
                return None
            states = filter_motion(inputs, at_s[inside]).smoothed
        except (InputError, BackendError):
            return None
        assert states is not None
        nearest = np.clip(np.cumsum(inside) - 1, 0, int(inside.sum()) - 1)
        return np.asarray(states.w_T_b[nearest])

    def _read(self) -> Array:
        """Return poses (f, 4, 4) above the origin. What was not read is level, without a turn, or at the
        median height."""
        assert self.flight.frames is not None
        stamps_s = self.flight.frames.stamps_s
        readings = KeyframeReadings.at(self.flight, stamps_s, None, self.config)
        angles = np.zeros((len(stamps_s), 3))
        for attitude in readings.attitudes:
            angles[attitude.k] = attitude.roll_pitch_yaw_rad
        poses = np.tile(np.eye(4), (len(stamps_s), 1, 1))
        poses[:, :3, :3] = rotation_of(angles)
        ranged = [
            (r.k, (poses[r.k, :3, :3] @ r.b_T_s[:3] @ [0, 0, r.range_m, -1])[2]) for r in readings.ranges
        ]
        heights = np.array([height for _, height in ranged])
        poses[:, 2, 3] = np.median(heights) if len(heights) else 1.0
        for (k, _), height in zip(ranged, heights, strict=True):
            if height > 0:
                poses[k, 2, 3] = height
        return poses
