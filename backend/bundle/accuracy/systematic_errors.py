"""Test of a refinement for errors that all pictures, or all positions, share: the lens, and an offset.

Such an error leaves residuals that depend on the place in the picture alike in all pictures. Each kind is
tested by its score: the gradient by its coefficients, with poses, points and world eliminated. The same
equations give the amount by which the error displaces the poses, to be compared with their covariances.

Noise is not independent within a picture. The variance of the score is therefore that between pictures, but
at least the model's, and corrected for the correlation of successive pictures.

Source: Rao 1948 (score test); Rao and Scott 1984, and Thomas and Rao 1987 (design effect and its F test).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.accuracy.systematic_terms import Kind, added_columns
from backend.bundle.factors import WORLD
from backend.bundle.metric_poses import metric_jacobians
from backend.bundle.minimise import BundleOptimum
from backend.bundle.reduced_system import columns_at_once
from backend.bundle.residual_spread import autocorrelated_std
from backend.errors import BackendError
from backend.quantiles import f_tail
from backend.significance import FALSE_ALARM
from backend.sparse_cholesky import SingularMatrixError

Array = NDArray[np.float64]

_ROUNDING = 1e-9
"""Share of a column's squares that elimination must leave: less is rounding, and the column is unobserved."""
_PARALLEL = 1e-12
"""Share of a known column, all of unit length, that makes it a multiple of the others by rounding."""

_DRAWS = 16
"""Draws of noise that measure how much of it the fit absorbs: to 6 % with 16 pictures."""


@dataclass(frozen=True)
class SystematicErrors:
    """Errors that the residuals of all pictures, or of all positions, share."""

    coefficients: Mapping[Kind, tuple[float, ...]]
    """The coefficients of each kind, the strongest evidence first: of the lens as in
    `systematic_terms.lens_displacement`; of an offset, metres forward and left. One step of Gauss and Newton
    finds them, so that large ones are rough."""
    stds: Mapping[Kind, tuple[float, ...]]
    """Their standard deviations."""
    alternatives: tuple[Kind, ...]
    """Other kinds that explain the residuals as well in the place of one of these."""
    p_value: float
    """Probability of such scores without the errors."""
    excess: float
    """Mean square by which the errors displace poses, over their covariances and six degrees of freedom. With
    1, the squared errors of the poses are twice those that the covariances state."""
    shift_m: float
    """Root mean square by which they displace positions."""
    tilt_rad: float
    """The same for attitudes."""


@dataclass(frozen=True)
class ErrorTest:
    """Evidence in the residuals of a refinement of errors that all pictures or all positions share."""

    errors: SystematicErrors | None
    """Those beyond chance; None without any."""
    detectable: Mapping[Kind, float]
    """Standard deviation of the least certain coefficient of each kind; a kind that the unknowns absorb
    whatever its size is missing."""
    p_values: Mapping[Kind, float]
    """Probability of the score of each of these kinds by chance, each tested alone."""


def error_test(optimum: BundleOptimum, covariances: Array) -> ErrorTest | None:
    """Return the errors beyond chance, and which ones would be seen; None without covariances.

    ``covariances`` (n, 6, 6) are those of the metric poses.

    Raises ``BackendError`` where the equations are singular, so that nothing can be tested.
    """
    known = np.isfinite(covariances).all(axis=(1, 2))
    if not known.any():
        return None
    try:
        scores, moved = _eliminate(optimum)
    except SingularMatrixError:
        raise BackendError("the equations of the refinement are singular by rounding") from None
    detectable = {kind: scores.largest_std(kind) for kind in scores.columns}
    p_values = {kind: scores.test([kind], ()).p_value for kind in scores.columns}
    found, alternatives = scores.search()
    errors = _errors(covariances, scores, moved, found, alternatives) if found else None
    return ErrorTest(errors, detectable, p_values)


