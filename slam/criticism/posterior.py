"""How probable each cause is, with "nothing" and "something unknown" always among the hypotheses.

Hypotheses are the chosen set, the set without one of its terms, and the set with one of them replaced by any
other term or by any shape of the dictionary that is not the term itself to the eye of these flights. Each
weighs its likelihood at its best, what its numbers cost, and its prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.criticism.effects import Effect
from slam.criticism.moving import is_wall
from slam.criticism.search import VERY_SIMILAR_NATS, Look, Search, occam
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]

KNOWN, UNKNOWN = 0.9, 0.1
"""Prior shares of an effect of the catalogue and of anything else."""
NOTHING, SOMETHING_ELSE = "nothing", "unknown"
SAME_TRACE = 0.9
"""Correlation with a term beyond which a shape is the term in other words: a range that goes with the climb
rate is a lag."""


@dataclass(frozen=True)
class Posterior:
    """Probabilities of names, and what may stand in for each chosen term."""

    probability: dict[str, float]
    """Of every term, and of ``nothing`` and ``unknown``; terms of a pair each count on their own."""
    alternatives: tuple[tuple[str, ...], ...]
    """For each chosen effect: names whose evidence lies within 4 nats of it in its place, itself first."""
    lead_nats: tuple[float, ...]
    """For each chosen effect: its lead over the best other name in its place."""
    unknown_lead_nats: float
    """Lead of the best shape of the dictionary, in place of the last chosen term or on its own."""


def named(effect: Effect) -> bool:
    """Whether an effect is a term of the catalogue."""
    return effect.name in CATALOGUE


def posterior_of(found: Search) -> Posterior:
    """Probabilities at the last look."""
    look, chosen = found.last, list(found.chosen)
    own = _evidence(look, chosen)
    weights: list[tuple[float, frozenset[str]]] = [(own, _names(chosen))]
    alternatives: list[tuple[str, ...]] = []
    leads, unknown = [], -np.inf
    places = chosen if chosen else [None]
    for place in places:
        if place is not None and is_wall(place):
            # The search has held it against all others with the filter run anew.
            alternatives.append((place.name,))
            leads.append(np.inf)
            continue
        rest = [e for e in chosen if e is not place]
        if place is not None:
            weights.append((_evidence(look, rest), _names(rest)))
        rivals: dict[str, float] = {}
        for effect in (*look.effects, *look.shapes):
            if any(effect.label == e.label for e in chosen):
                continue
            if place is not None and named(place) and not named(effect) and _same(look, rest, place, effect):
                continue
            evidence = _evidence(look, rest, effect)
            weights.append((evidence, _names([*rest, effect])))
            if named(effect):
                rivals[effect.name] = max(rivals.get(effect.name, -np.inf), evidence)
            else:
                unknown = max(unknown, evidence - own)
        if place is not None:
            others = {n: e for n, e in rivals.items() if n not in {c.name for c in chosen}}
            near = [n for n, e in sorted(others.items(), key=lambda r: -r[1]) if own - e < VERY_SIMILAR_NATS]
            alternatives.append((place.name, *near))
            leads.append(own - max(others.values(), default=-np.inf))
    return Posterior(_probabilities(weights), tuple(alternatives), tuple(leads), float(unknown))


def _evidence(look: Look, rest: Sequence[Effect], extra: Effect | None = None) -> float:
    effects = [*rest, extra] if extra is not None else list(rest)
    if extra is not None and look.standing(rest, [extra])[0].nats <= 0.0:
        # Nothing gained, or a size of the wrong sign.
        nats = look.parabola.answer(rest).nats
    else:
        nats = look.parabola.answer(effects).nats
    kinds = len({e.name for e in look.effects if named(e)})
    others = len(look.shapes) + len([e for e in look.effects if not named(e)])
    prior = sum(np.log(KNOWN / kinds) if named(e) else np.log(UNKNOWN / others) for e in effects)
    return float(nats - sum(occam(len(e.columns)) for e in effects) + prior)


def _same(look: Look, rest: Sequence[Effect], term: Effect, shape: Effect) -> bool:
    """Whether a shape of one column leaves the trace of a term, all else taken out."""
    if len(shape.columns) != 1 or shape.relaxes or term.relaxes:
        return False
    _, covariance = look.parabola.answer([*rest, term, shape]).of(
        look.parabola.index([*term.columns, *shape.columns])
    )
    with_term, own = covariance[-1, :-1], covariance[-1, -1]
    explained = float(with_term @ np.linalg.solve(covariance[:-1, :-1], with_term))
    return explained > SAME_TRACE**2 * own


def _names(effects: Sequence[Effect]) -> frozenset[str]:
    return frozenset(e.name if named(e) else SOMETHING_ELSE for e in effects) or frozenset([NOTHING])


def _probabilities(weights: Sequence[tuple[float, frozenset[str]]]) -> dict[str, float]:
    logs = np.array([w for w, _ in weights])
    share = np.exp(logs - logs.max())
    share /= share.sum()
    total: dict[str, float] = {NOTHING: 0.0, SOMETHING_ELSE: 0.0}
    for p, (_, names) in zip(share, weights, strict=True):
        for name in names:
            total[name] = total.get(name, 0.0) + float(p)
    return total
