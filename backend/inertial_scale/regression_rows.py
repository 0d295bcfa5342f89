"""Linear regression of the accelerometer's displacement on a visual path, in rows of independent noise.

Over a segment of a few seconds the specific force, rotated to the world, less gravity and integrated twice,
is the displacement of the accelerometer, up to an unknown initial position and velocity. It equals the scale
times the path of the camera, plus the rotated lever arm from the camera to the accelerometer, plus the
effect of the accelerometer's offset, plus that of a floor that slopes, on which the path's z is not up: it is
linear in nine parameters. A lever arm of five centimetres matters: if a vehicle sways once a second, it
causes a fifth of the acceleration. So does a slope: taken for level, 2 degrees change lengths by 8 %.

Source: Martinelli 2014 (IJCV 106), sections 3 and 4, for the linear system; Fuller 1987, Measurement Error
Models, section 2.3, for regressors that err together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, null_space

from backend.measurements import GRAVITY_M_S2, InertialReadings
from backend.preintegration.integrals import covered, dense, gaps, integrate_twice, interpolate_attitudes

Array = NDArray[np.float64]

SEGMENT_S = (1.0, 4.0)
"""Limits of a segment's duration; in longer ones the integrated noise exceeds the displacement."""
_TARGET_SEGMENTS, _MAX_SEGMENTS, MIN_SEGMENTS = 12, 60, 8
"""Numbers of segments; short flights have shorter segments."""
MIN_POSES = 8
_MAX_GAP_S = 0.5
LEAST_GAP_S = 0.1
"""Longest time without a reading that is never a gap."""
MIN_SPACING_S = 0.05
"""Smallest spacing of poses: closer ones share their errors and add no information at 1 Hz."""
PRIOR = np.diag(np.array([0.0, *[3.0**-2] * 3, *[0.3**-2] * 3, *[0.02**-2] * 2]))
"""Prior information of scale, offset [m/s²], arm [m] and slope of the floor [rad], for a vehicle that hardly
rotates or moves. Paved ground falls by up to 2 % to drain (AASHTO 2018, Geometric Design, section 4.2.2)."""
SIZE = len(PRIOR)
"""Number of parameters."""


@dataclass(frozen=True)
class RegressionRows:
    """Linear system of all segments: ``displacement = regressors @ (scale, offset, arm, slope) + noise``.

    Initial position and velocity are projected out, and the noise is independent between rows.
    """

    segment: NDArray[np.int64]
    """(r,) number of the segment."""
    white_noise: Array
    """(r,) variance of unit white noise integrated twice."""
    random_walk: Array
    """(r,) variance of a unit random walk of the pose error."""
    displacement: Array
    """(r, 3)."""
    regressors: Array
    """(r, 3, 9)."""
    regressor_noise: Array
    """(3, 9, 9) nominal covariance of the regressors' noise in each axis."""
    expected: Array
    """(9,) mean of the parameters' prior: the arm leads to the body's origin, where an IMU is."""

    def pose_variance(self, noise: Array) -> Array:
        """Return the variance (r,) of pose errors over the nominal one: white noise plus random walk."""
        alone, random_walk = np.exp(2 * noise[1:])
        return np.asarray(alone + random_walk * self.random_walk)

    def weight(self, parameters: Array, noise: Array) -> Array:
        """Return weights (r, 3) for ``noise`` (3,): logarithms of force noise [m/s²/sqrt(Hz)], of white pose
        noise over the nominal one, and of its random walk per root second."""
        force = np.exp(2 * noise[0]) * self.white_noise
        poses = self.pose_variance(noise)[:, None] * (self.regressor_noise @ parameters @ parameters)
        return np.asarray(1 / (force[:, None] + poses))

    def residuals(self, parameters: Array) -> Array:
        """Return residuals (r, 3) for scale, offset, arm and slope."""
        return np.asarray(self.displacement - self.regressors @ parameters)

    def whitened(self, parameters: Array, noise: Array) -> Array:
        """Return whitened residuals (3r + 9,): those of the rows and those of the prior."""
        residuals = np.sqrt(self.weight(parameters, noise)) * self.residuals(parameters)
        return np.concatenate([residuals.ravel(), np.sqrt(np.diag(PRIOR)) * (parameters - self.expected)])

    def jacobian(self, parameters: Array, noise: Array) -> Array:
        """Return the Jacobian (3r + 9, 9) of ``whitened``: the noise grows with the parameters, too."""
        root = np.sqrt(self.weight(parameters, noise))[..., None]
        growing = self.pose_variance(noise)[:, None, None] * (self.regressor_noise @ parameters)
        jacobian = -root * self.regressors - root**3 * self.residuals(parameters)[..., None] * growing
        return np.concatenate([jacobian.reshape(-1, SIZE), np.sqrt(PRIOR)])

    def fit_at_scale(self, scale: float, noise: Array) -> Array:
        """Return parameters (9,) for a scale, with the best others for the noise of a short arm."""
        short = np.zeros(SIZE)
        short[0] = scale
        information, weighted = self._of_others(self.weight(short, noise))
        prior = (PRIOR @ self.expected)[1:]
        short[1:] = np.linalg.solve(information, weighted @ self.residuals(short).ravel() + prior)
        return short

    def log_determinant(self, parameters: Array, noise: Array) -> float:
        """Return the log-determinant term of the noise likelihood, all but the scale marginalised."""
        weight = self.weight(parameters, noise)
        return float(np.linalg.slogdet(self._of_others(weight)[0])[1] - np.log(weight).sum())

    def _of_others(self, weight: Array) -> tuple[Array, Array]:
        """Return the information (8, 8) about all but the scale, and their weighted regressors (8, 3r)."""
        others = self.regressors[..., 1:]
        weighted = (weight[..., None] * others).reshape(-1, SIZE - 1).T
        return weighted @ others.reshape(-1, SIZE - 1) + PRIOR[1:, 1:], weighted


