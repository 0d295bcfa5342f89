"""The inputs that every stage of the back end shares."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.range_evidence import RangePrior
from backend.measurements import ControlPoint
from frontend.camera import Camera
from slam.core.rotations import roll_pitch_yaw_of
from slam.mapping.config import PipelineConfig
from slam.mapping.control_points import Surveyed
from slam.mapping.gps.consensus import Agreement
from slam.mapping.keyframe_readings import KeyframeReadings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Setup:
    """Camera, instrument readings at the keyframes, and settings."""

    camera: Camera
    readings: KeyframeReadings
    config: PipelineConfig
    surveyed: tuple[Surveyed, ...] = ()
    """Surveyed points, those included that the map does not follow."""
    control: tuple[ControlPoint, ...] = ()
    """Points that the refinement follows."""

    def with_tilts(self, w_T_b: Array, covariances: Array) -> Setup:
        """Replace roll and pitch by those of refined poses (n, 4, 4), where their covariances are known."""
        known = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(w_T_b).all(axis=(1, 2))
        roll_pitch, std = self.readings.roll_pitch_rad.copy(), self.readings.roll_pitch_std_rad.copy()
        if known.any():
            roll_pitch[known] = roll_pitch_yaw_of(w_T_b[known, :3, :3])[:, :2]
            variance = np.maximum(covariances[known][:, [0, 1], [0, 1]], 0.0)
            std[known] = np.hypot(np.sqrt(variance), self.config.trust.attitude_floor_rad)
        readings = replace(self.readings, roll_pitch_rad=roll_pitch, roll_pitch_std_rad=std)
        return replace(self, readings=readings)

    def with_fixes(self, agreement: Agreement | None) -> Setup:
        """Return the same setup with those GPS fixes alone that agree with the map, if they were compared."""
        return self if agreement is None else replace(self, readings=self.readings.with_fixes(agreement))

    def without_heights(self) -> Setup:
        """Return the same setup without the barometer."""
        return replace(self, readings=replace(self.readings, heights=()))

    def with_range_prior(self, prior: RangePrior) -> Setup:
        """Return the same setup with gain and zero of the ranges known as well as ``prior`` says."""
        gain_std, zero_std_m = prior.gain_std, prior.zero_std_m
        readings = replace(self.readings, range_gain_std=gain_std, range_datum_std_m=zero_std_m)
        return replace(self, readings=readings)

    def with_control(self, used: NDArray[np.bool_]) -> Setup:
        """Return the same setup with the surveyed points in ``used`` (p,) as control points."""
        chosen = tuple(s.point for s, use in zip(self.surveyed, used, strict=True) if use)
        return replace(self, control=chosen)

    def without_positions(self) -> Setup:
        """Return the same setup without what places a map on Earth."""
        return replace(self, readings=replace(self.readings, positions=()), control=())
