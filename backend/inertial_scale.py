"""How long a metre is: a path that pictures know up to its scale, held against the accelerometer.

Over a stretch of a few seconds the specific force, turned into the world, less gravity and integrated twice,
is the way of the accelerometer, but for a start and a speed that nobody knows. It is the path of the body,
times the scale, plus the arm from the body's origin to the accelerometer, turned along. Divided by the scale
all of this is linear in seven numbers: one over the scale, the accelerometer's offset and its arm. An arm of
five centimetres matters: a vehicle that sways once a second turns its tilt into a fifth of the acceleration.

The pictures err by white noise; the integrated force errs by white noise integrated twice. How much of each
there is, and by how much the pictures' clock is off, is what makes the record most likely.

Source: Martinelli 2014 (IJCV 106), sections 3 and 4, for the linear system; Forster et al. 2017 (T-RO 33),
equation 33, for the integrals; Harville 1977 (JASA 72) for the likelihood, the linear part projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import solve_triangular
from scipy.optimize import minimize, minimize_scalar
from scipy.spatial.transform import Rotation

from backend.measurements import GRAVITY_M_S2

Array = NDArray[np.float64]

_STRETCH_S = (1.0, 4.0)
"""Longer ones gain little: integrated noise is larger than the way by then."""
_WANTED, _MOST, _LEAST = 12, 60, 8
"""Stretches: short flights have shorter ones."""
_LEAST_POSES = 8
_LONGEST_GAP_S = 0.5
_MOST_DELAY_S = 0.1
_FORCE_NOISE, _PLACE_NOISE = 0.02, 1e-3
"""Where the search begins: m/s²/sqrt(Hz), and over the height."""
_SURE = 5.0
"""Standard deviations by which one over the scale must differ from 0."""
_NUMBERS = 7
"""One over the scale; the offset and the arm, both over the scale."""
_PRIOR = np.diag(1 / np.array([10.0, 3.0, 3.0, 3.0, 0.3, 0.3, 0.3]) ** 2)
"""What is known beforehand, for a vehicle that does not turn or hardly moves: m/s², m."""


@dataclass(frozen=True)
class InertialScale:
    """What the accelerometer tells of a path."""

    scale: float
    """True lengths over those of the path."""
    scale_std: float
    """Of the noise alone: an error of the accelerometer's own gain is one of the scale."""
    offset_m_s2: tuple[float, float, float]
    """The accelerometer reads so much more, in body axes."""
    offset_std_m_s2: tuple[float, float, float]
    arm_m: tuple[float, float, float]
    """From the body's origin to the accelerometer, in body axes."""
    arm_std_m: tuple[float, float, float]
    delay_s: float
    """The pictures' stamps are so much later than the accelerometer's for the same moment."""


@dataclass(frozen=True)
class InertialReadings:
    """Gyro and accelerometer in body axes; finite, in order of time."""

    stamps_s: Array
    """(k,)."""
    gyro_rad_s: Array
    """(k, 3)."""
    accel_m_s2: Array
    """(k, 3)."""


def inertial_scale(stamps_s: Array, w_T_b: Array, readings: InertialReadings) -> InertialScale | None:
    """Scale of a path (n, 4, 4) over a level floor at z = 0, at ``stamps_s`` (n,) in order of time.

    None where the two do not overlap for long enough, or where the accelerometer tells nothing of the scale.
    """
    stretches = _stretches(stamps_s, readings.stamps_s)
    if len(stretches) < _LEAST:
        return None
    path = _Path(stamps_s, w_T_b, readings, stretches)
    noise = np.log([_FORCE_NOISE, _PLACE_NOISE * float(np.median(w_T_b[:, 2, 3]))])
    delay_s = 0.0
    for _ in range(2):
        noise = _likeliest_noise(path, delay_s, noise)
        delay_s = _likeliest_delay(path, noise)
    return _told(_fit(path.systems(delay_s), noise), delay_s)


def _likeliest_noise(path: _Path, delay_s: float, start: Array) -> Array:
    systems = path.systems(delay_s)

    def cost(noise: Array) -> float:
        return -_fit(systems, noise).likelihood

    return np.asarray(minimize(cost, start, method="Nelder-Mead", options={"xatol": 0.05, "fatol": 0.1}).x)


