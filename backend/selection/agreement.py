"""Which loops agree with trusted odometry and with each other: a set that grows from what is surest.

A false loop is told by prediction. What is believed so far predicts each other loop with a covariance; one
that lies outside is not believed, one that lies inside a *sharp* prediction is, since chance would hardly put
it there. Each loop that is believed sharpens the predictions of others. Where no prediction is sharp, each
loop is tried as a hypothesis, and the one that makes the most others agree sharply goes ahead: loops that lie
together (a floor that repeats) are then outvoted by the rest. The idea is that of pairwise consistency
(Mangelson et al. 2018, ICRA), with predictions by all that is believed instead of by odometry alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from scipy.special import gammaln
from scipy.stats import chi2

from backend import se3
from backend.problem import Problem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
Solve = Callable[[Mask, Array], Array]
"""Poses from some edges and a start."""

CHANCE = 1e-3
"""A false loop agrees with a sharp prediction once in a thousand."""

_ROUNDS = 60
_HYPOTHESES = 300
_MIXING = 50
_TAIL = 3.0
"""Limits of the noise that the others show: its tails are heavier than a Gaussian's."""
_STRIKES = 2
"""A loop may have been pulled away by others that were dropped with it: once."""
_STRETCH = 3
"""Poses between neighbouring loops of one stretch."""
_SAMPLES = {3: 60, 6: 150}


@dataclass(frozen=True)
class Innovations:
    """Edges against what the rest predicts of them; whitened by the edges' own noise."""

    edges: Index
    residual: Array
    """(k, d)."""
    spread: Array
    """(k, d, s) of the prediction, in draws."""
    log_room: Array
    """(k,) logarithm of the whitened volume in which a false loop might lie."""

    def covariance(self) -> Array:
        """(k, d, d) of edge and prediction together."""
        d = self.residual.shape[1]
        return np.eye(d) + self.spread @ np.swapaxes(self.spread, 1, 2) / self.spread.shape[2]

    def sigma(self) -> Array:
        """(k,) distance in sigmas of edge and prediction."""
        return np.sqrt(_squared(self.residual, self.covariance()))

    def log_chance(self) -> Array:
        """(k,) logarithm of the probability that a false loop agrees."""
        return _log_volume(self.covariance(), _limit(self.residual.shape[1])) - self.log_room

    def log_closer(self) -> Array:
        """(k,) logarithm of the probability that a false loop agrees better."""
        covariance = self.covariance()
        return _log_volume(covariance, _squared(self.residual, covariance)) - self.log_room


def _squared(residual: Array, covariance: Array) -> Array:
    return np.einsum("...a,...a->...", residual, np.linalg.solve(covariance, residual[..., None])[..., 0])


def _limit(d: int) -> float:
    return float(chi2.ppf(1 - CHANCE, d))


def _log_volume(covariance: Array, squared: Array | float) -> Array:
    """Logarithm of the volume of the ellipsoid at a squared distance in sigmas."""
    d = covariance.shape[-1]
    ball = d / 2 * np.log(np.pi * np.maximum(squared, 1e-12)) - gammaln(d / 2 + 1)
    return np.asarray(ball + np.linalg.slogdet(covariance)[1] / 2)


def draws(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, d: int) -> Array | None:
    """(n, d, s) draws from the Gaussian about a solution, right perturbations; None where it is singular.

    With J the whitened system, x = (J'J)^-1 J' e has the covariance (J'J)^-1 for e of unit covariance: all
    joint covariances at the price of one factor. Source: Papandreou and Yuille 2010 (NIPS).
    """
    triplets = np.asarray(graph.linearize(values).sparseJacobian_())
    size = values.size() * d
    row, column = triplets[0].astype(np.int64) - 1, triplets[1].astype(np.int64) - 1
    left = column < size
    J = csc_array((triplets[2][left], (row[left], column[left])), shape=(int(row.max()) + 1, size))
    # Noise only, and always the same: the answer must not depend on the call.
    noise = np.random.default_rng(0).standard_normal((J.shape[0], _SAMPLES[d]))
    try:
        options = {"SymmetricMode": True}
        factor = splu(csc_array(J.T @ J), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0, options=options)
    except RuntimeError:
        return None
    found = factor.solve(np.asarray(J.T @ noise))
    return found.reshape(-1, d, _SAMPLES[d]) if np.isfinite(found).all() else None