@dataclass(frozen=True)
class PathAndReadings:
    """Visual path, inertial readings, and the segments over which they are compared."""

    stamps_s: Array
    w_T_c: Array
    """(n, 4, 4) places of the camera, with the axes of the body."""
    readings: InertialReadings
    segments: Sequence[slice]
    regressor_noise: Array
    expected: Array
    """As `RegressionRows` has them."""

    @cached_property
    def contrasts(self) -> list[tuple[Array, Array, Array]]:
        """Contrasts (r, m) of each segment's poses that cancel initial position and velocity.

        With each come its variances (r,) under unit white noise integrated twice, and integrated once.
        """
        contrasts = []
        for segment in self.segments:
            t = self.stamps_s[segment] - self.stamps_s[segment.start]
            early, late = np.minimum.outer(t, t), np.maximum.outer(t, t)
            free = null_space(np.column_stack([np.ones_like(t), t]).T)
            white_noise, axes = eigh(free.T @ (early**2 * (3 * late - early) / 6) @ free)
            contrast = (free @ axes).T
            random_walk = np.einsum("rm,mn,rn->r", contrast, early, contrast)
            contrasts.append((contrast, np.maximum(white_noise, 0.0), random_walk))
        return contrasts

    def rows(self, lag_s: float = 0.0) -> RegressionRows:
        """Return the rows of all segments, if the accelerometer lags the gyro by ``lag_s`` seconds."""
        displacement, regressors = [], []
        for segment, (contrast, *_) in zip(self.segments, self.contrasts, strict=True):
            one_displacement, one_regressors = self._segment_rows(segment, lag_s)
            displacement.append(contrast @ one_displacement)
            regressors.append(np.tensordot(contrast, one_regressors, axes=1))
        count = [len(white_noise) for _, white_noise, _ in self.contrasts]
        white_noise, random_walk = (np.concatenate([one[k] for one in self.contrasts]) for k in (1, 2))
        return RegressionRows(
            np.repeat(np.arange(len(count)), count),
            white_noise,
            random_walk,
            np.concatenate(displacement),
            np.concatenate(regressors),
            self.regressor_noise,
            self.expected,
        )

    def gain_sensitivity(self, lag_s: float = 0.0) -> Array:
        """Return (r, 3, 3) derivatives of the displacement by the gain of each axis of the accelerometer."""
        added = []
        for segment, (contrast, *_) in zip(self.segments, self.contrasts, strict=True):
            at_s, imu_s, w_R_b, force = self._readings_between(segment, lag_s)
            added.append(np.tensordot(contrast, integrate_twice(imu_s, w_R_b * force[:, None], at_s), axes=1))
        return np.concatenate(added)

    def at_half_rate(self) -> PathAndReadings:
        """Return the same with means of two successive readings each, as a sensor of half the rate averages.

        First and last reading are kept, and the means do not reach over gaps.
        """
        read = self.readings
        pairs = np.arange(1, len(read.stamps_s) - 2, 2)
        pairs = pairs[~gaps(read.stamps_s, LEAST_GAP_S)[pairs]]

        def means(values: Array) -> Array:
            return np.concatenate([values[:1], (values[pairs] + values[pairs + 1]) / 2, values[-1:]])

        halved = InertialReadings(means(read.stamps_s), means(read.gyro_rad_s), means(read.accel_m_s2))
        return replace(self, readings=halved)

    @cached_property
    def _dense(self) -> InertialReadings:
        """Readings with further ones between slow ones."""
        read = self.readings
        both = np.hstack([read.gyro_rad_s, read.accel_m_s2])
        times_s, values = dense(read.stamps_s, both, LEAST_GAP_S)
        return InertialReadings(times_s, values[:, :3], values[:, 3:])

    def _segment_rows(self, segment: slice, lag_s: float) -> tuple[Array, Array]:
        """Return displacement (m, 3) and regressors (m, 3, 9) of a segment."""
        at_s, imu_s, w_R_b, b_force = self._readings_between(segment, lag_s)
        force = np.einsum("kab,kb->ka", w_R_b, b_force) - [0, 0, GRAVITY_M_S2]
        twice = integrate_twice(imu_s, np.concatenate([force[..., None], w_R_b], axis=-1), at_s)
        w_T_c = self.w_T_c[segment]
        path = w_T_c[:, :3, 3:] - w_T_c[0, :3, 3:]
        # Gravity along x and y of a floor that slopes.
        drawn = 0.5 * GRAVITY_M_S2 * (at_s - at_s[0])[:, None, None] ** 2 * np.eye(3)[:, :2]
        return twice[..., 0], np.concatenate([path, twice[..., 1:], w_T_c[:, :3, :3], drawn], axis=-1)

    def _readings_between(self, segment: slice, lag_s: float) -> tuple[Array, Array, Array, Array]:
        """Return pose times (m,), and times (k,), attitudes (k, 3, 3) and specific force (k, 3) of the
        readings around them."""
        at_s, readings = self.stamps_s[segment], self._dense
        # One reading at or before the first pose, and one at or after the last.
        first = int(np.searchsorted(readings.stamps_s, at_s[0], side="right")) - 1
        last = int(np.searchsorted(readings.stamps_s, at_s[-1])) + 1
        imu_s = readings.stamps_s[first:last]
        turned = self.w_T_c[segment, :3, :3]
        w_R_b = interpolate_attitudes(at_s, turned, imu_s, readings.gyro_rad_s[first:last])
        force = [np.interp(imu_s + lag_s, readings.stamps_s, axis) for axis in readings.accel_m_s2.T]
        return at_s, imu_s, w_R_b, np.column_stack(force)


