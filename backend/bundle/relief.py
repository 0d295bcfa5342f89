"""The heights that floor points show: the relief of the ground, and what stands on it.

A point lies on the ground, or on structure that stands there: a roof, a crown of a tree, a beam. Heights of
both kinds are normally distributed about the floor, those of structure wider. The height of a point by its
pictures alone has the variance of its kind and that of the pictures. Spreads and share of both kinds are
found from all heights (empirical Bayes); where the ground alone explains them, there is no structure.

Source: Efron and Morris 1973 (empirical Bayes); Dempster, Laird and Rubin 1977 (mixtures); Celeux and Govaert
1992 (each of the kind that is more probable); Schwarz 1978.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.free_points import FreePoints
from backend.bundle.graph import NoiseLevels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STUDENT_SCALE = 0.831
"""Scale c of Student's t with 4 degrees of freedom fitted to N(0, 1): E[5 x^2 / (4 c^2 + x^2)] = 1."""
LEAST_PICTURES = 3
"""Pictures that a point needs to have a height of its own: in two, one that moved along the flight may have
any height."""
_LEAST_POINTS = 20
"""Points of known height below which the relief stays what it was."""
_LEAST_INFORMATION = 1e-3
"""Information on a height, over that of the relief, below which it tells nothing of the relief."""
_LEAST_RELIEF = 2e-4
"""Least relief, over the mean height: 20 mm from 100 m."""
_ITERATIONS = 20
"""Steps in which share and spread of the structure are found."""
_FAR = 3.0
"""Standard deviations from the ground from which points count as structure at first."""
_PLANES = 100
"""Planes that are tried for the ground."""
_MEDIAN = 0.6745
"""Median of the size of a normal variable of unit variance."""


@dataclass(frozen=True)
class Heights:
    """Relief and structure that the heights of all points show, over the mean height."""

    relief: float
    structure: float
    """Standard deviation of the heights of structure."""
    raised: Mask
    """(t,) points that more probably are structure."""
    doubtful: Mask
    """(t,) points of too few pictures to tell, that would be structure if they did not move."""


@dataclass(frozen=True)
class _Mixture:
    """Heights z (t,) by the pictures alone and their variances, of two kinds of points."""

    z: Array
    variance: Array
    relief: float
    structure: float
    share: float

    @property
    def _log_densities(self) -> tuple[Array, Array]:
        """Logarithms of the densities (t,) of heights of the ground, and of structure, times their shares."""
        ground, structure = self.relief**2 + self.variance, self.structure**2 + self.variance
        return (
            np.log1p(-self.share) - 0.5 * (np.log(ground) + self.z**2 / ground),
            np.log(self.share) - 0.5 * (np.log(structure) + self.z**2 / structure),
        )

    @property
    def log_likelihood(self) -> float:
        return float(np.sum(np.logaddexp(*self._log_densities)))

    @property
    def probabilities(self) -> Array:
        """Probabilities (t,) that points are structure."""
        ground, structure = self._log_densities
        return np.asarray(1.0 / (1.0 + np.exp(np.minimum(ground - structure, 700.0))))

    @staticmethod
    def fitted(z: Array, variance: Array, relief: float) -> _Mixture | None:
        """Find share and spread of the structure over the ground, None if no point is far from it."""
        of_structure = (np.abs(z) > _FAR * np.sqrt(relief**2 + variance)).astype(float)
        found = None
        for _ in range(_ITERATIONS if of_structure.any() else 0):
            count = np.sum(of_structure)
            squares = float(np.sum(of_structure * (z**2 - variance)) / count)
            share = float((count + 1.0) / (len(z) + 2.0))  # Laplace's rule: neither 0 nor 1
            found = _Mixture(z, variance, relief, float(np.sqrt(max(squares, relief**2))), share)
            before, of_structure = of_structure, found.probabilities
            if np.abs(of_structure - before).max() < 0.01:
                break
        return found