def _errors(
    covariances: Array,
    scores: _Scores,
    moved: Mapping[Kind, Array],
    found: tuple[Kind, ...],
    alternatives: tuple[Kind, ...],
) -> SystematicErrors:
    """Return the sizes of the errors ``found``, and by how much they displace the poses."""
    known = np.isfinite(covariances).all(axis=(1, 2))
    fit = scores.test(found, ())
    by_pose = np.concatenate([moved[kind] for kind in found], axis=2)[known]
    excess, shift, tilt = (
        _mean_square(fit, by_pose, weight)
        for weight in (np.linalg.pinv(covariances[known], hermitian=True) / 6, _POSITION, _ATTITUDE)
    )
    each = {kind: scores.test([kind], [other for other in found if other != kind]) for kind in found}
    return SystematicErrors(
        coefficients={kind: tuple(test.coefficients.tolist()) for kind, test in each.items()},
        stds={kind: tuple(np.sqrt(np.diag(test.covariance)).tolist()) for kind, test in each.items()},
        alternatives=alternatives,
        p_value=fit.p_value,
        excess=excess,
        shift_m=float(np.sqrt(shift)),
        tilt_rad=float(np.sqrt(tilt)),
    )


@dataclass(frozen=True)
class _Test:
    p_value: float
    coefficients: Array
    covariance: Array


@dataclass(frozen=True)
class _Scores:
    """Products of the columns of all kinds, with poses, points and world eliminated, picture by picture."""

    columns: Mapping[Kind, list[int]]
    """Places of the columns of each kind among all c."""
    squares: Array
    """(n, c, c) products of the columns with each other."""
    sums: Array
    """(n, 1 + d, c) products with the whitened residuals, and with those of ``d`` draws of independent
    noise."""

    def test(self, kinds: Sequence[Kind], given: Sequence[Kind]) -> _Test:
        """Test kinds together, after the elimination of those that are ``given``."""
        squares, sums = self.squares.sum(axis=0), self.sums.sum(axis=0)
        tested, known = self._places(kinds), self._places(given)
        # Of each tested column and of the residuals, the multiples of the known columns that come off.
        column, left = (_multiples(squares, known, each) for each in (squares[:, tested], sums.T))
        taken = np.zeros((len(squares), len(tested)))
        taken[tested, np.arange(len(tested))] = 1.0
        taken[known] -= column
        value, vector = np.linalg.eigh(taken.T @ squares @ taken)
        observed = value > _ROUNDING * np.linalg.eigvalsh(squares[np.ix_(tested, tested)])[-1]
        if not observed.any():  # those that are given say the same
            return _Test(1.0, np.zeros(len(tested)), np.full((len(tested),) * 2, np.inf))
        whiten = vector[:, observed] / np.sqrt(value[observed])
        each = (self.sums - left.T @ self.squares[:, known]) @ (taken @ whiten)
        count = len(each)
        total = each[:, 0].sum(axis=0)
        each -= each.mean(axis=0)
        real, white = each[:, 0], each[:, 1:]
        # At least the model's, whose noise of positions includes their correlation over several pictures.
        variance = max(1.0, float(np.mean(real**2) / np.mean(white**2)))
        # Correlated errors of successive pictures count as fewer pictures.
        autocorrelation = float(autocorrelated_std(real) ** 2 / max(np.mean(real**2), np.finfo(float).tiny))
        design_effect = variance * autocorrelation
        freedom = len(total) * (count - 1) / autocorrelation
        statistic = float(total @ total) / (len(total) * design_effect)
        p_value = f_tail(statistic, len(total), max(freedom, 1.0))
        return _Test(p_value, whiten @ total, whiten @ whiten.T * design_effect)

    def largest_std(self, kind: Kind) -> float:
        """Return the standard deviation of the least certain coefficient, at the noise of the model."""
        at = self.columns[kind]
        least = float(np.linalg.eigvalsh(self.squares.sum(axis=0)[np.ix_(at, at)])[0])
        return 1.0 / np.sqrt(least) if least > 0 else np.inf

    def _places(self, kinds: Sequence[Kind]) -> list[int]:
        return [place for kind in kinds for place in self.columns[kind]]

    def search(self) -> tuple[tuple[Kind, ...], tuple[Kind, ...]]:
        """Return the kinds of errors, the strongest first, and other kinds that could replace one of them.

        One kind after the other is added, and those that later ones make superfluous are left out.
        """
        limit, found = FALSE_ALARM / max(len(self.columns), 1), list[Kind]()
        while True:
            left = {kind: self._p_value(kind, found) for kind in self.columns if kind not in found}
            best = min(left, key=left.__getitem__, default=None)
            if best is None or left[best] >= limit:
                break
            found.append(best)
        while True:
            found.sort(key=lambda kind: self._p_value(kind, found))
            if len(found) < 2 or self._p_value(found[-1], found) < limit:
                break
            found.pop()
        others = tuple(
            kind
            for kind in self.columns
            if kind not in found and any(self._p_value(one, [*found, kind]) >= limit for one in found)
        )
        return tuple(found), others

    def _p_value(self, kind: Kind, given: Sequence[Kind]) -> float:
        return self.test([kind], [other for other in given if other != kind]).p_value


