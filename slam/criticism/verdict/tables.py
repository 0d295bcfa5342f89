"""The tables of a verdict: hypotheses ranked, the vehicle's own constants, how white the residuals are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.criticism.kalman.filter import USED
from slam.criticism.kalman.readings import CHANNELS, place_of
from slam.criticism.kalman.record import Record
from slam.criticism.search.look import Look
from slam.criticism.search.nuisances import NUISANCES, value_of
from slam.criticism.search.search import Search
from slam.criticism.verdict.criticism import ChannelCheck, Interval, Rank
from slam.criticism.verdict.flown import Flown
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE, named


def ranking(found: Search, probability: dict[str, float]) -> tuple[Rank, ...]:
    """All terms, "nothing" and "something else", by probability and by how far each stands out alone."""
    z: dict[str, float] = {}
    for standing in found.first.standing([], found.first.effects):
        if named(standing.effect):
            z[standing.effect.name] = max(z.get(standing.effect.name, 0.0), standing.z)
    names = [*z, NOTHING, SOMETHING_ELSE]
    ranks = [Rank(name, probability.get(name, 0.0), z.get(name, 0.0)) for name in names]
    return tuple(sorted(ranks, key=lambda r: (-r.probability, -r.z)))


def nuisances_told(found: Search, best: Flown | None) -> dict[str, Interval]:
    """This vehicle's own constants with their 95 % intervals."""
    look = found.last
    answer = look.parabola.answer(found.chosen)
    step, covariance = answer.of(look.parabola.index(look.parabola.names))
    values: dict[str, Interval] = {}
    for k, nuisance in enumerate(NUISANCES):
        x, std = look.parabola.at[k] + step[k], 1.96 * float(np.sqrt(covariance[k, k]))
        if best is not None and nuisance.name in best.std:
            x, std = value_of(nuisance, best.setting), 1.96 * best.std[nuisance.name]
        ends = [x, x - std, x + std]
        if nuisance.kind != "mean":
            ends = [float(np.exp(e)) for e in ends]
        values[nuisance.name] = Interval(float(ends[0]), nuisance.unit, float(ends[1]), float(ends[2]))
    return values


def checks(records: Sequence[Record], look: Look) -> tuple[ChannelCheck, ...]:
    """Whether each channel's whitened innovations are white: mean square and correlation with the next."""
    pooled: dict[int, list[np.ndarray]] = {}
    for record, run in zip(records, look.sums.passes, strict=True):
        for channel in range(len(CHANNELS)):
            kind, c = place_of(channel)
            rows = record.kinds == kind
            white = run.white[rows, c][run.status[rows, c] == USED]
            if len(white) > 1:
                pooled.setdefault(channel, []).append(white)
    checks = []
    for channel, parts in sorted(pooled.items()):
        every = np.concatenate(parts)
        products = np.concatenate([p[1:] * p[:-1] for p in parts])
        checks.append(
            ChannelCheck(CHANNELS[channel], len(every), float(np.mean(every**2)), float(np.mean(products)))
        )
    return tuple(checks)