def find_heights(
    free: FreePoints, used: NDArray[np.int64], start: NoiseLevels, level: bool = True
) -> Heights:
    """Return relief and structure by the pictures alone. ``used`` (t,) counts the observations in use.

    Heights are over the floor if the fit has it ``level`` at zero, and else over the plane of most points.
    """
    known = (free.agreeing >= 2) & (free.information * start.relief**2 > _LEAST_INFORMATION)
    none, on_ground = np.zeros(len(known), bool), known & (used >= 2)
    if on_ground.sum() < _LEAST_POINTS:
        return Heights(start.relief, start.structure, none, none)
    z, variance = free.height, free.variance
    if not level:
        z -= _plane(free.point[:, :2], z, on_ground)
    relief = _relief(z[on_ground], variance[on_ground], start.relief)
    judged = known & (free.agreeing >= LEAST_PICTURES)
    found = _with_structure(z[judged], variance[judged], relief, start.relief)
    if found is None:
        return Heights(relief, start.structure, none, none)
    high = none.copy()
    high[known] = replace(found, z=z[known], variance=variance[known]).probabilities > 0.5
    on_ground &= ~high
    relief = _relief(z[on_ground], variance[on_ground], start.relief)
    return Heights(relief, found.structure, high & judged, high & (free.pictures < LEAST_PICTURES))


def _relief(z: Array, variance: Array, start: float) -> float:
    """Return the standard deviation of the ground's relief by maximum likelihood.

    The height of a point from the pictures alone is N(0, relief² + variance).
    """
    if len(z) == 0:
        return start
    grid = start * np.geomspace(1e-2, 1e2, 81)
    both = grid[:, None] ** 2 + variance
    # Student's loss: a few points on walls or wrong matches must not raise the relief. STUDENT_SCALE makes
    # it consistent for Gaussian heights.
    loss = np.sum(0.5 * np.log(both) + 2.5 * np.log1p(z**2 / (4.0 * STUDENT_SCALE**2 * both)), axis=1)
    return float(np.clip(grid[np.argmin(loss)], max(0.05 * start, _LEAST_RELIEF), 20 * start))


def _with_structure(z: Array, variance: Array, relief: float, start: float) -> _Mixture | None:
    """Return the kinds of points, None where the ground alone explains the heights.

    Two more numbers must gain more than their Bayesian information criterion. ``relief`` is that of ground
    alone: with much structure it is too large, so that ground as even as half of the points is tried too.
    """
    if len(z) < _LEAST_POINTS:
        return None
    best, widest = None, float(np.sqrt(max(float(np.mean(z**2 - variance)), 0.0)))
    alone = max(_Mixture(z, variance, each, each, 0.5).log_likelihood for each in (relief, widest))
    least = alone + np.log(len(z))
    for each in (relief, min(relief, _core(z, variance))):
        found = _Mixture.fitted(z, variance, each)
        if found is None or found.log_likelihood <= alone:
            continue
        on_ground = found.probabilities <= 0.5
        found = _Mixture.fitted(z, variance, _relief(z[on_ground], variance[on_ground], start)) or found
        if found.log_likelihood > least:
            best, least = found, found.log_likelihood
    return best


def _plane(xy: Array, z: Array, known: Mask) -> Array:
    """Return the heights (t,) of the plane of most points at the places (t, 2), by the ``known`` ones.

    It has the least median of the distances among planes through three points. One of them is on a plane of
    half of the points with a probability of 1 - (7/8)^`_PLANES`. Source: Rousseeuw 1984.
    """
    terms = np.column_stack([np.ones(len(z)), xy])
    of_known, z_known, rng = terms[known], z[known], np.random.default_rng(0)
    best: Array = np.zeros(3)
    least = np.inf
    for _ in range(_PLANES):
        three = rng.choice(len(z_known), 3, replace=False)
        plane = np.linalg.lstsq(of_known[three], z_known[three])[0]
        off = np.abs(z_known - of_known @ plane)
        if np.median(off) < least:
            best, least = np.asarray(plane), float(np.median(off))
    near = np.abs(z_known - of_known @ best) <= _FAR / _MEDIAN * least
    return np.asarray(terms @ np.linalg.lstsq(of_known[near], z_known[near])[0])


def _core(z: Array, variance: Array) -> float:
    """Return the relief at which half of the points are within the median of a normal distribution."""
    low, high = _LEAST_RELIEF, float(np.abs(z).max()) + _LEAST_RELIEF
    while high > 1.1 * low:
        middle = float(np.sqrt(low * high))
        if np.median(np.abs(z) / np.sqrt(middle**2 + variance)) > _MEDIAN:
            low = middle
        else:
            high = middle
    return high
