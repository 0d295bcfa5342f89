"""Fitting the nuisances, and with them any parameters: Fisher scoring within the healthy ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.criticism.nuisances import (
    MEAN,
    NUISANCES,
    RESTLESS,
    direction_of,
    limits_of,
    prior_precision,
    value_of,
    with_value,
)
from slam.criticism.record import Record
from slam.criticism.setting import Setting
from slam.criticism.sums import Change, Sums, sums_of

Array = NDArray[np.float64]

FIRST_S = 80.0
"""The restlessness is fitted first to so much of the flights: it shows everywhere."""
ROUNDS = 3
LARGEST_STEP = 0.5
"""Of a logarithm in one round."""


@dataclass(frozen=True)
class Fit:
    """Nuisances at their most probable healthy values."""

    setting: Setting
    model: Setting
    """What was believed before."""
    free: tuple[bool, ...]
    """Which of ``NUISANCES`` the flights have anything to say on."""


def changes_of(setting: Setting) -> list[Change]:
    """The restless nuisances as differences of two runs."""

    def change(k: int) -> Change:
        nuisance = RESTLESS[k]

        def apply(s: Setting) -> Setting:
            return with_value(nuisance, s, value_of(nuisance, s) + nuisance.step)

        return Change(nuisance.name, apply, nuisance.step)

    return [change(k) for k in range(len(RESTLESS))]


def fit_nuisances(records: Sequence[Record], model: Setting) -> Fit:
    """Most probable nuisances within their ranges, from the first part of each flight."""
    short = [cut(record, FIRST_S / len(records)) for record in records]
    setting = model
    for _ in range(ROUNDS):
        found = sums_of(short, setting, [direction_of(n) for n in MEAN], changes_of(setting))
        step = nuisance_step(found, setting, model)
        for nuisance, move in zip(NUISANCES, step, strict=True):
            low, high = limits_of(nuisance, model)
            move = float(np.clip(move, -LARGEST_STEP, LARGEST_STEP))
            x = min(max(value_of(nuisance, setting) + move, low), high)
            setting = with_value(nuisance, setting, x)
    return Fit(setting, model, tuple(True for _ in NUISANCES))


def nuisance_step(found: Sums, setting: Setting, model: Setting) -> Array:
    """(nuisances,) Fisher-scoring step under the Gaussian prior of the ranges' own variance."""
    information, score = found.total()
    index = found.index([n.name for n in NUISANCES])
    precision = np.array([prior_precision(n, model) for n in NUISANCES])
    away = np.array([value_of(n, setting) - value_of(n, model) for n in NUISANCES])
    a = information[np.ix_(index, index)] + np.diag(precision)
    return np.linalg.solve(a, score[index] - precision * away)


def cut(record: Record, longest_s: float) -> Record:
    """The record's first seconds."""
    events = int(np.searchsorted(record.times_s, record.times_s[0] + longest_s, side="right"))
    steps = int(record.first_step[events])
    return replace(
        record,
        times_s=record.times_s[:events], kinds=record.kinds[:events], values=record.values[:events],
        elapsed=record.elapsed[:events], first_step=record.first_step[: events + 1],
        step_begin_s=record.step_begin_s[:steps], step_s=record.step_s[:steps],
    )  # fmt: skip
