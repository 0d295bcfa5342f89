"""A path that pictures know up to its scale beside the accelerometer's way, in rows of independent noise.

Over a stretch of a few seconds the specific force, turned into the world, less gravity and integrated twice,
is the way of the accelerometer, but for a start and a speed that nobody knows. It is the scale times the path
of the body, plus the arm from the body's origin to the accelerometer, turned along, plus what the
accelerometer's offset makes of it: linear in seven sizes. An arm of five centimetres matters: a vehicle
that sways once a second turns its tilt into a fifth of the acceleration.

Source: Martinelli 2014 (IJCV 106), sections 3 and 4, for the linear system; Fuller 1987, Measurement Error
Models, section 2.3, for regressors that err together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, null_space

from backend.inertial_scale.preintegration import InertialReadings, attitudes_between, integrated_twice
from backend.measurements import GRAVITY_M_S2

Array = NDArray[np.float64]

SEGMENT_S = (1.0, 4.0)
"""Longer ones gain little: integrated noise is larger than the way by then."""
_WANTED, _MOST, MIN_SEGMENTS = 12, 60, 8
"""Stretches: short flights have shorter ones."""
MIN_POSES = 8
_LONGEST_GAP_S = 0.5
MAX_DELAY_S = 0.1
MIN_SPACING_S = 0.05
"""Poses that follow each other more closely share their errors, and gain nothing: lengths show at 1 Hz."""
PRIOR = np.diag(np.array([0.0, *[3.0**-2] * 3, *[0.3**-2] * 3]))
"""Of scale, offset and arm, for a vehicle that does not turn or hardly moves: m/s², m."""


@dataclass(frozen=True)
class RegressionRows:
    """Linear system of all stretches: ``way = known @ (scale, offset, arm) + noise``.

    Initial position and velocity are projected out, and noise is independent from row to row.
    """

    stretch: NDArray[np.int64]
    """(r,) number of the stretch."""
    growth: Array
    """(r,) variance of unit white noise integrated twice."""
    lasting: Array
    """(r,) variance of a unit random walk: an error that lasts over several poses."""
    way: Array
    """(r, 3)."""
    known: Array
    """(r, 3, 7)."""
    column_noise: Array
    """(3, 7, 7) covariance of the columns' own noise in each axis, as told."""

    def of_poses(self, noise: Array) -> Array:
        """(r,) variance of the poses' errors over what was told: each pose's own, and what lasts."""
        alone, lasting = np.exp(2 * noise[1:])
        return np.asarray(alone + lasting * self.lasting)

    def weight(self, sizes: Array, noise: Array) -> Array:
        """(r, 3) of noise (3,), as logarithms: of force [m/s²/sqrt(Hz)], of poses over what was told, each
        one's own and what they wander in a root second."""
        force = np.exp(2 * noise[0]) * self.growth
        poses = self.of_poses(noise)[:, None] * (self.column_noise @ sizes @ sizes)
        return np.asarray(1 / (force[:, None] + poses))

    def left(self, sizes: Array) -> Array:
        """(r, 3) what scale, offset and arm leave of the way."""
        return np.asarray(self.way - self.known @ sizes)

    def whitened(self, sizes: Array, noise: Array) -> Array:
        """(3r + 7,) what is left over unit noise, and the sizes over what is thought of them beforehand."""
        left = np.sqrt(self.weight(sizes, noise)) * self.left(sizes)
        return np.concatenate([left.ravel(), np.sqrt(np.diag(PRIOR)) * sizes])

    def slopes(self, sizes: Array, noise: Array) -> Array:
        """(3r + 7, 7) of ``whitened``: with the sizes the noise grows, too."""
        root = np.sqrt(self.weight(sizes, noise))[..., None]
        growing = self.of_poses(noise)[:, None, None] * (self.column_noise @ sizes)
        slopes = -root * self.known - root**3 * self.left(sizes)[..., None] * growing
        return np.concatenate([slopes.reshape(-1, 7), np.sqrt(PRIOR)])

    def at(self, scale: float, noise: Array) -> Array:
        """Sizes (7,) of a scale, with the offset and arm that fit it if the arm is short."""
        short = np.array([scale, *[0.0] * 6])
        weight, others = self.weight(short, noise), self.known[..., 1:]
        weighted = (weight[..., None] * others).reshape(-1, 6).T
        information = weighted @ others.reshape(-1, 6) + PRIOR[1:, 1:]
        short[1:] = np.linalg.solve(information, weighted @ self.left(short).ravel())
        return short

    def log_volume(self, sizes: Array, noise: Array) -> float:
        """Log-determinant term of the likelihood of the noise, offset and arm marginalised."""
        weight, others = self.weight(sizes, noise), self.known[..., 1:]
        H = np.einsum("rak,ra,ral->kl", others, weight, others, optimize=True) + PRIOR[1:, 1:]
        return float(np.linalg.slogdet(H)[1] - np.log(weight).sum())


