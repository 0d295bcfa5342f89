"""How probable each instrument's error is, with "nothing" and "something else" among the hypotheses.

As with commands (``slam.criticism.verdict.posterior``): the chosen set, the set without one of its effects,
the set with one of them replaced, and any single one in place of none or of several; each weighs what it
explains, what its numbers cost and its prior. What is no term is an attitude or a speed that comes late, and
an instrument's error that changes as time goes. What one explains more than another counts as far as
stretches of ten seconds agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slam.criticism.search.evidence import KNOWN, UNKNOWN, VERY_SIMILAR_NATS
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE
from slam.criticism.without_commands.regression import Regression
from slam.simulation.terms import CATALOGUE

IN_TIME = " ~ time"
"""Marks an error that grows with time."""


@dataclass(frozen=True)
class InPlace:
    """What may stand in for a chosen effect."""

    near: tuple[str, ...]
    """Terms that explain as much but for 4 nats, the nearest first."""
    lead_nats: float
    """Over the best other term, with what their numbers cost."""
    rival: str
    """The other term that is likeliest; empty where there is none."""


def in_place_of(data: Regression, chosen: Sequence[str], effect: str) -> InPlace:
    """The terms that may stand in for one of the chosen."""
    behind = {
        e: _behind(data, chosen, effect, e) for e in data.effects() if e in CATALOGUE and e not in chosen
    }
    near = [e for e in sorted(behind, key=lambda e: behind[e][0]) if behind[e][0] < VERY_SIMILAR_NATS]
    rivals = [*near, *sorted(behind, key=lambda e: sum(behind[e]))]
    lead_nats = min((max(sum(of), 0.0) for of in behind.values()), default=np.inf)
    return InPlace(tuple(near), float(lead_nats), next(iter(rivals), ""))


def posterior_of(data: Regression, chosen: Sequence[str]) -> dict[str, float]:
    """Probability of every term that the streams can show, of ``nothing`` and of ``unknown``."""
    data = _with_changes(data)
    weights = {frozenset(chosen): _prior(data, chosen)}
    for effect in chosen:
        rest = [e for e in chosen if e != effect]
        weights[frozenset(rest)] = _evidence(data, chosen, rest)
        for other in (e for e in data.effects() if e not in chosen):
            weights[frozenset([*rest, other])] = _prior(data, [*rest, other]) - max(
                sum(_behind(data, chosen, effect, other)), 0.0
            )
    if len(chosen) != 1:
        for other in data.effects():
            weights.setdefault(frozenset([other]), _evidence_alone(data, chosen, other))
    greatest = max(weights.values())
    share = {effects: float(np.exp(weight - greatest)) for effects, weight in weights.items()}
    whole = sum(share.values())
    total = {e: 0.0 for e in data.effects() if e in CATALOGUE} | {NOTHING: 0.0, SOMETHING_ELSE: 0.0}
    for effects, part in share.items():
        for name in {e if e in CATALOGUE else SOMETHING_ELSE for e in effects} or {NOTHING}:
            total[name] = min(total[name] + part / whole, 1.0)
    return total


def _behind(data: Regression, chosen: Sequence[str], effect: str, other: str) -> tuple[float, float]:
    """Nats by which the chosen set leads with another in an effect's place: explained, and saved in numbers.

    Explained is what the effect explains beside the other: what explains something else is no rival. Of two
    terms that explain the same the one with fewer numbers is chosen; the other may be it all the same.
    """
    rest = [e for e in chosen if e != effect]
    lead = data.lead([*chosen, other], [*rest, other])
    alike = lead < VERY_SIMILAR_NATS and effect in CATALOGUE and other in CATALOGUE
    return lead, 0.0 if alike else data.cost(other) - data.cost(effect)


def _evidence(data: Regression, chosen: Sequence[str], others: Sequence[str]) -> float:
    """Nats of a set against the chosen one, with its prior."""
    return _prior(data, others) + _saved(data, chosen, others) - data.lead(chosen, others)


def _evidence_alone(data: Regression, chosen: Sequence[str], other: str) -> float:
    """The same of a single one, which takes the place of one first, and then of the rest.

    Where one of many steps is in doubt from stretch to stretch, the others still count in full.
    """
    if not chosen:
        return _evidence(data, chosen, [other])
    ways = [[*(e for e in chosen if e not in (effect, other)), other] for effect in chosen]
    lead = min(data.lead(chosen, way) + data.lead(way, [other]) for way in ways)
    return _prior(data, [other]) + _saved(data, chosen, [other]) - lead


def _saved(data: Regression, chosen: Sequence[str], others: Sequence[str]) -> float:
    """Nats that the numbers of others cost less."""
    return sum(data.cost(e) for e in chosen) - sum(data.cost(e) for e in others)


def _prior(data: Regression, effects: Sequence[str]) -> float:
    """Log of a set's share: terms and all else divide theirs evenly."""
    kinds = sum(e in CATALOGUE for e in data.effects())
    others = len(data.effects()) - kinds
    return sum(float(np.log(KNOWN / kinds if e in CATALOGUE else UNKNOWN / others)) for e in effects)


def _with_changes(data: Regression) -> Regression:
    """With each term's error once more, growing with time."""
    changing = {
        f"{effect}{IN_TIME}.{name.rpartition('.')[2]}": data.columns[name] * data.minutes
        for effect in data.effects() if effect in CATALOGUE for name in data.of(effect)
    }  # fmt: skip
    return replace(data, columns=data.columns | changing)
