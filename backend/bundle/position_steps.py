"""Test of a refinement for a step in the measured positions: from one on, all lie aside by the same.

Positions that are more exact than the pictures hold their poses, and the map bends until it follows them.
Their residuals stay small whatever they are, but those of many together have a direction. The step is tested
by its score, the gradient by its size with all variables eliminated.

Source: Rao 1948 (score test); the largest of several tests counts by Bonferroni's inequality.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.bundle.factors import OFFSET, WORLD
from backend.bundle.minimise import BundleOptimum
from backend.bundle.reduced_system import columns_at_once
from backend.quantiles import chi_square_limit
from backend.significance import FALSE_ALARM, RIVAL_CHI_SQUARE, SURE_SIGMAS
from backend.sparse_cholesky import SingularMatrixError

Array = NDArray[np.float64]

_MOST_STEPS = 64
"""Positions at which a step is tried. One between two of these shows at both."""
_LEAST_BESIDE = 3
"""Positions on each side of a step. Of two, one may be wrong, which other tests tell."""
_HELD = 0.5
"""Least mean leverage of positions that hold their poses. The residuals of others show their errors."""
_SEEN = 1e-6
"""Share of its squares that elimination must leave of a step: less is rounding, and nothing tells it."""


@dataclass(frozen=True)
class PositionStep:
    """A step in the measured positions."""

    keyframe: int
    """The first one that it shows at."""
    shift_m: Array
    """(3,) east, north and up, of the later positions against the earlier ones; (2,) without heights."""
    std_m: Array
    """(3,) or (2,), its standard deviations."""


def position_step(optimum: BundleOptimum) -> PositionStep | None:
    """Return the most significant step beyond chance; None without any, or where the pictures are more exact
    than the positions."""
    positions = optimum.problem.measurements.positions
    n = len(positions)
    if n < 2 * _LEAST_BESIDE:
        return None
    axes = np.flatnonzero(np.isfinite([p.std_m for p in positions]).all(axis=0))
    keyframes = np.array([p.k for p in positions])
    try:
        linear = optimum.linearise()
        factor = linear.eliminate().factor
    except SingularMatrixError:
        return None
    rows = np.flatnonzero(optimum.cost.pose_side.rows_of("position"))
    jacobian, residuals = linear.pose_side.tocsr()[rows], linear.pose_side_right[rows]
    del linear  # its blocks are as large as the columns of the steps
    # A step is an offset of the later positions alone.
    aside = -jacobian[:, optimum.structure.columns_of([WORLD])[0][OFFSET][axes]].toarray()
    steps = n - 2 * _LEAST_BESIDE + 1
    tried = np.unique(np.linspace(0, steps - 1, min(steps, _MOST_STEPS)).astype(int))
    first = np.sort(keyframes)[_LEAST_BESIDE + tried]
    each = columns_at_once(factor.elimination.size, _MOST_STEPS * len(axes)) // len(axes)
    parts = []
    for some in np.split(first, np.arange(max(each, 1), len(first), max(each, 1))):
        is_later = np.repeat(keyframes[:, None] >= some, 3, axis=0)
        later = is_later[:, :, None] * aside[:, None, :]
        right = np.asarray(jacobian.T @ later.reshape(len(rows), -1))
        solved = factor.solve(right).reshape(-1, *later.shape[1:])
        absorbed = _step_by_step(right.reshape(solved.shape), solved)
        parts.append((_step_by_step(later, later), absorbed, -np.einsum("rsa,r->sa", later, residuals)))
    squares, absorbed, score = (np.concatenate(part) for part in zip(*parts, strict=True))
    share = float(np.einsum("saa->", absorbed) / np.einsum("saa->", squares))
    if share < _HELD:
        return None
    # Noise that came out smaller than stated may be so by chance: few residuals are left to tell it.
    stated_m = np.median([p.std_m[axes] for p in positions], axis=0)
    chance = 1.0 + SURE_SIGMAS / np.sqrt(2.0 * max((1.0 - share) * n * len(axes), 1.0))
    doubt = float(np.clip(np.max(stated_m / optimum.noise.position_m[axes]), 1.0, chance))
    return _largest(first, squares / doubt**2, (squares - absorbed) / doubt**2, score / doubt**2)


def _step_by_step(one: Array, other: Array) -> Array:
    """Return the products (s, d, d) of columns (rows, s, d) with the others of the same step."""
    return np.asarray(one.transpose(1, 2, 0) @ other.transpose(1, 0, 2))


def _largest(keyframes: NDArray[np.int64], squares: Array, left: Array, score: Array) -> PositionStep | None:
    """Return the step with the largest score beyond chance, of those at ``keyframes`` (s,).

    ``left`` (s, d, d) is the information of the steps along d axes, which had ``squares`` (s, d, d) before
    elimination, and ``score`` (s, d). Of scores that are equally good, that of the step nearest to the middle
    counts.
    """
    d = score.shape[1]
    steps, statistics = [], []
    for at, keyframe in enumerate(keyframes.tolist()):
        if np.linalg.eigvalsh(left[at])[0] <= _SEEN * squares[at].trace():
            continue
        covariance = np.linalg.inv(left[at])
        steps.append((at, PositionStep(keyframe, covariance @ score[at], np.sqrt(np.diag(covariance)))))
        statistics.append(float(score[at] @ covariance @ score[at]))
    largest = max(statistics, default=0.0)
    if largest <= chi_square_limit(FALSE_ALARM / len(keyframes), d):
        return None
    good = [step for step, by in zip(steps, statistics, strict=True) if by >= largest - RIVAL_CHI_SQUARE]
    return min(good, key=lambda each: abs(each[0] - (len(keyframes) - 1) / 2))[1]