def innovations(problem: Problem, w_T: Array, drawn: Array, edges: Index, scale: float = 1.0) -> Innovations:
    """Some edges, none of which took part, against the solution ``w_T`` and its ``draws``.

    ``scale`` is how large noise is over what is stated.
    """
    some = problem.with_edges(np.isin(np.arange(len(problem.i)), edges))
    d = problem.freedom
    turn = se3.adjoint(se3.inverse(w_T[some.j]) @ w_T[some.i])
    if d == 3:
        turn = turn[:, se3.PLANAR[:, None], se3.PLANAR]
    spread = some.sqrt_information @ (drawn[some.j] - turn @ drawn[some.i])
    extent = np.ptp(w_T[:, : problem.dimension, 3], axis=0)
    room = np.log(np.maximum(extent, 1e-3 * extent.max() + 1e-9)).sum()
    room += np.log(2 * np.pi) if d == 3 else np.log(8 * np.pi**2)
    log_room = room + np.linalg.slogdet(some.sqrt_information)[1]
    return Innovations(np.sort(edges), some.residuals(w_T) / scale, spread, log_room - d * np.log(scale))


def grown(
    problem: Problem,
    base: Mask,
    w_T: Array,
    solve: Solve,
    draw: Callable[[Mask, Array], Array | None],
    on_round: Callable[[int, int], None],
) -> tuple[Mask, Array]:
    """Edges (m,) that agree, beginning with those of ``base`` (solved: ``w_T``), and the poses from them.

    ``solve`` gives poses from some edges and a start, ``draw`` the draws about them.
    """
    kept, dropped = base.copy(), np.zeros(len(base), dtype=np.int64)
    limit, places = _limit(problem.freedom), _places(problem.i, problem.j)
    for number in range(_ROUNDS):
        drawn = draw(kept, w_T)
        if drawn is None:
            break
        left = np.flatnonzero(~kept & (dropped < _STRIKES))
        scale = noise_scale(problem, kept, w_T)
        if number == 0:
            scale = _first_scale(innovations(problem, w_T, drawn, left), places[left])
        pending = innovations(problem, w_T, drawn, left, scale)
        joined = _joining(pending, places, limit, _believed(kept, base))
        if len(joined) == 0:
            break
        kept[joined] = True
        w_T = solve(kept, w_T)
        squared = (problem.residuals(w_T) ** 2).sum(axis=1)
        out = kept & ~base & (squared > limit * scale**2)
        if out.any():
            # The worst go first: those that they pulled away may agree without them.
            out &= squared >= np.quantile(squared[out], 0.5)
            kept, dropped = kept & ~out, dropped + out
            w_T = solve(kept, w_T)
        on_round(number, int(kept.sum()))
    return kept, w_T


def _first_scale(pending: Innovations, place: Index) -> float:
    """The same before any loop is believed: from how close to their prediction the closest lie.

    Expectation maximisation over a mixture: true loops about the prediction, false ones anywhere.
    """
    d = pending.residual.shape[1]
    covariance = pending.covariance()
    squared = _squared(pending.residual, covariance)
    peak = -d / 2 * np.log(2 * np.pi) - np.linalg.slogdet(covariance)[1] / 2 + pending.log_room
    true, variance = 0.5, float(np.quantile(squared, 0.1)) / d
    for _ in range(_MIXING):
        odds = peak - squared / variance / 2 - d / 2 * np.log(variance) + np.log(true / (1 - true))
        share = 1 / (1 + np.exp(-np.clip(odds, -50, 50)))
        variance = max(float(share @ squared) / (d * max(float(share.sum()), 1e-9)), 1e-12)
        true = float(np.clip(share.mean(), 0.01, 0.99))
    # Loops between the same places lie equally far off: they tell but once.
    freedom = d * max(len(np.unique(place[share > 0.5])), 1)
    return float(np.sqrt(min(variance * freedom / chi2.ppf(CHANCE, freedom), 1.0)))


def judged(problem: Problem, kept: Mask, w_T: Array, drawn: Array) -> tuple[Mask, Array]:
    """Which other edges agree with a solution after all (m,), and by how many sigmas they are off (m,).

    One agrees that lies within its own covariance as it is stated, not far outside of what the others show
    noise to be, and closer to the prediction than false loops would.
    """
    edges, scale = np.flatnonzero(~kept), noise_scale(problem, kept, w_T)
    agrees, sigma = np.zeros_like(kept), np.full(len(kept), np.nan)
    if len(edges) == 0:
        return agrees, sigma
    found = innovations(problem, w_T, drawn, edges, scale)
    place = _places(problem.i[edges], problem.j[edges])
    sigma[edges] = found.sigma()
    within = found.sigma() <= np.sqrt(_limit(problem.freedom)) * np.clip(1 / scale, 1, _TAIL)
    agrees[edges] = _sure(found.log_closer(), within, place, _DOUBT)
    return agrees, sigma


