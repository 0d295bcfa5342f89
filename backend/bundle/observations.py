"""The cost of the floor points: their observations with Huber's loss, and the priors on their places."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.exposure_motion import READOUT
from backend.bundle.lens import start_numbers
from backend.bundle.problem import BundleProblem, NoiseLevels
from backend.bundle.projections import linearise, residuals

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_ANYWHERE = 1e4
"""Standard deviation of a point's place on the floor, in mean heights: beyond the reach of any flight."""


@dataclass(frozen=True)
class Cameras:
    """Poses and calibration of the cameras at one linearisation point."""

    f_T_c: Array
    """(n, 4, 4) poses, in mean heights."""
    calibration: Array
    """(q,) numbers of the lens (`backend.bundle.projections`)."""
    readout_s: float = 0.0
    """Correction of the read-out time that the pixels have been corrected by."""

    @staticmethod
    def of(problem: BundleProblem, values: gtsam.Values) -> Cameras:
        """Read the cameras of a problem from its variables."""
        f_T_c = np.array([values.atPose3(POSE(k)).matrix() for k in range(problem.measurements.count)])
        calibrates = problem.self_calibrates
        lens = values.atVector(CALIBRATION(0)) if calibrates else start_numbers(problem.camera)
        return Cameras(f_T_c, lens, float(values.atVector(READOUT)[0]) if problem.estimates_readout else 0.0)


@dataclass(frozen=True)
class LinearObservations:
    """Whitened Jacobians and residuals of the floor points. Rows beyond Huber's limit have its weight."""

    of_pose: Array
    """(m, 2, 6) by the right perturbation of the pose, rotation first."""
    of_point: Array
    """(m, 2, 3)."""
    of_calibration: Array
    """(m, 2, q) by the numbers of the calibration, q = 0 if it is fixed, and by a free read-out time."""
    right: Array
    """(m, 2) minus the residuals."""
    prior_right: Array
    """(t, 3) minus the residuals of the priors on the points."""


@dataclass(frozen=True)
class FloorObservations:
    """The observations of a round, sorted by point."""

    number: Index
    """(m,) number of each among the observations of the tracks."""
    keyframe: Index
    """(m,)."""
    track: Index
    """(m,) point of each, ascending."""
    first: Index
    """(t + 1,) begin of each point's observations."""
    pixel: Array
    """(m, 2)."""
    std_px: Array
    """(m,)."""
    huber_sigmas: float
    prior_std: Array
    """(t, 3) standard deviations of the points about the origin: anywhere along the floor, and the relief of
    the ground or the height of what stands on it."""
    by_readout: Array | None = None
    """(m, 3) how far each camera has moved on at the row of the observation, for each second of a free
    read-out time; None where that is not free."""

    @staticmethod
    def of(problem: BundleProblem, noise: NoiseLevels, used: NDArray[np.bool_]) -> FloorObservations:
        """Collect the observations that are used, with the estimated noise levels."""
        tracks = problem.tracks
        number = np.flatnonzero(used)
        number = number[np.lexsort((tracks.keyframe[number], tracks.track[number]))]
        seen = np.bincount(tracks.track[number], minlength=int(tracks.track.max(initial=-1)) + 1)
        prior_std = np.full((len(seen), 3), _ANYWHERE)
        raised = problem.raised_of(len(seen))
        prior_std[:, 2] = height_stds(raised, noise) * np.where(raised, 1.0, noise.relief_inflation)
        motion, by_readout = problem.exposure_motion, None
        if motion is not None and motion.is_free:
            by_readout = motion.by_second[number]
        return FloorObservations(
            number=number,
            keyframe=np.asarray(tracks.keyframe[number], dtype=np.int64),
            track=np.asarray(tracks.track[number], dtype=np.int64),
            first=np.concatenate([[0], np.cumsum(seen)]),
            pixel=np.ascontiguousarray(tracks.pixel[number], dtype=float),
            std_px=tracks.std_px[number] * noise.pixel_scale,
            huber_sigmas=float(problem.config.huber_sigmas),
            prior_std=prior_std,
            by_readout=by_readout,
        )

    def residuals(self, cameras: Cameras, point: Array) -> Array:
        """Return projection minus pixel (m, 2) at poses and points (t, 3)."""
        point, track = self._as_seen(cameras, point)
        return np.asarray(
            residuals(cameras.f_T_c, point, cameras.calibration, self.keyframe, track, self.pixel)
        )

    def _as_seen(self, cameras: Cameras, point: Array) -> tuple[Array, Index]:
        """Return points and the number of that of each observation.

        A camera that has moved on sees a point as if the point had moved back.
        """
        if self.by_readout is None:
            return point, self.track
        return point[self.track] - cameras.readout_s * self.by_readout, np.arange(len(self.track))

    def whitened(self, cameras: Cameras, point: Array) -> Array:
        """Return the same over the pixel noise."""
        return self.residuals(cameras, point) / self.std_px[:, None]

    def error(self, cameras: Cameras, point: Array) -> float:
        """Return the sum of Huber's loss of the observations and half the squares of the priors."""
        found = self.whitened(cameras, point)
        distance = np.hypot(found[:, 0], found[:, 1])
        cut = np.minimum(distance, self.huber_sigmas)
        priors = 0.5 * float(np.sum((point / self.prior_std) ** 2))
        return float(np.sum(cut * (distance - 0.5 * cut))) + priors

    def linearise(self, cameras: Cameras, point: Array, self_calibrates: bool) -> LinearObservations:
        """Linearise the observations at poses and points (t, 3)."""
        count = len(self.track)
        of_pose, of_point = np.empty((count, 2, 6)), np.empty((count, 2, 3))
        of_calibration = np.empty((count, 2, cameras.calibration.size if self_calibrates else 0))
        seen, track = self._as_seen(cameras, point)
        right = linearise(
            cameras.f_T_c, seen, cameras.calibration, self.keyframe, track, self.pixel,
            self.std_px, self.huber_sigmas, of_pose, of_point, of_calibration,
        )  # fmt: skip
        if self.by_readout is not None:
            of_readout = -(of_point @ self.by_readout[:, :, None])
            of_calibration = np.concatenate([of_calibration, of_readout], axis=2)
        return LinearObservations(of_pose, of_point, of_calibration, right, -point / self.prior_std)


def height_stds(raised: NDArray[np.bool_], noise: NoiseLevels) -> Array:
    """Return the standard deviations (t,) of the heights of points, some of which stand above the ground."""
    return np.where(raised, noise.structure, noise.relief)
