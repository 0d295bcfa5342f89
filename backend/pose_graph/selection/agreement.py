"""Which loops agree with trusted odometry and with each other: a set that grows from what is surest.

Innovation gating: the edges accepted so far predict each remaining loop with a covariance. A loop outside its
gate is not accepted. One inside the gate of a *sharp* prediction (a small covariance) is, since a false loop
would rarely fall there; how rarely is measured on decoys. Each accepted loop shrinks the covariances of the
other predictions. Where no prediction is sharp, each loop is tried as a hypothesis, and those that bring the
most others into sharp agreement are accepted: a mutually consistent group of false loops (a floor that
repeats) is then outvoted by the rest. The idea is that of pairwise consistency (Mangelson et al. 2018, ICRA),
with predictions from all accepted edges instead of odometry alone. Loops that would be accepted in the same
round are first cross-validated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.stats import chi2

from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.null_loops import NullLoops
from backend.pose_graph.selection.prediction import (
    SIGNIFICANCE,
    LoopInnovations,
    first_scale,
    innovations,
    limit,
    log_volume,
    noise_scale,
    squared_mahalanobis,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
Solve = Callable[[Mask, Array], Array]
"""Poses from some edges and a start."""
Sampler = Callable[[Mask, Array], Array | None]
"""Draws about a solution; None where it is singular or time is up."""

_ROUNDS = 400
_HYPOTHESES = 300
_DOUBT = 0.05
"""Factor that lowers the prior odds of a loop: see `log_odds`."""
_TAIL = 3.0
"""Allowed factor on the noise estimated from the accepted edges: its tails are heavier than a Gaussian's."""
_STRIKES = 2
"""Rejections after which a loop is not tried again: the first may be the fault of loops dropped with it."""
_TURNS = 4
_STRETCH = 3
"""Loops whose ends differ by at most so many poses count as one place."""


def grow_consistent_set(
    problem: Problem,
    base: Mask,
    w_T: Array,
    solve: Solve,
    draw: Sampler,
    on_round: Callable[[int, int], None],
) -> tuple[Mask, Array]:
    """Edges (m,) that agree, beginning with those of ``base`` (solved: ``w_T``), and the poses from them."""
    growth = _Growth(problem, base, place_pairs(problem.i, problem.j), solve, draw)
    loops = np.flatnonzero(~base)
    null_loops = NullLoops.of(problem, loops, growth.place[loops])
    kept, strikes = base.copy(), np.zeros(len(base), dtype=np.int64)
    for number in range(_ROUNDS):
        samples = draw(kept, w_T)
        if samples is None:
            break
        left = np.flatnonzero(~kept & (strikes < _STRIKES))
        scale = noise_scale(problem, kept, w_T)
        if number == 0:
            scale = first_scale(innovations(problem, w_T, samples, left), growth.place[left])
        pending = innovations(problem, w_T, samples, left, scale)
        chance = null_loops.chance(w_T, samples, scale).of(pending.log_pass_probability())
        joined = _joining(pending, chance, growth.place[left], log_odds(kept, ~base))
        if len(joined) == 0:
            break
        new = growth.crossed(kept, joined, w_T, scale)
        new, w_T = growth.fitting(kept, new, w_T, scale if number else np.inf)
        strikes[np.setdiff1d(joined, new)] += 1
        kept[new] = True
        off = (problem.residuals(w_T) ** 2).sum(axis=1)
        out = kept & ~base & (off > limit(problem.dof) * scale**2)
        if out.any():
            # The worst go first: those that they pulled away may agree without them.
            out &= off >= np.quantile(off[out], 0.5)
            kept, strikes = kept & ~out, strikes + out
            w_T = solve(kept, w_T)
        on_round(number, int(kept.sum()))
    return kept, w_T


