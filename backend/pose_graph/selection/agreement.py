"""Grow a consistent set of loops from trusted odometry, the most certain loops first.

Innovation gating: the edges accepted so far predict each remaining loop with a covariance. A loop outside its
gate is not accepted. One inside the gate of a *sharp* prediction (a small covariance) is, since a false loop
would rarely fall there; null loops measure how rarely. Each accepted loop shrinks the covariances of the
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

from backend.pose_graph.chi_square import SIGNIFICANCE, chi_square_gate
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.null_loops import NullLoops
from backend.pose_graph.selection.places import ROW_LENGTH, place_pairs
from backend.pose_graph.selection.prediction import (
    LoopInnovations,
    first_scale,
    innovations,
    log_volume,
    noise_scale,
    squared_mahalanobis,
)
from backend.quantiles import chi_square_quantile

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
Solve = Callable[[Mask, Array], Array]
"""Function from kept edges (m,) and an initial guess to poses."""
Sampler = Callable[[Mask, Array], Array | None]
"""Function from kept edges and poses to posterior samples; None if singular or out of time."""

_ROUNDS = 400
"""Maximum number of rounds. The status says if it cuts the growth off."""
MAX_HYPOTHESES = 300
_PRIOR_ODDS_FACTOR = 0.05
"""Factor on the prior odds of a loop: see `log_odds`."""
TAIL_FACTOR = 3.0
"""Allowed factor on the noise estimated from the accepted edges: real tails are heavier than Gaussian."""
_MAX_REJECTIONS = 2
"""Rejections after which a loop is not tried again: other loops may have caused the first."""
_MAX_FOLDS = 4


@dataclass(frozen=True)
class GrownSet:
    """Consistent edges that were grown from odometry."""

    kept: Mask
    """(m,)."""
    w_T: Array
    """(n, 4, 4)."""
    is_complete: bool
    """False if the rounds or the time ended while further loops could have been accepted."""


def grow_consistent_set(
    problem: Problem,
    base: Mask,
    w_T: Array,
    solve: Solve,
    draw: Sampler,
    on_round: Callable[[int, int], None],
) -> GrownSet:
    """Return the consistent edges and their poses, growing from ``base`` (m,) with the poses ``w_T``."""
    growth = _Growth(problem, base, place_pairs(problem.i, problem.j, ROW_LENGTH), solve, draw)
    loops = np.flatnonzero(~base)
    null_loops = NullLoops.of(problem, loops, growth.place[loops])
    kept, rejections = base.copy(), np.zeros(len(base), dtype=np.int64)
    for number in range(_ROUNDS):
        samples = draw(kept, w_T)
        if samples is None:
            break
        left = np.flatnonzero(~kept & (rejections < _MAX_REJECTIONS))
        if not len(left):
            return GrownSet(kept, w_T, True)
        scale = noise_scale(problem, kept, w_T)
        if number == 0:
            scale = first_scale(innovations(problem, w_T, samples, left), growth.place[left])
        pending = innovations(problem, w_T, samples, left, scale)
        chance = null_loops.chance(w_T, samples, scale).of(pending.log_pass_probability())
        candidates = _select_loops(pending, chance, growth.place[left], log_odds(kept, ~base))
        if len(candidates) == 0:
            return GrownSet(kept, w_T, True)
        new = growth.cross_validated(kept, candidates, w_T, scale)
        new, w_T = growth.fitting(kept, new, w_T, scale if number else np.inf)
        rejections[np.setdiff1d(candidates, new)] += 1
        kept[new] = True
        off = (problem.residuals(w_T) ** 2).sum(axis=1)
        out = kept & ~base & (off > chi_square_gate(problem.dof) * scale**2)
        if out.any():
            # Only the worst are removed: the others may agree without them.
            out &= off >= np.quantile(off[out], 0.5)
            kept, rejections = kept & ~out, rejections + out
            w_T = solve(kept, w_T)
        on_round(number, int(kept.sum()))
    return GrownSet(kept, w_T, False)


def recheck_rejected(problem: Problem, kept: Mask, w_T: Array, samples: Array) -> tuple[Mask, Array]:
    """Return which rejected edges agree with a solution (m,), and their innovations in sigmas (m,)."""
    edges, scale = np.flatnonzero(~kept), noise_scale(problem, kept, w_T)
    agrees, sigma = np.zeros_like(kept), np.full(len(kept), np.nan)
    if len(edges) == 0:
        return agrees, sigma
    found = innovations(problem, w_T, samples, edges, scale)
    place, loops = place_pairs(problem.i, problem.j, ROW_LENGTH), np.flatnonzero(~problem.trusted)
    null_loops = NullLoops.of(problem, loops, place[loops])
    chance = null_loops.chance(w_T, samples, scale).of(found.log_pass_probability())
    sigma[edges] = found.sigma()
    # Accept within the stated covariance if the prediction is sharp even for that.
    inflation = tail_inflation(scale * problem.noise)
    agrees[edges] = sharp_agreements(chance, found.agrees(), place[edges])
    agrees[edges] |= sharp_agreements(
        np.minimum(chance + problem.dof * np.log(inflation), 0.0),
        sigma[edges] ** 2 <= chi_square_gate(problem.dof) * inflation**2,
        place[edges],
    )
    return agrees, sigma


def tail_inflation(scale: float) -> float:
    """Return the factor on a noise estimated from the bulk of the edges that its tails need.

    Real noise has tails, up to the stated covariance. ``scale`` is the estimated factor on that.
    """
    return float(np.clip(1 / scale, 1, TAIL_FACTOR))


@dataclass(frozen=True)
class _Growth:
    """Fixed inputs while the set grows."""

    problem: Problem
    base: Mask
    place: Index
    solve: Solve
    draw: Sampler

    def cross_validated(self, kept: Mask, candidates: Index, w_T: Array, scale: float) -> Index:
        """Cross-validate newly accepted loops in two folds; return those that pass.

        Each half must pass the gate of the solution from the kept edges and the other half. This is repeated
        with other halves until none is rejected, so that the true loops expose a chance agreement.
        """
        for turn in range(_MAX_FOLDS):
            passed = self._validate_halves(kept, candidates, w_T, scale, turn)
            if len(passed) == len(candidates):
                break
            candidates = passed
        return candidates

    def _validate_halves(self, kept: Mask, candidates: Index, w_T: Array, scale: float, turn: int) -> Index:
        # Loops between the same places stay together.
        half = (np.unique(self.place[candidates], return_inverse=True)[1] >> turn) % 2 == 0
        if half.all():
            half = np.arange(len(candidates)) % 2 == 0
        if half.all():
            return candidates
        good = []
        for some, others in ((candidates[half], candidates[~half]), (candidates[~half], candidates[half])):
            now = kept.copy()
            now[some] = True
            at = self.solve(now, w_T)
            samples = self.draw(now, at)
            if samples is None:
                return candidates[:0]
            inflation = max(scale, noise_scale(self.problem, now, at))
            found = innovations(self.problem, at, samples, others, inflation)
            good.append(found.edges[found.agrees()])
        return np.sort(np.concatenate(good))

    def fitting(self, kept: Mask, new: Index, w_T: Array, scale: float) -> tuple[Index, Array]:
        """Return new loops that raise the total chi-square no more than noise would, and the poses.

        The worse half of them is dropped until that holds.
        """
        before = float((self.problem.residuals(w_T)[kept] ** 2).sum())
        while len(new):
            now = kept.copy()
            now[new] = True
            at = self.solve(now, w_T)
            off = (self.problem.residuals(at) ** 2).sum(axis=1)
            quantile = chi_square_quantile(1 - SIGNIFICANCE, self.problem.dof * len(new))
            allowed = TAIL_FACTOR * scale**2 * quantile
            if float(off[now].sum()) - before <= allowed:
                return new, at
            new = new[off[new] < np.quantile(off[new], 0.5)]
        return new, w_T


def log_odds(kept: Mask, loops: Mask) -> float:
    """Return the prior log odds that a loop is true, from the share of ``loops`` (m,) kept so far.

    One kept and one rejected loop are added (Laplace's rule of succession). `_PRIOR_ODDS_FACTOR` lowers the
    odds, so that a loop without evidence is not accepted.
    """
    accepted = float((1 + (kept & loops).sum()) / (2 + loops.sum()))
    return float(np.log(_PRIOR_ODDS_FACTOR * accepted / (1 - accepted)))


def _select_loops(pending: LoopInnovations, chance: Array, place: Index, odds: float) -> Index:
    """Return the loops to accept next: those of sharp predictions, else those with the most support.

    ``chance`` (k,) is the log probability that a false loop agrees; ``place`` (k,) is the pair of places.
    """
    agrees = pending.agrees()
    if not agrees.any():
        return pending.edges[:0]
    order = np.argsort(chance)
    open_ = order[agrees[order]][:MAX_HYPOTHESES]
    votes = _count_votes(pending, open_, place[open_], chance[open_])
    sharp = sharp_agreements(chance, agrees, place)
    eligible = sharp[open_]
    if not eligible.any():
        eligible = _supported(votes, -odds)
    # The better half first: the others are then judged by sharper predictions.
    ranked = [h for h in np.argsort(-votes.support).tolist() if eligible[h]]
    accepted: list[int] = []
    for h in ranked[: (len(ranked) + 1) // 2]:
        if votes.fits[accepted, h].all() and votes.fits[h, accepted].all():
            accepted.append(h)
    # A half of all sharp ones, without votes, or the rounds would grow in number with the map.
    beyond = order[sharp[order]][MAX_HYPOTHESES:]
    return pending.edges[np.append(open_[accepted], beyond[: len(beyond) // 2])]


def _supported(votes: _Votes, least: float) -> Mask:
    """Return (h,) the hypotheses of enough support that fit each other, with those that follow them."""
    best = float(votes.support.max())
    accepted: list[int] = []
    for h in np.argsort(-votes.support).tolist():
        # Among many hypotheses some gain support by chance.
        needed = max(least + np.log(len(votes.support)), best / 2) if accepted else least
        if votes.support[h] < needed:
            break
        if votes.fits[accepted, h].all() and votes.fits[h, accepted].all():
            accepted.append(h)
    return np.asarray(votes.follows[accepted].any(axis=0))


def sharp_agreements(chance: Array, agrees: Mask, place: Index, rate: float = SIGNIFICANCE) -> Mask:
    """Select agreeing loops in order of sharpness at a false discovery ``rate``.

    The expected number of false loops that agree among the k sharpest is the sum of their probabilities,
    times the share of false loops; the loops that disagree bound that share. Loops between the same two
    places are true or false together and count as one. Sources: Benjamini and Hochberg 1995; Storey 2002
    (JRSS B 64).
    """
    order = np.argsort(chance, kind="stable")
    probability = np.exp(chance[order])
    weight = (1 / np.maximum(np.bincount(place), 1))[place][order]
    disagreeing = 1 + float(weight @ ~agrees[order])
    share = min(1.0, disagreeing / max(float(weight @ (1 - probability)), 1.0))
    false, true = share * np.cumsum(weight * probability), np.cumsum(weight * agrees[order])
    enough = np.flatnonzero(false <= rate * true)
    sharp = np.zeros(len(chance), dtype=bool)
    if len(enough):
        sharp[order[: enough[-1] + 1]] = True
    return sharp & agrees


@dataclass(frozen=True)
class _Votes:
    """Effect of accepting each of h loops, as a hypothesis, on the gates of the others."""

    support: Array
    """(h,) negative log probability (nats) that the loop and those that then agree sharply are all false."""
    follows: Mask
    """(h, h) loops to accept with it: those of its own place, and those with a sharp agreement."""
    fits: Mask
    """(h, h) loops that then pass their gates."""


def _count_votes(pending: LoopInnovations, open_: Index, place: Index, chance: Array) -> _Votes:
    """Condition all remaining loops on each one in turn.

    Loops between the same two places (``place``) add to the support once: where the floor repeats they are
    false together.
    """
    some, most = pending.subset(open_), chi_square_gate(pending.residual.shape[1])
    h = len(open_)
    support = np.zeros(h)
    follows, fits = np.zeros((h, h), dtype=bool), np.zeros((h, h), dtype=bool)
    volume = log_volume(some.covariance, most)
    for a in range(h):
        residual, left = some.conditioned_on(a)
        fits[a] = squared_mahalanobis(residual, left) <= most
        then = np.minimum(chance + log_volume(left, most) - volume, 0.0)
        sharp = sharp_agreements(then, fits[a], place)
        follows[a] = sharp | (fits[a] & (then <= np.log(SIGNIFICANCE)) & (place == place[a]))
        follows[a, a] = True
        elsewhere = sharp & (place != place[a])
        surprise = np.zeros(place.max() + 1)
        np.maximum.at(surprise, place[elsewhere], -then[elsewhere])
        support[a] = -chance[a] + surprise.sum()
    return _Votes(support, follows, fits)
