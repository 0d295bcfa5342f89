"""The heights that floor points show: the relief of the ground, and what stands on it.

A point lies on the ground, or on structure that stands there: a roof, a crown of a tree, a beam. Heights of
both kinds are normally distributed about the floor, those of structure wider. The height of a point by its
pictures alone has the variance of its kind and that of the pictures. Spreads and share of both kinds are
found from all heights (empirical Bayes); where the ground alone explains them, there is no structure. Nor is
there any where points far below the ground lie beside each other, as those above do: these are hills and
hollows.

Source: Efron and Morris 1973 (empirical Bayes); Dempster, Laird and Rubin 1977 (mixtures); Celeux and Govaert
1992 (each of the kind that is more probable); Schwarz 1978.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc

from backend.bundle.free_points import FreePoints
from backend.bundle.problem import NoiseLevels
from backend.bundle.relief_correlation import design_effect
from backend.significance import FALSE_ALARM

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
_LEAST_GROUND = 1.0 / 3.0
"""Least share of the points that lie on the ground."""
_WITHIN = 0.4307
"""Size that a normal variable of unit variance stays below with that probability."""
_PLANES = 300
"""Planes that are tried for the ground."""
_AS_EVEN = 5.0
"""Factor on the distances to the best plane up to which another one is as even. That may be of roofs with two
thirds of the points: a third of the heights is then nearer by 2.9, and planes through three points err by
the root of three heights."""
_REFITS = 5
"""Fits of the plane to the points near it; each is more exact."""


@dataclass(frozen=True)
class Heights:
    """Relief and structure that the heights of all points show, over the mean height."""

    relief: float
    structure: float
    """Standard deviation of the heights of structure."""
    inflation: float
    """Factor on the relief for points that rise and fall with their neighbours."""
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

    Heights are over the floor if the fit has it ``level`` at zero, and else over the plane of the ground.
    """
    known = (free.agreeing >= 2) & (free.information * start.relief**2 > _LEAST_INFORMATION)
    none, on_ground = np.zeros(len(known), bool), known & (used >= 2)
    if on_ground.sum() < _LEAST_POINTS:
        return Heights(start.relief, start.structure, start.relief_inflation, none, none)
    z, variance = free.height, free.variance
    if not level:
        z -= _plane(free.point[:, :2], z, on_ground)
    relief = _relief(z[on_ground], variance[on_ground], start.relief)
    judged = known & (free.agreeing >= LEAST_PICTURES)
    place = free.point[:, :2]
    effect = design_effect(place[judged], z[judged], variance[judged], relief)
    found = _with_structure(z[judged], variance[judged], relief, start.relief, effect)
    high, structure = none.copy(), start.structure
    if found is not None:
        high[known] = replace(found, z=z[known], variance=variance[known]).probabilities > 0.5
    if found is not None and _rolls(place[judged], z[judged], high[judged]):
        found, high = None, none.copy()
    if found is not None:
        on_ground &= ~high
        relief, structure = _relief(z[on_ground], variance[on_ground], start.relief), found.structure
    effect = design_effect(place[on_ground], z[on_ground], variance[on_ground], relief)
    doubtful = high & (free.pictures < LEAST_PICTURES)
    return Heights(relief, structure, float(np.sqrt(effect)), high & judged, doubtful)


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


def _with_structure(z: Array, variance: Array, relief: float, start: float, effect: float) -> _Mixture | None:
    """Return the kinds of points, None where the ground alone explains the heights.

    Two more numbers must gain more than their Bayesian information criterion. It counts the points over their
    design ``effect``: a few waves of the ground have any distribution of heights. ``relief`` is that of
    ground alone. With much structure it is too large: ground as even as a third of the points is tried too.
    """
    if len(z) < _LEAST_POINTS:
        return None
    best, widest = None, float(np.sqrt(max(float(np.mean(z**2 - variance)), 0.0)))
    alone = max(_Mixture(z, variance, each, each, 0.5).log_likelihood for each in (relief, widest))
    least = alone + effect * np.log(max(len(z) / effect, np.e))
    for each in (relief, min(relief, _core(z, variance))):
        found = _Mixture.fitted(z, variance, each)
        if found is None or found.log_likelihood <= alone:
            continue
        on_ground = found.probabilities <= 0.5
        found = _Mixture.fitted(z, variance, _relief(z[on_ground], variance[on_ground], start)) or found
        if found.log_likelihood > least:
            best, least = found, found.log_likelihood
    return best


def _rolls(xy: Array, z: Array, far: Mask) -> bool:
    """Return whether heights (t,) ``far`` (t,) from the ground are its hills and hollows, and no structure.

    Structure stands on the ground. Points far below it are single mistakes, unless they lie beside each
    other, as those of hollows do. Of hills and hollows, about as many independent heights are above as below.
    """
    above, below = far & (z > 0), far & (z < 0)
    effect_above, effect_below = _cluster_effect(xy, above), _cluster_effect(xy, below)
    heights_above = np.count_nonzero(above) / effect_above
    heights_below = np.count_nonzero(below) / effect_below
    # The probability that no more of these heights than found are below, if either sign is as probable.
    chance = betainc(heights_above, heights_below + 1.0, 0.5)
    return bool(effect_below > 1.0 and chance > FALSE_ALARM)


def _cluster_effect(xy: Array, chosen: Mask) -> float:
    """Return the design effect of clusters: how many of the ``chosen`` (t,) points count as one."""
    share = float(np.mean(chosen))
    std = float(np.sqrt(share * (1.0 - share)))
    return design_effect(xy, chosen.astype(float) - share, np.zeros(len(chosen)), std) if std > 0 else 1.0


def _plane(xy: Array, z: Array, known: Mask) -> Array:
    """Return the heights (t,) of the plane of the ground at the places (t, 2), by the ``known`` ones.

    Of planes through three points, those count to which a third of the points are nearest, and the lowest of
    these is the ground: flat roofs may be as even. One of the planes is on a ground of a third of the points
    with a probability of 1 - (26/27)^`_PLANES`. Sources: Rousseeuw 1984 (least quantile);
    Rousseeuw and van Driessen 2006 (refits).
    """
    terms = np.column_stack([np.ones(len(z)), xy])
    of_known, z_known, rng = terms[known], z[known], np.random.default_rng(0)
    threes = [rng.choice(len(z_known), 3, replace=False) for _ in range(_PLANES)]
    planes = np.array([np.linalg.lstsq(of_known[three], z_known[three])[0] for three in threes])
    off = [float(np.quantile(np.abs(z_known - of_known @ plane), _LEAST_GROUND)) for plane in planes]
    even = np.flatnonzero(np.array(off) <= _AS_EVEN * min(off))
    plane = planes[even[np.argmin(planes[even] @ of_known.mean(axis=0))]]
    for _ in range(_REFITS):
        away = np.abs(z_known - of_known @ plane)
        near = away <= _FAR / _WITHIN * np.quantile(away, _LEAST_GROUND)
        plane = np.linalg.lstsq(of_known[near], z_known[near])[0]
    return np.asarray(terms @ plane)


def _core(z: Array, variance: Array) -> float:
    """Return the relief at which a third of the points lie where a third of a normal distribution does."""
    low, high = _LEAST_RELIEF, float(np.abs(z).max()) + _LEAST_RELIEF
    while high > 1.1 * low:
        middle = float(np.sqrt(low * high))
        if np.quantile(np.abs(z) / np.sqrt(middle**2 + variance), _LEAST_GROUND) > _WITHIN:
            low = middle
        else:
            high = middle
    return high