def _multiples(squares: Array, known: Sequence[int], products: Array) -> Array:
    """Return the multiples (k, v) of known columns nearest to vectors, whose products with all columns are
    ``products`` (c, v), in least squares."""
    own = squares[np.ix_(known, known)]
    unit = 1.0 / np.sqrt(np.diag(own))
    inverse = np.linalg.pinv(unit[:, None] * own * unit, rcond=_PARALLEL, hermitian=True)
    return unit[:, None] * (inverse @ (unit[:, None] * products[known]))


def _eliminate(optimum: BundleOptimum) -> tuple[_Scores, Mapping[Kind, Array]]:
    """Return the scores, and the displacements (n, 6, c) of metric poses by a unit of each coefficient."""
    added = added_columns(optimum)  # before the system is in memory: its derivatives are as large
    linear, reduced = optimum.eliminated()

    def absorbed_by_fit(column: Array) -> tuple[Array, Array]:
        """Return what all variables absorb of columns, and the change of those of the pose side."""
        by_pose, by_point = reduced.solve(*linear.transposed_times(column))
        return linear.times(by_pose, by_point), by_pose

    moves = _moves(optimum)
    kept: list[Array] = []
    places: dict[Kind, list[int]] = {}
    moved: dict[Kind, Array] = {}
    for kind, column in added.columns.items():
        before = np.sum(column**2, axis=0)
        fitted, change = absorbed_by_fit(column)
        column -= fitted
        if (np.sum(column**2, axis=0) <= _ROUNDING * before).all():
            continue
        places[kind] = [*range(len(kept), len(kept) + column.shape[1])]
        kept += [*column.T]
        moved[kind] = moves(change)
    count = int(added.keyframe.max()) + 1
    sums = [_by_picture([linear.right], kept, added.keyframe, count)]
    rng, rows = np.random.default_rng(0), len(linear.right)
    at_once = columns_at_once(rows, _DRAWS)
    for begin in range(0, _DRAWS, at_once):
        # Draw by draw, so that they are the same however many there are at once.
        white = np.ascontiguousarray(rng.standard_normal((min(at_once, _DRAWS - begin), rows)).T)
        white -= absorbed_by_fit(white)[0]
        sums.append(_by_picture([*white.T], kept, added.keyframe, count))
    squares = _by_picture(kept, kept, added.keyframe, count)
    return _Scores(places, squares, np.concatenate(sums, axis=1)), moved


def _by_picture(
    left: Sequence[Array], columns: Sequence[Array], picture: NDArray[np.int64], count: int
) -> Array:
    """Return the products (count, d, c) of d vectors (rows,) and c columns, summed picture by picture."""
    sums = np.zeros((count, len(left), len(columns)))
    for place in np.ndindex(sums.shape[1:]):
        sums[:, *place] = np.bincount(picture, left[place[0]] * columns[place[1]], count)
    return sums


def _moves(optimum: BundleOptimum) -> Callable[[Array], Array]:
    """Return the function from changes (size, c) of the pose side to displacements (n, 6, c) of the metric
    poses that these errors make."""
    to_metres = metric_jacobians(optimum.problem, optimum.values)
    n = len(to_metres)
    of_poses = optimum.structure.columns_of([POSE(k) for k in range(n)])

    def moved(change: Array) -> Array:
        world = change[optimum.structure.columns(WORLD)]
        both = np.concatenate([change[of_poses], np.repeat(world[None], n, axis=0)], axis=1)
        return np.asarray(-to_metres @ both)

    return moved


_ATTITUDE, _POSITION = np.diag([1.0, 1, 1, 0, 0, 0]), np.diag([0.0, 0, 0, 1, 1, 1])


def _mean_square(fit: _Test, moved: Array, weight: Array) -> float:
    """Return the mean of d' W d over poses displaced by d (n, 6, c), without the part that is noise."""
    square = np.mean(np.swapaxes(moved, 1, 2) @ weight @ moved, axis=0)
    by_noise = float(np.trace(square @ fit.covariance))
    return max(float(fit.coefficients @ square @ fit.coefficients) - by_noise, 0.0)