def find_segments(stamps_s: Array, imu_s: Array) -> list[slice]:
    """Find segments of poses without a gap in poses or readings, the first and last reading included."""
    whole = covered(imu_s, stamps_s, LEAST_GAP_S) & (np.diff(stamps_s) <= _MAX_GAP_S)
    runs = np.split(np.arange(len(stamps_s)), np.flatnonzero(~whole) + 1)
    runs = [run for run in runs if len(run) >= MIN_POSES]
    lasts_s = sum(float(stamps_s[run[-1]] - stamps_s[run[0]]) for run in runs)
    stretch_s = float(np.clip(lasts_s / _TARGET_SEGMENTS, *SEGMENT_S))
    found = []
    for run in runs:
        count = int((stamps_s[run[-1]] - stamps_s[run[0]]) / stretch_s + 1e-9)
        ends = np.searchsorted(stamps_s[run], stamps_s[run[0]] + stretch_s * np.arange(count + 1))
        found += [slice(run[0] + a, run[0] + b) for a, b in pairwise(ends.tolist())]
    found = [s for s in found if s.stop - s.start >= MIN_POSES]
    some = np.unique(np.linspace(0, len(found) - 1, min(_MAX_SEGMENTS, len(found))).round().astype(int))
    return [found[k] for k in some.tolist()]


def regressor_covariance(covariance: Array) -> Array:
    """Return the covariance (3, 9, 9) of the nine regressors of one row, per axis, from that of a pose.

    The vehicle turns about the vertical: both horizontal axes get the mean of the two.
    """
    columns = np.zeros((3, SIZE, 6))
    columns[:, 0, 3:] = np.eye(3)
    columns[:, 4:7, :3] = [np.cross(axis, np.eye(3)).T for axis in np.eye(3)]
    found = np.einsum("aki,ij,alj->akl", columns, covariance, columns)
    found[:2] = found[:2].mean(axis=0)
    return np.asarray(found)
