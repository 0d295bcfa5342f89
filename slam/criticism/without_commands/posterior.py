"""Posterior of each instrument's error, with "nothing" and "something else" among the hypotheses.

Hypotheses are as with commands (``slam.criticism.verdict.posterior``): the chosen set, the set without one of
its effects, the set with one of them replaced, and any single one in place of none or of several. Each weighs
what it explains, the cost of its parameters and its prior. Effects that are no term are a delayed attitude or
speed, and an instrument's error that grows with time. A lead counts as far as segments of ten seconds agree
on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slam.criticism.search.thresholds import KNOWN, UNKNOWN, VERY_SIMILAR_NATS
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE, Place, probabilities
from slam.criticism.without_commands.regression import Regression
from slam.simulation.terms import CATALOGUE

IN_TIME = " ~ time"
"""Suffix of an error that grows with time."""


def in_place_of(data: Regression, chosen: Sequence[str], effect: str) -> Place:
    """Return the alternatives to one of the chosen terms."""
    behind = {
        e: _behind(data, chosen, effect, e) for e in data.effects() if e in CATALOGUE and e not in chosen
    }
    near = [e for e in sorted(behind, key=lambda e: behind[e][0]) if behind[e][0] < VERY_SIMILAR_NATS]
    rivals = [*near, *sorted(behind, key=lambda e: sum(behind[e]))]
    lead_nats = min((max(sum(of), 0.0) for of in behind.values()), default=np.inf)
    return Place((effect, *near), float(lead_nats), next(iter(rivals), ""))


def posterior_of(data: Regression, chosen: Sequence[str]) -> dict[str, float]:
    """Return the probability of every term that the streams can show, of ``nothing`` and of ``unknown``."""
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
    named = [
        (nats, frozenset(e if e in CATALOGUE else SOMETHING_ELSE for e in effects) or frozenset([NOTHING]))
        for effects, nats in weights.items()
    ]
    return {e: 0.0 for e in data.effects() if e in CATALOGUE} | probabilities(named)


def _behind(data: Regression, chosen: Sequence[str], effect: str, other: str) -> tuple[float, float]:
    """Return the nats by which the chosen set leads over another effect in one's place: explained, and saved
    in parameters.

    The first is what the effect explains beside the other: an effect that explains something else is no
    rival. Of two terms that explain the same the one with fewer parameters is chosen; the other remains an
    alternative.
    """
    rest = [e for e in chosen if e != effect]
    lead = data.lead([*chosen, other], [*rest, other])
    alike = lead < VERY_SIMILAR_NATS and effect in CATALOGUE and other in CATALOGUE
    return lead, 0.0 if alike else data.cost(other) - data.cost(effect)


def _evidence(data: Regression, chosen: Sequence[str], others: Sequence[str]) -> float:
    """Return the nats of a set against the chosen one, with its prior."""
    return _prior(data, others) + _saved(data, chosen, others) - data.lead(chosen, others)


def _evidence_alone(data: Regression, chosen: Sequence[str], other: str) -> float:
    """Return the nats of a single effect, which replaces one effect first, and then the rest.

    Where segments disagree on one of many steps, the others still count in full.
    """
    if not chosen:
        return _evidence(data, chosen, [other])
    ways = [[*(e for e in chosen if e not in (effect, other)), other] for effect in chosen]
    lead = min(data.lead(chosen, way) + data.lead(way, [other]) for way in ways)
    return _prior(data, [other]) + _saved(data, chosen, [other]) - lead


def _saved(data: Regression, chosen: Sequence[str], others: Sequence[str]) -> float:
    """Return the nats that the parameters of others cost less."""
    return sum(data.cost(e) for e in chosen) - sum(data.cost(e) for e in others)


def _prior(data: Regression, effects: Sequence[str]) -> float:
    """Return the log prior of a set: terms and all else divide their shares evenly."""
    kinds = sum(e in CATALOGUE for e in data.effects())
    others = len(data.effects()) - kinds
    return sum(float(np.log(KNOWN / kinds if e in CATALOGUE else UNKNOWN / others)) for e in effects)


def _with_changes(data: Regression) -> Regression:
    """Add each term's error once more, growing with time."""
    changing = {
        f"{effect}{IN_TIME}.{name.rpartition('.')[2]}": data.columns[name] * data.minutes
        for effect in data.effects() if effect in CATALOGUE for name in data.of(effect)
    }  # fmt: skip
    return replace(data, columns=data.columns | changing)