@dataclass(frozen=True)
class PathAndReadings:
    """The path, the readings beside it, and the stretches over which they are compared."""

    stamps_s: Array
    w_T_b: Array
    readings: InertialReadings
    stretches: Sequence[slice]
    column_noise: Array
    """As `RegressionRows` has it."""

    @cached_property
    def contrasts(self) -> list[tuple[Array, Array, Array]]:
        """Of each stretch: combinations of its moments (r, m) that cancel initial position and velocity.

        And the variance (r,) of each under unit white noise integrated twice, and integrated once.
        """
        contrasts = []
        for stretch in self.stretches:
            t = self.stamps_s[stretch] - self.stamps_s[stretch.start]
            early, late = np.minimum.outer(t, t), np.maximum.outer(t, t)
            free = null_space(np.column_stack([np.ones_like(t), t]).T)
            growth, axes = eigh(free.T @ (early**2 * (3 * late - early) / 6) @ free)
            contrast = (free @ axes).T
            lasting = np.einsum("rm,mn,rn->r", contrast, early, contrast)
            contrasts.append((contrast, np.maximum(growth, 0.0), lasting))
        return contrasts

    def rows(self, delay_s: float) -> RegressionRows:
        """All stretches, the pictures' clock late by so much."""
        way, known = [], []
        for stretch, (contrast, *_) in zip(self.stretches, self.contrasts, strict=True):
            one_way, one_known = self._stretch(stretch, delay_s)
            way.append(contrast @ one_way)
            known.append(np.tensordot(contrast, one_known, axes=1))
        count = [len(growth) for _, growth, _ in self.contrasts]
        growth, lasting = (np.concatenate([one[k] for one in self.contrasts]) for k in (1, 2))
        return RegressionRows(
            np.repeat(np.arange(len(count)), count),
            growth,
            lasting,
            np.concatenate(way),
            np.concatenate(known),
            self.column_noise,
        )

    def by_gains(self, delay_s: float) -> Array:
        """(r, 3, 3) what the reading along each of the accelerometer's axes makes of the way: so much more is
        read where its gain is twice as large."""
        added = []
        for stretch, (contrast, *_) in zip(self.stretches, self.contrasts, strict=True):
            at_s, imu_s, w_R_b, force = self._between(stretch, delay_s)
            added.append(
                np.tensordot(contrast, integrated_twice(imu_s, w_R_b * force[:, None], at_s), axes=1)
            )
        return np.concatenate(added)

    def _stretch(self, stretch: slice, delay_s: float) -> tuple[Array, Array]:
        """Way (m, 3), and what it is made of (m, 3, 7)."""
        at_s, imu_s, w_R_b, b_force = self._between(stretch, delay_s)
        force = np.einsum("kab,kb->ka", w_R_b, b_force) - [0, 0, GRAVITY_M_S2]
        twice = integrated_twice(imu_s, np.concatenate([force[..., None], w_R_b], axis=-1), at_s)
        w_T_b = self.w_T_b[stretch]
        path = w_T_b[:, :3, 3:] - w_T_b[0, :3, 3:]
        return twice[..., 0], np.concatenate([path, twice[..., 1:], w_T_b[:, :3, :3]], axis=-1)

    def _between(self, stretch: slice, delay_s: float) -> tuple[Array, Array, Array, Array]:
        """Times of the poses (m,) by the readings' clock; times (k,), attitudes (k, 3, 3) and specific force
        (k, 3) of the readings about them."""
        at_s, readings = self.stamps_s[stretch] - delay_s, self.readings
        first, last = np.searchsorted(readings.stamps_s, at_s[[0, -1]]) + [-1, 1]
        imu_s = readings.stamps_s[first:last]
        turned = self.w_T_b[stretch, :3, :3]
        w_R_b = attitudes_between(at_s, turned, imu_s, readings.gyro_rad_s[first:last])
        return at_s, imu_s, w_R_b, readings.accel_m_s2[first:last]


def find_segments(stamps_s: Array, imu_s: Array) -> list[slice]:
    """Runs of poses that last as long as a stretch, none with a gap in poses or readings."""
    gap = np.diff(imu_s) > _LONGEST_GAP_S / 5
    # As many gaps have ended before a pose as have begun until it, whatever the delay.
    inside = np.searchsorted(imu_s[1:][gap], stamps_s - MAX_DELAY_S) == np.searchsorted(
        imu_s[:-1][gap], stamps_s + MAX_DELAY_S
    )
    inside &= (stamps_s >= imu_s[0] + MAX_DELAY_S) & (stamps_s <= imu_s[-1] - MAX_DELAY_S)
    broken = (np.diff(stamps_s) > _LONGEST_GAP_S) | ~inside[1:] | ~inside[:-1]
    runs = [run[inside[run]] for run in np.split(np.arange(len(stamps_s)), np.flatnonzero(broken) + 1)]
    runs = [run for run in runs if len(run) >= MIN_POSES]
    lasts_s = sum(float(stamps_s[run[-1]] - stamps_s[run[0]]) for run in runs)
    stretch_s = float(np.clip(lasts_s / _WANTED, *SEGMENT_S))
    found = []
    for run in runs:
        count = int((stamps_s[run[-1]] - stamps_s[run[0]]) / stretch_s + 1e-9)
        ends = np.searchsorted(stamps_s[run], stamps_s[run[0]] + stretch_s * np.arange(count + 1))
        found += [slice(run[0] + a, run[0] + b) for a, b in pairwise(ends.tolist())]
    found = [s for s in found if s.stop - s.start >= MIN_POSES]
    some = np.unique(np.linspace(0, len(found) - 1, min(_MOST, len(found))).round().astype(int))
    return [found[k] for k in some.tolist()]


def regressor_covariance(covariance: Array) -> Array:
    """(3, 7, 7) what a pose's own error makes of the seven columns in each row of `RegressionRows.known`.

    The vehicle turns about the vertical: both level axes have the mean of the two.
    """
    columns = np.zeros((3, 7, 6))
    columns[:, 0, 3:] = np.eye(3)
    columns[:, 4:, :3] = [np.cross(axis, np.eye(3)).T for axis in np.eye(3)]
    found = np.einsum("aki,ij,alj->akl", columns, covariance, columns)
    found[:2] = found[:2].mean(axis=0)
    return np.asarray(found)