def _likeliest_delay(path: _Path, noise: Array) -> float:
    def cost(delay_s: float) -> float:
        return -_fit(path.systems(delay_s), noise).likelihood

    within = (-_MOST_DELAY_S, _MOST_DELAY_S)
    return float(minimize_scalar(cost, bounds=within, method="bounded", options={"xatol": 1e-3}).x)


def _stretches(stamps_s: Array, imu_s: Array) -> list[slice]:
    """Runs of poses that last as long as a stretch, none with a gap in poses or readings."""
    broken = np.diff(stamps_s) > _LONGEST_GAP_S
    gaps = imu_s[:-1][np.diff(imu_s) > _LONGEST_GAP_S / 5]
    broken |= np.searchsorted(gaps, stamps_s[:-1]) != np.searchsorted(gaps, stamps_s[1:])
    inside = (stamps_s >= imu_s[0] + _MOST_DELAY_S) & (stamps_s <= imu_s[-1] - _MOST_DELAY_S)
    runs = [run[inside[run]] for run in np.split(np.arange(len(stamps_s)), np.flatnonzero(broken) + 1)]
    runs = [run for run in runs if len(run) >= _LEAST_POSES]
    lasts_s = sum(float(stamps_s[run[-1]] - stamps_s[run[0]]) for run in runs)
    stretch_s = float(np.clip(lasts_s / _WANTED, *_STRETCH_S))
    found = []
    for run in runs:
        count = int((stamps_s[run[-1]] - stamps_s[run[0]]) / stretch_s + 1e-9)
        ends = np.searchsorted(stamps_s[run], stamps_s[run[0]] + stretch_s * np.arange(count + 1))
        found += [slice(run[0] + a, run[0] + b) for a, b in pairwise(ends.tolist())]
    found = [s for s in found if s.stop - s.start >= _LEAST_POSES]
    some = np.unique(np.linspace(0, len(found) - 1, min(_MOST, len(found))).round().astype(int))
    return [found[k] for k in some.tolist()]


@dataclass(frozen=True)
class _System:
    """One stretch: ``path = numbers @ known + start + speed * time + noise``."""

    time_s: Array
    """(m,) since its begin."""
    path: Array
    """(m, 3)."""
    known: Array
    """(m, 3, 7)."""


@dataclass(frozen=True)
class _Path:
    stamps_s: Array
    w_T_b: Array
    readings: InertialReadings
    stretches: Sequence[slice]

    def systems(self, delay_s: float) -> list[_System]:
        return [self._system(stretch, delay_s) for stretch in self.stretches]

    def _system(self, stretch: slice, delay_s: float) -> _System:
        at_s, w_T_b, readings = self.stamps_s[stretch] - delay_s, self.w_T_b[stretch], self.readings
        first, last = np.searchsorted(readings.stamps_s, at_s[[0, -1]]) + [-1, 1]
        imu_s = readings.stamps_s[first:last]
        w_R_b = _attitudes(at_s, w_T_b[:, :3, :3], imu_s, readings.gyro_rad_s[first:last])
        force = np.einsum("kab,kb->ka", w_R_b, readings.accel_m_s2[first:last]) - [0, 0, GRAVITY_M_S2]
        # Columns: the way without offset, and what each axis of the offset takes from it.
        twice = _integrated_twice(imu_s, np.concatenate([force[..., None], -w_R_b], axis=-1), at_s)
        known = np.concatenate([twice, -w_T_b[:, :3, :3]], axis=-1)
        path = w_T_b[:, :3, 3] - w_T_b[0, :3, 3]
        return _System(at_s - at_s[0], path, known)


