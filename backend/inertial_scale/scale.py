"""Metric scale of a visual path, known up to scale from the pictures, from the accelerometer.

An errors-in-variables problem: the specific force integrated twice carries white noise integrated twice, the
poses carry white noise and a random walk that neighbouring poses share, because they are registered to the
same keyframe over the same uneven floor. Least squares that took either side for exact would bias the scale
down or up; here it is total least squares over both. The random walk has to be modelled: attributed to the
force, it would make the path look exact. Position and tilt errors of a pose are almost fully correlated (a
tilt error displaces the camera by the height times that), so their joint covariance is used: else a lever arm
as long as the height would explain both, and most of the path with them. The levels of all noises and the
delay of the pictures' clock are maximum-likelihood estimates.

Source: Fuller 1987, Measurement Error Models, section 2.3, for regressors that err together; Harville 1977
(JASA 72) for the likelihood of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize, minimize_scalar

from backend.inertial_scale.preintegration import InertialReadings
from backend.inertial_scale.regression_rows import (
    MAX_DELAY_S,
    MIN_POSES,
    MIN_SEGMENTS,
    MIN_SPACING_S,
    PRIOR,
    SEGMENT_S,
    PathAndReadings,
    RegressionRows,
    find_segments,
    regressor_covariance,
)

Array = NDArray[np.float64]

_FORCE_NOISE, _POSE_NOISE, _LASTING_NOISE = 0.02, 4.0, 1.0
"""Where the search begins: of the force, m/s²/sqrt(Hz); white noise and random walk (per root second) of the
poses, as factors on their told noise. Starting with large pose noise avoids the local optimum in which poses
are taken for exact and the scale shrinks to fit that."""
_SURE = 5.0
"""Standard deviations by which the scale must differ from 0."""
_MOST_OFFSET_M_S2 = 3.0
"""An accelerometer that is farther off has its signs or its unit wrong."""
_ROUNDS = 3
_ASIDE_S = 0.005
"""Step of the finite difference that gives the delay's standard deviation from the cost's curvature."""
_RANGE = 10.0
"""By how much the scale may differ from its first guess."""


@dataclass(frozen=True)
class InertialScale:
    """What the accelerometer tells of a path."""

    scale: float
    """True lengths over those of the path."""
    scale_std: float
    """Of the noise alone."""
    offset_m_s2: tuple[float, float, float]
    """The accelerometer reads so much more, in body axes."""
    offset_std_m_s2: tuple[float, float, float]
    arm_m: tuple[float, float, float]
    """From the body's origin to the accelerometer, in body axes."""
    arm_std_m: tuple[float, float, float]
    delay_s: float
    """The pictures' stamps are so much later than the accelerometer's for the same moment."""
    delay_std_s: float
    """Infinite where paths late and early are as likely."""
    gain_slopes: tuple[float, float, float]
    """d log(scale) / d log(gain) for the accelerometer's gain along each body axis. The rotors' thrust is
    almost constant along one axis, where a gain error acts like an offset; the scale then comes from how that
    force is turned. They add up to 1 for a vehicle that accelerates without leaning."""

    def log_std(self, gain_std: float) -> float:
        """Relative deviation of the scale, gains as uncertain as ``gain_std``: they may err together."""
        by_gains = gain_std * float(np.abs(self.gain_slopes).sum())
        return float(np.hypot(self.scale_std / self.scale, by_gains))


@dataclass(frozen=True)
class NoScale:
    """The accelerometer tells no scale."""

    reason: str
    """In words."""


_HARDLY_MOVED = NoScale("the flight hardly speeds up or brakes, so that its way is lost in the noise")
_UNLIKE = NoScale(
    "what it reads does not fit the way that the pictures show (its signs, unit, T_BS or clock may be wrong)"
)


def inertial_scale(
    stamps_s: Array, w_T_b: Array, readings: InertialReadings, covariance: Array
) -> InertialScale | NoScale:
    """Scale of a path (n, 4, 4) over a level floor at z = 0, at ``stamps_s`` (n,) in order of time.

    ``covariance`` (6, 6), rotation first, right perturbation, is that of a pose's own error, which no other
    shares; its shape counts, its size is found anew. `NoScale` where path and readings do not overlap
    for long enough, or where the accelerometer tells nothing of the scale.
    """
    apart = np.unique(np.floor((stamps_s - stamps_s[:1]) / MIN_SPACING_S), return_index=True)[1]
    stamps_s, w_T_b = stamps_s[apart], w_T_b[apart]
    stretches = find_segments(stamps_s, readings.stamps_s)
    if len(stretches) < MIN_SEGMENTS:
        return NoScale(
            f"{MIN_SEGMENTS} stretches of {SEGMENT_S[0]:g} to {SEGMENT_S[1]:g} s with {MIN_POSES} "
            f"pictures each are needed and {len(stretches)} found: fly longer, or with more pictures a second"
        )
    path = PathAndReadings(stamps_s, w_T_b, readings, stretches, regressor_covariance(covariance))
    noise, delay_s = np.log([_FORCE_NOISE, _POSE_NOISE, _LASTING_NOISE]), 0.0
    rows = path.rows(delay_s)
    sizes = _first_sizes(rows, noise)
    for _ in range(_ROUNDS):
        sizes = _best_sizes(rows, noise, sizes)
        noise = _likeliest_noise(rows, sizes, noise)
        delay_s = _likeliest_delay(path, sizes, noise)
        rows = path.rows(delay_s)
    delay = delay_s, _delay_std(path, sizes, noise, delay_s)
    return _found(rows, path.by_gains(delay_s), _best_sizes(rows, noise, sizes), noise, delay)


