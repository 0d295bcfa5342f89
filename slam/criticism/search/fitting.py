"""Fitting the nuisances, and with them any parameters: Fisher scoring and Gauss-Newton."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.record import Record, with_events
from slam.criticism.kalman.setting import Setting
from slam.criticism.search.columns import bounded, column_of
from slam.criticism.search.effects import Effect
from slam.criticism.search.hypotheses import parabola_of
from slam.criticism.search.inclusion import entered, settled
from slam.criticism.search.information import Change, sums_of
from slam.criticism.search.nuisances import (
    MEAN,
    NUISANCES,
    RESTLESS,
    direction_of,
    limits_of,
    value_of,
    with_value,
)

Array = NDArray[np.float64]

FIRST_S = 60.0
"""The restlessness is fitted first to so much of the flights: it shows everywhere."""
LONG_S = 180.0
"""Flights that are longer together show as a shape by how much the size of a noise is off that was fitted to
their first parts. Ten healthy flights of a minute were ``unknown``, z 6.0, by a tilt that feeds itself."""
ROUNDS = 2
FOREIGN_ROUNDS = 7
LARGEST_STEP = 0.5
"""Of a logarithm in one round."""
ITERATIONS = 8
ENOUGH_NATS = 0.5
_RESTLESS = {n.name: n for n in RESTLESS}


def changes_of() -> list[Change]:
    """The restless nuisances as differences of two runs."""

    def change(k: int) -> Change:
        nuisance = RESTLESS[k]

        def apply(s: Setting) -> Setting:
            return with_value(nuisance, s, value_of(nuisance, s) + nuisance.step)

        return Change(nuisance.name, apply, nuisance.step, everywhere=False)

    return [change(k) for k in range(len(RESTLESS))]


def fit_nuisances(
    records: Sequence[Record], model: Setting, start: Setting | None = None, effects: Sequence[Effect] = ()
) -> Setting:
    """Most probable nuisances within their ranges, from the first parts of flights, of long ones from all.

    Of ``effects`` those are fitted with them that make noise larger, or free a nuisance of its range. Others
    keep the size that ``start`` has of them: it is of all the flights, where the first parts may not even
    have the manoeuvre that shows it.
    """
    effects = [e for e in effects if e.changes or e.relaxes]
    short = [cut(record, FIRST_S / len(records)) for record in records]
    setting = model if start is None else start
    rounds = [short] * (FOREIGN_ROUNDS if model.foreign else ROUNDS)
    if not model.foreign and sum(record.duration_s for record in records) > LONG_S:
        rounds[-1] = list(records)
    for flown in rounds:
        directions = [direction_of(n) for n in MEAN] + [d for e in effects for d in e.directions]
        changes = changes_of() + [c for e in effects for c in e.changes]
        found = sums_of(flown, setting, directions, changes)
        answer = parabola_of(found, setting, model, {}, nuisances=NUISANCES).answer(effects)
        for column, move in zip(answer.columns, answer.step, strict=True):
            name = found.columns[column]
            if name in _RESTLESS:
                low, high = limits_of(_RESTLESS[name], model) if model.foreign else (-np.inf, np.inf)
                at = value_of(_RESTLESS[name], setting)
                move = np.clip(np.clip(move, -LARGEST_STEP, LARGEST_STEP), low - at, high - at)
            setting = column_of(name).moved(setting, bounded(name, float(move), setting))
    return setting


def refit(
    records: Sequence[Record], model: Setting, setting: Setting, effects: Sequence[Effect]
) -> tuple[float, Setting]:
    """Gauss-Newton on the terms and the nuisances of the mean: log likelihood and belief at the end."""
    for effect in effects:
        setting = entered(effect, setting)
    effects = [settled(e) for e in effects]
    restless = [e for e in effects if e.changes]
    best: tuple[float, Setting] | None = None
    share, step, columns = 1.0, np.zeros(0), []
    trial = setting
    for _ in range(ITERATIONS):
        directions = [direction_of(n) for n in MEAN] + [d for e in effects for d in e.directions]
        sums = sums_of(records, trial, directions, [c for e in restless for c in e.changes])
        parabola = parabola_of(sums, trial, model, {}, nuisances=MEAN)
        loose = [e for e in effects if all(c in sums.columns for c in e.columns)]
        nats = float(sums.log_likelihood.sum()) - parabola.penalty_at_belief(
            [c for e in loose for c in e.relaxes]
        )
        if best is not None and nats < best[0]:
            share *= 0.4
            if share < 0.05:
                break
        else:
            gained = np.inf if best is None else nats - best[0]
            best, share = (nats, trial), 1.0
            answer = parabola.answer(loose)
            columns, step = [sums.columns[c] for c in answer.columns], answer.step
            if gained < ENOUGH_NATS:
                break
        trial = best[1]
        for column, size in zip(columns, step, strict=True):
            trial = column_of(column).moved(trial, share * bounded(column, float(size), best[1]))
    assert best is not None
    return best


def cut(record: Record, longest_s: float) -> Record:
    """The record's first seconds."""
    return with_events(record, record.times_s <= record.times_s[0] + longest_s)