def recheck_rejected(problem: Problem, kept: Mask, w_T: Array, samples: Array) -> tuple[Mask, Array]:
    """Which other edges agree with a solution after all (m,), and by how many sigmas they are off (m,)."""
    edges, scale = np.flatnonzero(~kept), noise_scale(problem, kept, w_T)
    agrees, sigma = np.zeros_like(kept), np.full(len(kept), np.nan)
    if len(edges) == 0:
        return agrees, sigma
    found = innovations(problem, w_T, samples, edges, scale)
    place, loops = place_pairs(problem.i, problem.j), np.flatnonzero(~problem.trusted)
    null_loops = NullLoops.of(problem, loops, place[loops])
    chance = null_loops.chance(w_T, samples, scale).of(found.log_pass_probability())
    sigma[edges] = found.sigma()
    # Real noise has tails: within its covariance as stated, if the prediction is sharp even for that.
    wide = float(np.clip(1 / scale, 1, _TAIL))
    agrees[edges] = _sure(chance, found.agrees(), place[edges])
    agrees[edges] |= _sure(
        np.minimum(chance + problem.dof * np.log(wide), 0.0),
        sigma[edges] ** 2 <= limit(problem.dof) * wide**2,
        place[edges],
    )
    return agrees, sigma


@dataclass(frozen=True)
class _Growth:
    """What stays fixed while the set grows."""

    problem: Problem
    base: Mask
    place: Index
    solve: Solve
    draw: Sampler

    def crossed(self, kept: Mask, joined: Index, w_T: Array, scale: float) -> Index:
        """Two-fold cross-validation of the newly accepted loops; those that pass.

        Each half must pass the gate of the solution from the kept edges and the other half. Repeated with
        other halves until none is rejected, so that a chance agreement is exposed by the true loops.
        """
        for turn in range(_TURNS):
            passed = self._halves(kept, joined, w_T, scale, turn)
            if len(passed) == len(joined):
                break
            joined = passed
        return joined

    def _halves(self, kept: Mask, joined: Index, w_T: Array, scale: float, turn: int) -> Index:
        # Loops between the same places stay together.
        half = (np.unique(self.place[joined], return_inverse=True)[1] >> turn) % 2 == 0
        if half.all():
            half = np.arange(len(joined)) % 2 == 0
        if half.all():
            return joined
        good = []
        for some, others in ((joined[half], joined[~half]), (joined[~half], joined[half])):
            now = kept.copy()
            now[some] = True
            at = self.solve(now, w_T)
            samples = self.draw(now, at)
            if samples is None:
                return joined[:0]
            wide = max(scale, noise_scale(self.problem, now, at))
            found = innovations(self.problem, at, samples, others, wide)
            good.append(found.edges[found.agrees()])
        return np.sort(np.concatenate(good))

    def fitting(self, kept: Mask, new: Index, w_T: Array, scale: float) -> tuple[Index, Array]:
        """New loops whose acceptance raises the total chi-square no more than noise would, and the poses.

        The worse half of them is dropped until that holds.
        """
        before = float((self.problem.residuals(w_T)[kept] ** 2).sum())
        while len(new):
            now = kept.copy()
            now[new] = True
            at = self.solve(now, w_T)
            off = (self.problem.residuals(at) ** 2).sum(axis=1)
            allowed = _TAIL * scale**2 * float(chi2.ppf(1 - SIGNIFICANCE, self.problem.dof * len(new)))
            if float(off[now].sum()) - before <= allowed:
                return new, at
            new = new[off[new] < np.quantile(off[new], 0.5)]
        return new, w_T


def log_odds(kept: Mask, loops: Mask) -> float:
    """Prior log odds that a loop is true: the share of loops (m,) kept so far, with one kept and one rejected
    added (Laplace's rule of succession), lowered by `_DOUBT` so that a loop that only breaks even stays out.
    """
    accepted = float((1 + (kept & loops).sum()) / (2 + loops.sum()))
    return float(np.log(_DOUBT * accepted / (1 - accepted)))