def _first_sizes(rows: RegressionRows, noise: Array) -> Array:
    """Scale, offset and arm (7,) from where the search begins: the best of many scales."""
    tried = [rows.at(scale, noise) for scale in np.geomspace(1 / _RANGE, _RANGE, 49).tolist()]
    return min(tried, key=lambda sizes: float(np.sum(rows.whitened(sizes, noise) ** 2)))


def _best_sizes(rows: RegressionRows, noise: Array, start: Array) -> Array:
    """Total least squares: scale, offset and arm that both sides together have least to mend for."""
    left, slopes = partial(rows.whitened, noise=noise), partial(rows.slopes, noise=noise)
    return np.asarray(least_squares(left, start, slopes, x_scale="jac").x)


def _likeliest_noise(rows: RegressionRows, sizes: Array, start: Array) -> Array:
    def cost(noise: Array) -> float:
        return float(np.sum(rows.whitened(sizes, noise) ** 2)) + rows.log_volume(sizes, noise)

    first = start + np.vstack([np.zeros(3), np.eye(3)])
    found = minimize(
        cost, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.1, "initial_simplex": first}
    )
    return np.asarray(found.x)


def _likeliest_delay(path: PathAndReadings, sizes: Array, noise: Array) -> float:
    within = (-MAX_DELAY_S, MAX_DELAY_S)
    cost = partial(_cost_of_delay, path, sizes, noise)
    return float(minimize_scalar(cost, bounds=within, method="bounded", options={"xatol": 1e-3}).x)


def _cost_of_delay(path: PathAndReadings, sizes: Array, noise: Array, delay_s: float) -> float:
    rows = path.rows(delay_s)
    return float(np.sum(rows.whitened(rows.at(float(sizes[0]), noise), noise) ** 2))


def _delay_std(path: PathAndReadings, sizes: Array, noise: Array, delay_s: float) -> float:
    """By how the cost, a chi-square, grows to both sides."""
    at = np.clip(delay_s, -MAX_DELAY_S + _ASIDE_S, MAX_DELAY_S - _ASIDE_S)
    costs = [_cost_of_delay(path, sizes, noise, float(at + side)) for side in (-_ASIDE_S, 0.0, _ASIDE_S)]
    curvature = (costs[0] + costs[2] - 2 * costs[1]) / _ASIDE_S**2
    return float(np.sqrt(2.0 / curvature)) if curvature > 0 else float("inf")


def _found(
    rows: RegressionRows, by_gains: Array, sizes: Array, noise: Array, delay: tuple[float, float]
) -> InertialScale | NoScale:
    scale, offset, arm = float(sizes[0]), sizes[1:4], sizes[4:]
    left, w = rows.left(sizes), rows.weight(sizes, noise)
    spread = rows.of_poses(noise)[:, None, None, None] * rows.column_noise
    information = np.einsum("rak,ra,ral->kl", rows.known, w, rows.known, optimize=True) + PRIOR
    # The poses' own noise looks like a way, too; where chance explains all of it, nothing moved.
    information -= np.einsum("ra,rakl->kl", w, spread)
    chance = float(np.sqrt(2 * np.sum((w * spread[:, :, 0, 0]) ** 2)))
    if information[0, 0] <= _SURE * chance or np.linalg.eigvalsh(information)[0] <= 0:
        return _HARDLY_MOVED
    score = np.einsum("ra,ra,rak->rk", w, left, rows.known)
    score += np.einsum("ra,rak->rk", (w * left) ** 2, spread @ sizes)
    count = int(rows.stretch.max()) + 1
    by_stretch = np.zeros((count, 7))
    np.add.at(by_stretch, rows.stretch, score)
    inverse = np.linalg.inv(information)
    # Stretches may differ by more than white noise has them.
    between = inverse @ (by_stretch.T @ by_stretch) @ inverse * count / (count - 1)
    std = np.sqrt(np.maximum(np.diag(inverse), np.diag(between)))
    moved = inverse[0] @ np.einsum("rak,ra,rag->kg", rows.known, w, by_gains, optimize=True)
    if np.linalg.norm(offset) > _MOST_OFFSET_M_S2:
        return _UNLIKE
    if not scale > _SURE * std[0]:
        return _HARDLY_MOVED
    return InertialScale(
        scale,
        float(std[0]),
        _triple(offset),
        _triple(std[1:4]),
        _triple(arm),
        _triple(std[4:7]),
        *delay,
        _triple(moved / scale),
    )


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
