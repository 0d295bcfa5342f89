"""How long a metre is: a path that pictures know up to its scale, held against the accelerometer.

Over a stretch of a few seconds the specific force, turned into the world, less gravity and integrated twice,
is the way of the accelerometer, but for a start and a speed that nobody knows. It is the scale times the path
of the body, plus the arm from the body's origin to the accelerometer, turned along, plus what the
accelerometer's offset makes of it: linear in seven numbers. An arm of five centimetres matters: a vehicle
that sways once a second turns its tilt into a fifth of the acceleration.

Both sides err: the path by white noise, the integrated force by white noise integrated twice. Least squares
that took either for right would have the scale too small or too large; these are total, over both. How much
of each noise there is, and by how much the pictures' clock is off, is what makes the record most likely.

Source: Martinelli 2014 (IJCV 106), sections 3 and 4, for the linear system; Fuller 1987, Measurement Error
Models, section 2.3, for two sides that err; Harville 1977 (JASA 72) for the likelihood of the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, null_space
from scipy.optimize import minimize, minimize_scalar

from backend.measurements import GRAVITY_M_S2
from backend.preintegration import InertialReadings, attitudes_between, integrated_twice

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
"""Standard deviations by which the scale must differ from 0."""
_MOST_OFFSET_M_S2 = 3.0
"""An accelerometer that is farther off has its signs or its unit wrong."""
_ROUNDS = 3
_RANGE = 10.0
"""By how much the scale may differ from its first guess."""
_PRIOR = np.diag(np.array([0.0, *[3.0**-2] * 3, *[0.3**-2] * 3]))
"""Of scale, offset and arm, for a vehicle that does not turn or hardly moves: m/s², m."""


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


def inertial_scale(stamps_s: Array, w_T_b: Array, readings: InertialReadings) -> InertialScale | None:
    """Scale of a path (n, 4, 4) over a level floor at z = 0, at ``stamps_s`` (n,) in order of time.

    None where the two do not overlap for long enough, or where the accelerometer tells nothing of the scale.
    """
    stretches = _stretches(stamps_s, readings.stamps_s)
    if len(stretches) < _LEAST:
        return None
    path = _Path(stamps_s, w_T_b, readings, stretches)
    noise = np.log([_FORCE_NOISE, _PLACE_NOISE * max(float(np.median(w_T_b[:, 2, 3])), _PLACE_NOISE)])
    scale, delay_s = 1.0, 0.0
    for number in range(_ROUNDS):
        rows = path.rows(delay_s)
        scale = _best_scale(rows, noise, _RANGE if number == 0 else 2.0, scale)
        noise = _likeliest_noise(rows, scale, noise)
        delay_s = _likeliest_delay(path, scale, noise)
    rows = path.rows(delay_s)
    return _found(rows, _best_scale(rows, noise, 2.0, scale), noise, delay_s)


def _best_scale(rows: _Rows, noise: Array, within: float, about: float) -> float:
    """Total least squares: the path is what both sides together have least to mend for."""

    def cost(log_scale: float) -> float:
        return rows.squares(float(np.exp(log_scale)), noise)

    grid = np.log(about) + np.linspace(-np.log(within), np.log(within), 25)
    best = grid[int(np.argmin([cost(x) for x in grid.tolist()]))]
    step = grid[1] - grid[0]
    return float(np.exp(minimize_scalar(cost, bounds=(best - step, best + step), method="bounded").x))


def _likeliest_noise(rows: _Rows, scale: float, start: Array) -> Array:
    def cost(noise: Array) -> float:
        return rows.squares(scale, noise) + rows.log_volume(scale, noise)

    return np.asarray(minimize(cost, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.1}).x)


def _likeliest_delay(path: _Path, scale: float, noise: Array) -> float:
    def cost(delay_s: float) -> float:
        return path.rows(delay_s).squares(scale, noise)

    within = (-_MOST_DELAY_S, _MOST_DELAY_S)
    return float(minimize_scalar(cost, bounds=within, method="bounded", options={"xatol": 1e-3}).x)


def _stretches(stamps_s: Array, imu_s: Array) -> list[slice]:
    """Runs of poses that last as long as a stretch, none with a gap in poses or readings."""
    gap = np.diff(imu_s) > _LONGEST_GAP_S / 5
    # As many gaps have ended before a pose as have begun until it, whatever the delay.
    inside = np.searchsorted(imu_s[1:][gap], stamps_s - _MOST_DELAY_S) == np.searchsorted(
        imu_s[:-1][gap], stamps_s + _MOST_DELAY_S
    )
    inside &= (stamps_s >= imu_s[0] + _MOST_DELAY_S) & (stamps_s <= imu_s[-1] - _MOST_DELAY_S)
    broken = (np.diff(stamps_s) > _LONGEST_GAP_S) | ~inside[1:] | ~inside[:-1]
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
class _Rows:
    """All stretches, each turned so that start and speed are gone and noise is independent from row to row:
    ``way = known @ (scale, offset, arm) + noise``."""

    stretch: NDArray[np.int64]
    """(r,) number of the stretch."""
    growth: Array
    """(r,) variance of unit white noise integrated twice."""
    way: Array
    """(r, 3)."""
    known: Array
    """(r, 3, 7)."""

    def weight(self, scale: float, noise: Array) -> Array:
        """(r,) of force noise [m/s²/sqrt(Hz)] and of the path's own, both as logarithms."""
        force, place = np.exp(noise)
        return np.asarray(1 / (force**2 * self.growth + (scale * place) ** 2))

    def _normal(self, scale: float, noise: Array) -> tuple[Array, Array]:
        """Weighted gradient (6, 3r) of offset and arm, and their information (6, 6)."""
        others = self.known[..., 1:]
        weighted = (self.weight(scale, noise)[:, None, None] * others).reshape(-1, 6).T
        return weighted, weighted @ others.reshape(-1, 6) + _PRIOR[1:, 1:]

    def at(self, scale: float, noise: Array) -> tuple[Array, Array]:
        """Offset and arm (6,) at a scale, and what is left over (r, 3)."""
        weighted, H = self._normal(scale, noise)
        left = self.way - scale * self.known[..., 0]
        found = np.linalg.solve(H, weighted @ left.reshape(-1))
        return np.asarray(found, dtype=float), left - self.known[..., 1:] @ found

    def squares(self, scale: float, noise: Array) -> float:
        """Weighted, with the best offset and arm."""
        found, left = self.at(scale, noise)
        prior = float(found @ _PRIOR[1:, 1:] @ found)
        return float(self.weight(scale, noise) @ (left**2).sum(axis=1)) + prior

    def log_volume(self, scale: float, noise: Array) -> float:
        """What the likelihood takes for the noise's size, offset and arm projected out."""
        H = self._normal(scale, noise)[1]
        return float(np.linalg.slogdet(H)[1] - 3 * np.log(self.weight(scale, noise)).sum())