def _joining(pending: LoopInnovations, chance: Array, place: Index, odds: float) -> Index:
    """Loops to accept next: those of sharp predictions, else those with the most support.

    ``chance`` (log probability of agreeing if false) and ``place`` (k,) are those of the pending ones.
    """
    agrees = pending.agrees()
    sure = _sure(chance, agrees, place)
    if sure.any() or not agrees.any():
        # What is sharp goes first: the rest is then judged by sharper predictions.
        return pending.edges[sure]
    open_ = np.flatnonzero(agrees)
    open_ = open_[np.argsort(chance[open_])][:_HYPOTHESES]
    votes = _votes(pending, open_, place[open_], chance[open_])
    least = -odds
    best = float(votes.support.max())
    if best < least:
        return pending.edges[:0]
    taken: list[int] = []
    for h in np.argsort(-votes.support).tolist():
        # Of as many hypotheses some find others that agree by chance.
        if taken and votes.support[h] < max(least + np.log(len(open_)), best / 2):
            break
        if votes.fits[taken, h].all() and votes.fits[h, taken].all():
            taken.append(h)
    return pending.edges[open_[votes.follows[taken].any(axis=0)]]


def _sure(chance: Array, agrees: Mask, place: Index) -> Mask:
    """Agreeing loops, accepted in order of sharpness at a false discovery rate of `SIGNIFICANCE`.

    Of the k sharpest loops the sum of ``chance`` is expected to agree if all are false. Loops between the
    same two places are right or wrong together, so that a place counts as one. Source: Benjamini and
    Hochberg 1995.
    """
    order = np.argsort(chance, kind="stable")
    weight = (1 / np.maximum(np.bincount(place), 1))[place][order]
    false, true = np.cumsum(weight * np.exp(chance[order])), np.cumsum(weight * agrees[order])
    enough = np.flatnonzero(false <= SIGNIFICANCE * true)
    sure = np.zeros(len(chance), dtype=bool)
    if len(enough):
        sure[order[: enough[-1] + 1]] = True
    return sure & agrees


@dataclass(frozen=True)
class _Votes:
    """What accepting each of h loops as a hypothesis does to the gates of the others."""

    support: Array
    """(h,) negative log probability (nats) that it and the loops that then agree sharply are all false."""
    follows: Mask
    """(h, h) loops to accept with it: those of its own place, and those then accepted as sure."""
    fits: Mask
    """(h, h) loops that then pass the gate."""


def _votes(pending: LoopInnovations, open_: Index, place: Index, chance: Array) -> _Votes:
    """Condition all open loops on each one in turn.

    Loops between the same two places (``place``) add to the support once: where the floor repeats they are
    false together.
    """
    some, most = pending.only(open_), limit(pending.residual.shape[1])
    h = len(open_)
    support = np.zeros(h)
    follows, fits = np.zeros((h, h), dtype=bool), np.zeros((h, h), dtype=bool)
    volume = log_volume(some.covariance, most)
    for a in range(h):
        residual, left = some.given(a)
        fits[a] = squared_mahalanobis(residual, left) <= most
        then = np.minimum(chance + log_volume(left, most) - volume, 0.0)
        sure = _sure(then, fits[a], place)
        follows[a] = sure | (fits[a] & (then <= np.log(SIGNIFICANCE)) & (place == place[a]))
        follows[a, a] = True
        elsewhere = sure & (place != place[a])
        surprise = np.zeros(place.max() + 1)
        np.maximum.at(surprise, place[elsewhere], -then[elsewhere])
        support[a] = -chance[a] + surprise.sum()
    return _Votes(support, follows, fits)


def place_pairs(i: Index, j: Index) -> Index:
    """(k,) which loops join the same two stretches of the way: neighbours of neighbours have one number."""
    near = cKDTree(np.column_stack([np.minimum(i, j), np.maximum(i, j)])).query_pairs(_STRETCH, p=np.inf)
    pairs = np.array(sorted(near), dtype=np.int64).reshape(-1, 2)
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(i), len(i)))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)
