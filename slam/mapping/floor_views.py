"""The place of each picture on the floor, as far as instruments alone tell the motion of the vehicle, and how
far that departs from the true motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from backend.measurements import GRAVITY_M_S2
from frontend.camera import Camera
from frontend.drift import DriftModel
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.core.rotations import rotation_of
from slam.mapping.config import PipelineConfig
from slam.mapping.keyframe_readings import KeyframeReadings

Array = NDArray[np.float64]

_TILT_WALK_RAD = 0.01
"""Random walk of the filter's tilt, per root second."""
_HEIGHT_M = 2.0
"""Height where none was measured. Pictures show speed over height alone: the speed of slow flight is then
half a height in a second."""
_ACCELERATION_M_S2, _JERK = 1.5, 3.0
"""Standard deviation and random walk per root second of the acceleration of a small vehicle at slow flight:
it tilts by up to 10 degrees, and back within a second."""


@dataclass(frozen=True)
class _Filtered:
    """Motion by the filter at the times of the frames."""

    w_T_b: Array
    """(f, 4, 4) poses."""
    speed_std_m_s: Array
    """(f,) larger standard deviation of the horizontal velocity along an axis."""


@dataclass(frozen=True)
class FloorViews:
    """Homographies from the pictures of a flight to the floor, as `frontend.line_tracking` needs them."""

    flight: Flight
    camera: Camera
    config: PipelineConfig

    def __call__(self, frame: int) -> Array:
        """Return the homography (3, 3) from undistorted pixels of a frame to the floor in metres."""
        return self.camera.floor_H_image(self._poses[frame])

    def stamp_s(self, frame: int) -> float:
        """Return the time of a frame."""
        assert self.flight.frames is not None
        return float(self.flight.frames.stamps_s[frame])

    @property
    def drift(self) -> DriftModel:
        """How the poses depart from the true ones. Without the filter all motion is such a departure."""
        trust, height_m = self.config.inertial, float(np.median(self._poses[:, 2, 3]))
        moves = self._filtered is not None
        return DriftModel(
            speed_std_m_s=trust.start_speed_m_s,
            acceleration_std_m_s2=trust.accel_offset_m_s2 if moves else _ACCELERATION_M_S2,
            acceleration_walk=GRAVITY_M_S2 * _TILT_WALK_RAD if moves else _JERK,
            place_std_m=height_m * trust.attitude_floor_rad,
        )

    @property
    def step_std_px(self) -> float:
        """Standard deviation of the displacement between successive pictures, of most of them; infinite where
        the filter does not tell the motion."""
        found = self._filtered
        if found is None:
            return np.inf
        assert self.flight.frames is not None
        step_std_m = found.speed_std_m_s[1:] * np.diff(self.flight.frames.stamps_s)
        return float(np.median(step_std_m * self.camera.focal_px[0] / found.w_T_b[1:, 2, 3]))

    @cached_property
    def _poses(self) -> Array:
        """(f, 4, 4) poses by the filter, or by readings of the tilt, heading and height above one place."""
        return self._read() if self._filtered is None else self._filtered.w_T_b

    @cached_property
    def _filtered(self) -> _Filtered | None:
        """The motion by the filter; None where too little was recorded."""
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
        found = np.asarray(states.w_T_b[nearest])
        of_speed = np.linalg.eigvalsh(states.motion_covariances[nearest, 3:5, 3:5])[:, -1]
        return _Filtered(found, np.sqrt(of_speed)) if (found[:, 2, 3] > 0).all() else None

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
        poses[:, 2, 3] = np.median(heights) if len(heights) else _HEIGHT_M
        for (k, _), height in zip(ranged, heights, strict=True):
            if height > 0:
                poses[k, 2, 3] = height
        return poses
