"""The problem of a refinement: its measurements, its settings, its noise and its variables."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.bundle.exposure_motion import ExposureMotion
from backend.bundle.factors import MOUNT, WORLD, rotation_of
from backend.bundle.inertial.graph import NOMINAL_INERTIAL_NOISE, InertialNoiseFactors, InertialPart
from backend.bundle.reported.graph import ReportedPart
from backend.bundle.world import WorldTransform
from backend.measurements import NO_REPORTED_NOISE, FloorTracks, Measurements, PinholeModel, ReportedNoise
from backend.robust import huber_limit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BundleConfig:
    """Settings of the refinement."""

    rounds: int = 10
    """Maximum number of solves. The noise of each kind of measurement is estimated again between two solves,
    until it converges. Camera calibration starts with the second solve."""
    huber_sigmas: float = huber_limit(2)
    drop_sigmas: float = 6.0
    """Observations with a larger residual are dropped between rounds, and counted."""
    slope_std_rad: float = 0.05
    """Least standard deviation of the slope of the ground, which only positions observe: a larger one is
    estimated from the slope."""
    start_relief: float = 0.01
    """Initial standard deviation of the floor's relief over the mean height."""


LARGEST_SLOPE_RAD = 3 * BundleConfig.slope_std_rad
"""Slope of the ground that is no error: three standard deviations of its prior."""


@dataclass(frozen=True)
class NoiseLevels:
    """Standard deviations estimated from the residuals."""

    pixel_scale: float
    """Factor on the observations' std_px."""
    relief: float
    """Standard deviation of the floor's relief over the mean height."""
    roll_pitch_rad: float
    position_m: Array
    """(3,)."""
    range_m: float
    slope_rad: float
    """Standard deviation of the slope of the ground along either axis: no noise, but estimated like one."""
    relief_inflation: float = 1.0
    """Factor on the relief in the prior of a point on the ground, since neighbours rise and fall together:
    the root of their design effect (`backend.bundle.relief_correlation`)."""
    structure: float = 1.0
    """Standard deviation of the heights of what stands on the ground, over the mean height."""
    height_m: float = np.inf
    """Height by a barometer."""
    control: float = 1.0
    """Factor on the stated deviations of the control points' survey."""
    marks: float = 1.0
    """Factor on the deviation of their marks in the pictures."""
    inertial: InertialNoiseFactors = NOMINAL_INERTIAL_NOISE
    reported: ReportedNoise = NO_REPORTED_NOISE

    @property
    def height_prior(self) -> float:
        """Standard deviation of the prior on the height of a point on the ground, over the mean height."""
        return self.relief * self.relief_inflation


@dataclass(frozen=True)
class ScalePrior:
    """Prior on the scale from another source than ranges and positions."""

    ratio: float
    """True lengths over those of the initial guess."""
    log_std: float


@dataclass(frozen=True)
class BundleProblem:
    """Fixed inputs of a round."""

    measurements: Measurements
    tracks: FloorTracks
    camera: PinholeModel
    config: BundleConfig
    self_calibrates: bool
    scale_prior: ScalePrior | None = None
    inertial: InertialPart | None = None
    reported: ReportedPart | None = None
    raised: NDArray[np.bool_] | None = None
    """(t,) floor points that stand above the ground, at heights of their own; None for none."""
    exposure_motion: ExposureMotion | None = None
    """How the cameras moved while rows were read; None where all rows count as exposed at once."""

    @property
    def has_structure(self) -> bool:
        """Whether floor points stand above the ground."""
        return self.raised is not None and bool(self.raised.any())

    def raised_of(self, points: int) -> NDArray[np.bool_]:
        """Return the same (t,) for a number of ``points``."""
        return np.zeros(points, bool) if self.raised is None else self.raised

    @property
    def estimates_readout(self) -> bool:
        """Whether the read-out time of a rolling shutter is a variable."""
        return self.exposure_motion is not None and self.exposure_motion.is_free

    @property
    def has_lengths(self) -> bool:
        """Whether ranges, positions or a prior observe the scale: better than any motion does."""
        measured = self.measurements
        return bool(measured.ranges or measured.placed) or self.scale_prior is not None

    @property
    def has_scale(self) -> bool:
        """Whether a measurement or prior observes the scale."""
        moved = self.inertial is not None or self.reported is not None
        return self.has_lengths or moved or bool(self.measurements.heights)

    @property
    def c_T_b(self) -> Array:
        """Transform from body to camera coordinates, by the nominal mount."""
        return se3.inverse(self.camera.b_T_c)

    def transform(self, values: gtsam.Values) -> WorldTransform:
        """Return the transform from camera poses in mean heights to metric poses of the body."""
        return WorldTransform.of(values, self.camera.b_T_c)

    def b_T_c(self, values: gtsam.Values) -> Array:
        """Return the transform from camera to body coordinates, by the estimated mount."""
        rotation = np.eye(4)
        rotation[:3, :3] = rotation_of(values.atVector(WORLD), MOUNT)
        return np.asarray(self.camera.b_T_c @ rotation)


@dataclass(frozen=True)
class Variables:
    """All variables of a refinement."""

    values: gtsam.Values
    """Those of the pose side."""
    point: Array
    """(t, 3) floor points, in mean heights."""