def _attitudes(at_s: Array, w_R_b: Array, imu_s: Array, gyro_rad_s: Array) -> Array:
    """(k, 3, 3) at the readings: between poses the gyro's shape, so turned that it meets both."""
    turned = _integrated(imu_s, gyro_rad_s)
    at_poses = np.column_stack([np.interp(at_s, imu_s, turned[:, a]) for a in range(3)])
    piece = np.clip(np.searchsorted(at_s, imu_s, side="right") - 1, 0, len(at_s) - 2)
    share = (imu_s - at_s[piece]) / (at_s[piece + 1] - at_s[piece])
    within = turned - at_poses[piece] - share[:, None] * (at_poses[piece + 1] - at_poses[piece])
    known = Rotation.from_matrix(w_R_b)
    step = (known[:-1].inv() * known[1:]).as_rotvec()
    found = known[piece] * Rotation.from_rotvec(share[:, None] * step[piece]) * Rotation.from_rotvec(within)
    return np.asarray(found.as_matrix())


def _integrated(stamps_s: Array, values: Array) -> Array:
    dt = np.diff(stamps_s).reshape(-1, *[1] * (values.ndim - 1))
    steps = 0.5 * (values[1:] + values[:-1]) * dt
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(steps, axis=0)])


def _integrated_twice(stamps_s: Array, values: Array, at_s: Array) -> Array:
    once = _integrated(stamps_s, values)
    return np.asarray(CubicHermiteSpline(stamps_s, _integrated(stamps_s, once), once)(at_s))


@dataclass(frozen=True)
class _Fitted:
    information: Array
    """(s, 7, 7) of each stretch."""
    gradient: Array
    """(s, 7) of each stretch, at zero."""
    likelihood: float
    """Logarithm, but for a constant."""


def _fit(systems: Sequence[_System], noise: Array) -> _Fitted:
    """At a noise of the force [m/s²/sqrt(Hz)] and of the path's positions; both as logarithms."""
    force, position = np.exp(noise)
    information, gradient = np.zeros((len(systems), _NUMBERS, _NUMBERS)), np.zeros((len(systems), _NUMBERS))
    squares = volume = 0.0
    for s, system in enumerate(systems):
        t = system.time_s
        early, late = np.minimum.outer(t, t), np.maximum.outer(t, t)
        # White noise integrated twice.
        covariance = force**2 * early**2 * (3 * late - early) / 6 + position**2 * np.eye(len(t))
        L = np.linalg.cholesky(covariance)
        line = solve_triangular(L, np.column_stack([np.ones_like(t), t]), lower=True)
        Q, R = np.linalg.qr(line)
        known = solve_triangular(L, system.known.reshape(len(t), -1), lower=True)
        path = solve_triangular(L, system.path, lower=True)
        # Start and speed are free in each stretch.
        known = (known - Q @ (Q.T @ known)).reshape(-1, _NUMBERS)
        path = (path - Q @ (Q.T @ path)).reshape(-1)
        information[s], gradient[s] = known.T @ known, known.T @ path
        squares += float(path @ path)
        volume += 3 * float(np.log(np.diag(L)).sum() + np.log(np.abs(np.diag(R))).sum())
    H, g = _PRIOR + information.sum(axis=0), gradient.sum(axis=0)
    squares -= float(g @ np.linalg.solve(H, g))
    return _Fitted(information, gradient, -0.5 * squares - volume - 0.5 * float(np.linalg.slogdet(H)[1]))


def _told(fit: _Fitted, delay_s: float) -> InertialScale | None:
    H, g = _PRIOR + fit.information.sum(axis=0), fit.gradient.sum(axis=0)
    numbers = np.linalg.solve(H, g)
    without = np.linalg.solve(H - fit.information, (g - fit.gradient)[..., None])[..., 0]
    count = len(without)
    # Stretches may differ by more than white noise has them: leaving out each in turn shows it.
    jackknife = (count - 1) / count * ((without - without.mean(axis=0)) ** 2).sum(axis=0)
    std = np.sqrt(np.maximum(np.diag(np.linalg.inv(H)), jackknife))
    if numbers[0] <= _SURE * std[0]:
        return None
    scale = 1 / float(numbers[0])
    offset, arm = (tuple((scale * numbers[at]).tolist()) for at in (slice(1, 4), slice(4, 7)))
    offset_std, arm_std = (tuple((scale * std[at]).tolist()) for at in (slice(1, 4), slice(4, 7)))
    return InertialScale(scale, scale**2 * float(std[0]), offset, offset_std, arm, arm_std, delay_s)