def noise_scale(problem: Problem, kept: Mask, w_T: Array) -> float:
    """How large noise is over what covariances state, from the loops that are kept.

    1 unless chance does not explain another figure. Covariances that are too wide by far would let false
    loops through, since these agree with anything; then the largest scale that chance explains is taken.
    """
    d = problem.freedom
    freedom = d * (int(kept.sum()) - problem.count + 1)
    if freedom <= 0:
        return 1.0
    statistic = float((problem.residuals(w_T)[kept] ** 2).sum())
    if statistic > chi2.ppf(1 - CHANCE, freedom):
        return float(np.sqrt(statistic / freedom))
    return float(np.sqrt(min(statistic / chi2.ppf(CHANCE, freedom), 1.0)))


def _believed(kept: Mask, base: Mask) -> float:
    """Share of the loops that are believed, with one of each kind for granted."""
    return (1 + (kept & ~base).sum()) / (2 + (~base).sum())


def _joining(pending: Innovations, places: Index, limit: float, believed: float) -> Index:
    """Which edges to believe next."""
    agrees = pending.sigma() ** 2 <= limit
    if not agrees.any():
        return pending.edges[:0]
    chance = pending.log_chance()
    sure = _sure(chance, agrees, places[pending.edges])
    if sure.any():
        # The sharper half: the other half is then judged by sharper predictions.
        return pending.edges[sure]
    open_ = np.flatnonzero(agrees)
    open_ = open_[np.argsort(chance[open_])][:_HYPOTHESES]
    support, follows = _support(pending, open_, places[pending.edges[open_]], limit)
    best = int(np.argmax(support))
    odds = believed / (1 - believed)
    if support[best] + np.log(odds) < -np.log(_DOUBT):
        return open_[:0]
    return pending.edges[open_[follows[best]]]


_DOUBT = 0.05
"""Odds against a loop that is believed for its support."""


def _sure(chance: Array, agrees: Mask, place: Index, rate: float = CHANCE) -> Mask:
    """Agreeing loops of so sharp predictions that of a thousand not one would be false.

    If all of the sharpest k loops were false, the sum of their chances would agree. Loops between the same
    two places are right or wrong together: a place counts as one. Source: the false discovery rate of
    Benjamini and Hochberg 1995.
    """
    order = np.argsort(chance, kind="stable")
    weight = (1 / np.maximum(np.bincount(place), 1))[place][order]
    false, true = np.cumsum(weight * np.exp(chance[order])), np.cumsum(weight * agrees[order])
    enough = np.flatnonzero(false <= rate * true)
    sure = np.zeros(len(chance), dtype=bool)
    if len(enough):
        sure[order[: enough[-1] + 1]] = True
    return sure & agrees


def _support(pending: Innovations, open_: Index, place: Index, limit: float) -> tuple[Array, Mask]:
    """For each of some edges as a hypothesis (h,): the surprise in nats that it and what it makes agree
    sharply do so by chance, and which go with it (h, h): its neighbours, and what then is sure.

    Loops between the same two places (``place``) count once: where the floor repeats they are false together.
    """
    residual, spread = pending.residual[open_], pending.spread[open_]
    covariance, room = pending.covariance()[open_], pending.log_room[open_]
    s = spread.shape[2]
    support, follows = np.zeros(len(open_)), np.zeros((len(open_), len(open_)), dtype=bool)
    alone = room - _log_volume(covariance, limit)
    for a in range(len(open_)):
        cross = spread @ spread[a].T / s
        gain = np.swapaxes(np.linalg.solve(covariance[a], np.swapaxes(cross, 1, 2)), 1, 2)
        left = covariance - gain @ np.swapaxes(cross, 1, 2)
        moved = residual - gain @ residual[a]
        chance = _log_volume(left, limit) - room
        agrees = _squared(moved, left) <= limit
        sure = _sure(chance, agrees, place)
        follows[a] = sure | (agrees & (chance <= np.log(CHANCE)) & (place == place[a]))
        follows[a, a] = True
        elsewhere = sure & (place != place[a])
        surprise = np.zeros(place.max() + 1)
        np.maximum.at(surprise, place[elsewhere], -chance[elsewhere])
        support[a] = max(alone[a], 0) + surprise.sum()
    return support, follows


def _places(i: Index, j: Index) -> Index:
    """(k,) which loops join the same two stretches of the way: neighbours of neighbours have one number."""
    near = cKDTree(np.column_stack([np.minimum(i, j), np.maximum(i, j)])).query_pairs(_STRETCH, p=np.inf)
    pairs = np.array(sorted(near), dtype=np.int64).reshape(-1, 2)
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(i), len(i)))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)
