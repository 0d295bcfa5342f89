"""A look at the flights under a belief: how far each effect stands out, alone and beside others.

Everything is linear about the belief here: one run of the filter with all traces, one for each change of the
restlessness, and the rest is algebra on their sums.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.setting import Setting
from slam.criticism.search.columns import column_of
from slam.criticism.search.dictionary import dictionary, shapes_of, signals_of
from slam.criticism.search.effects import (
    Effect,
    catalogue_value,
    effects_for,
    late_readings,
    plausible,
    relaxations,
)
from slam.criticism.search.fitting import changes_of
from slam.criticism.search.hypotheses import Answer, Parabola, parabola_of
from slam.criticism.search.inclusion import on_grid, settled
from slam.criticism.search.information import Sums, sums_of
from slam.criticism.search.nuisances import MEAN, WEIGHED, direction_of
from slam.criticism.search.occam import occam
from slam.criticism.search.screening import deviate
from slam.criticism.threads import in_threads
from slam.simulation.terms import CATALOGUE

NAMED_FIRST = 0.8
"""A constant out of its range, or a late reading, must explain more than a term of the catalogue."""


@dataclass(frozen=True)
class Standing:
    """How far one effect stands out beside those already chosen."""

    effect: Effect
    nats: float
    z: float

    @property
    def worth(self) -> float:
        """Nats less what its numbers cost; of what no term is, and says not why, fewer."""
        share = 1.0 if self.effect.name in CATALOGUE else NAMED_FIRST
        return share * self.nats - occam(len(self.effect.columns))


@dataclass(frozen=True)
class Look:
    """All that the flights say about one belief."""

    setting: Setting
    sums: Sums
    parabola: Parabola
    effects: tuple[Effect, ...]
    """Every effect with columns in the sums, relaxed nuisances included."""
    shapes: tuple[Effect, ...]
    """The dictionary; of a foreign vehicle readings that come late, too."""

    def own(self, effect: Effect) -> Effect:
        """The same effect with this look's columns."""
        for candidate in self.effects:
            if candidate.label == effect.label:
                return candidate
        return next(c for c in self.effects if c.name == effect.name)

    def standing(self, chosen: Sequence[Effect], among: Sequence[Effect]) -> list[Standing]:
        """Each effect's nats and z on top of the chosen ones, greatest nats after their cost first."""
        base = self.parabola.answer(chosen).nats
        found = []
        for effect in among:
            if any(effect.repeats(c) for c in chosen):
                continue
            answer = self.parabola.answer([*chosen, effect])
            nats = 0.0 if backwards(effect, self, answer) else max(answer.nats - base, 0.0)
            found.append(Standing(effect, nats, deviate(2 * nats, len(effect.columns))))
        return sorted(found, key=lambda s: occam(len(s.effect.columns)) - s.nats)


def look_at(
    records: Sequence[Record], model: Setting, setting: Setting, chosen: Sequence[Effect] = ()
) -> Look:
    """One pass over the flights with every direction and change."""
    plain = in_threads(lambda record: whole(record, setting), records)
    both = zip(records, plain, strict=True)
    signals = [signals_of(record, run.states, k, len(records)) for k, (record, run) in enumerate(both)]
    held = [settled(effect) for effect in chosen if not effect.relaxes]
    labels = {effect.label for effect in held}
    effects = [e for e in effects_for(records, setting) if e.label not in labels] + held
    shapes = dictionary(records)
    late = late_readings(records) if model.foreign else []
    moved = [d for e in (*effects, *late) for d in e.directions]
    directions = [direction_of(n) for n in MEAN] + moved + shapes
    changes = changes_of() + [c for e in effects for c in e.changes]
    sums = sums_of(records, setting, directions, changes, signals, plain, WEIGHED)
    values = {c: column_of(c).held(setting) for e in effects for c in e.columns if c not in e.relaxes}
    values = {c: v for c, v in values.items() if v != 0.0}
    return Look(
        setting, sums, parabola_of(sums, setting, model, values), (*effects, *relaxations(model.foreign)),
        (*shapes_of(shapes), *late),
    )  # fmt: skip


def backwards(effect: Effect, look: Look, answer: Answer) -> bool:
    """Whether a size would have to be negative that never is, or far beyond what there is."""
    step, covariance = answer.of(look.parabola.index(effect.columns))
    held = np.array([look.parabola.held.get(column, 0.0) for column in effect.columns])
    if effect.positive and step[0] + held[0] < 0:
        return True
    if on_grid(effect) or not effect.directions or not effect.parameters:
        return False
    std = 2.0 * np.sqrt(np.diag(covariance))
    for k, name in enumerate(effect.parameters):
        least, most = plausible(effect.name, name)
        low = catalogue_value(effect, k, float(step[k] - std[k]), look.setting, float(held[k]))
        high = catalogue_value(effect, k, float(step[k] + std[k]), look.setting, float(held[k]))
        if min(low, high) > most or max(low, high) < least:
            return True
    return False