@dataclass(frozen=True)
class _Path:
    stamps_s: Array
    w_T_b: Array
    readings: InertialReadings
    stretches: Sequence[slice]

    @cached_property
    def contrasts(self) -> list[tuple[Array, Array]]:
        """Of each stretch: sums over its moments (r, m) that neither start nor speed enters, and the variance
        of each (r,)."""
        contrasts = []
        for stretch in self.stretches:
            t = self.stamps_s[stretch] - self.stamps_s[stretch.start]
            early, late = np.minimum.outer(t, t), np.maximum.outer(t, t)
            free = null_space(np.column_stack([np.ones_like(t), t]).T)
            growth, axes = eigh(free.T @ (early**2 * (3 * late - early) / 6) @ free)
            contrasts.append(((free @ axes).T, np.maximum(growth, 0.0)))
        return contrasts

    def rows(self, delay_s: float) -> _Rows:
        """All stretches, the pictures' clock late by so much."""
        way, known = [], []
        for stretch, (contrast, _) in zip(self.stretches, self.contrasts, strict=True):
            one_way, one_known = self._stretch(stretch, delay_s)
            way.append(contrast @ one_way)
            known.append(np.tensordot(contrast, one_known, axes=1))
        count = [len(growth) for _, growth in self.contrasts]
        growth = np.concatenate([growth for _, growth in self.contrasts])
        return _Rows(
            np.repeat(np.arange(len(count)), count), growth, np.concatenate(way), np.concatenate(known)
        )

    def _stretch(self, stretch: slice, delay_s: float) -> tuple[Array, Array]:
        """Way (m, 3), and what it is made of (m, 3, 7)."""
        at_s, w_T_b, readings = self.stamps_s[stretch] - delay_s, self.w_T_b[stretch], self.readings
        first, last = np.searchsorted(readings.stamps_s, at_s[[0, -1]]) + [-1, 1]
        imu_s = readings.stamps_s[first:last]
        w_R_b = attitudes_between(at_s, w_T_b[:, :3, :3], imu_s, readings.gyro_rad_s[first:last])
        force = np.einsum("kab,kb->ka", w_R_b, readings.accel_m_s2[first:last]) - [0, 0, GRAVITY_M_S2]
        twice = integrated_twice(imu_s, np.concatenate([force[..., None], w_R_b], axis=-1), at_s)
        path = w_T_b[:, :3, 3:] - w_T_b[0, :3, 3:]
        return twice[..., 0], np.concatenate([path, twice[..., 1:], w_T_b[:, :3, :3]], axis=-1)


def _found(rows: _Rows, scale: float, noise: Array, delay_s: float) -> InertialScale | None:
    others, left = rows.at(scale, noise)
    w, place = rows.weight(scale, noise), float(np.exp(noise[1]))
    weighted = w[:, None, None] * rows.known
    information = weighted.reshape(-1, 7).T @ rows.known.reshape(-1, 7) + _PRIOR
    # The path's own noise looks like a way, too; where chance explains all of it, nothing moved.
    information[0, 0] -= 3 * place**2 * float(w.sum())
    if information[0, 0] <= _SURE * place**2 * float(np.sqrt(6 * np.sum(w**2))):
        return None
    score = np.einsum("rak,ra->rk", weighted, left)
    score[:, 0] += scale * place**2 * w**2 * (left**2).sum(axis=1)
    count = int(rows.stretch.max()) + 1
    by_stretch = np.zeros((count, 7))
    np.add.at(by_stretch, rows.stretch, score)
    inverse = np.linalg.inv(information)
    # Stretches may differ by more than white noise has them.
    between = inverse @ (by_stretch.T @ by_stretch) @ inverse * count / (count - 1)
    std = np.sqrt(np.maximum(np.diag(inverse), np.diag(between)))
    if not scale > _SURE * std[0] or np.linalg.norm(others[:3]) > _MOST_OFFSET_M_S2:
        return None
    return InertialScale(
        scale,
        float(std[0]),
        _triple(others[:3]),
        _triple(std[1:4]),
        _triple(others[3:]),
        _triple(std[4:7]),
        delay_s,
    )


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
