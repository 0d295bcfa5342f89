"""The verdict on flights without a command log: which instrument's error parts them from the others.

Each effect is a column of the white rows of all balances. The one that explains most is taken as long as it
stands out, with an error that holds what stretches of ten seconds scatter by, and predicts held-out parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.criticism.search.effects import plausible
from slam.criticism.search.occam import VERY_SIMILAR_NATS, occam
from slam.criticism.search.thresholds import MISFIT
from slam.criticism.unled.balances import Rows, balances_of
from slam.criticism.verdict.covariate import Covariate, Misses
from slam.criticism.verdict.criticism import Cause, Criticism, Gain, Interval, Rank
from slam.criticism.verdict.decision import CONFIRMED_NATS, SURE
from slam.criticism.verdict.sentence import sentence_of
from slam.flight import Flight
from slam.progress import Progress, Tally, silent
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

REASON = (
    "no command log: what moved the vehicle is not known; its instruments are held against each other and "
    "its motion is not judged"
)
NOTHING_TO_HOLD = "no command log, and too little of imu and attitude to hold other instruments against"
STANDS_OUT_Z = 5.0
MOST = 5
STRETCH_S = 10.0
FEWEST_FLIGHTS = 3
SEGMENTS = 6
UNTOLD = 10.0
"""Times the largest value that a term bears: of what shows from there on only, the flights tell nothing."""
RIDGE = 1e-9
TOLERANCE = {
    "gyro_bias": 1e-4, "gyro_scale": 1e-3, "imu_misalignment": 1e-3, "accel_bias": 1e-2, "accel_scale": 1e-3,
    "flow_scale": 5e-3, "flow_derotation": 5e-3, "sonar_scale": 3e-3, "sonar_slant": 3e-2, "sonar_tilt": 3e-3,
    "sonar_lag": 3e-3, "attitude late": 3e-3, "velocity late": 3e-3,
}  # fmt: skip
"""What integrals over half a second leave of each in healthy flights: sizes below are none."""


@dataclass(frozen=True)
class _Data:
    """All rows of all flights."""

    off: Array
    columns: dict[str, Array]
    kind: NDArray[np.str_]
    """Of each row, what is held against the imu."""
    part: Ints
    """Which held-out part a row belongs to."""
    cluster: Ints
    by: str

    def table(self, effects: Sequence[str]) -> Array:
        """(n, columns) of some effects."""
        names = [n for e in effects for n in self.of(e)]
        return np.column_stack([self.columns[n] for n in names]) if names else np.zeros((len(self.off), 0))

    def of(self, effect: str) -> list[str]:
        """Columns of an effect."""
        return [n for n in self.columns if n.rpartition(".")[0] == effect]

    def effects(self) -> list[str]:
        """All that the streams can show."""
        return list(dict.fromkeys(n.rpartition(".")[0] for n in self.columns))


def judged_unled(
    flights: Sequence[Flight], model: Model, dropped: Sequence[str] = (), progress: Progress = silent
) -> Criticism | None:
    """Hold the instruments against each other; None where the flights have no two that can be."""
    rows = [balances_of(flight) for flight in Tally(progress, "instruments", len(flights)).each(flights)]
    if not any(rows):
        return None
    data = _data(rows)
    chosen: list[str] = []
    while len(chosen) < MOST:
        open_ = [e for e in data.effects() if e not in chosen and _is_plausible(data, chosen, e)]
        best = max(open_, key=lambda e: _nats(data, [*chosen, e]), default="")
        if not best or _z(data, chosen, best) < STANDS_OUT_Z:
            break
        if _held_out(data, chosen, best).sum() < CONFIRMED_NATS:
            break
        chosen.append(best)
    for effect in list(chosen):
        # What led alone may stand behind another beside the rest.
        rest = [e for e in chosen if e != effect]
        open_ = [e for e in data.effects() if e not in rest and _is_plausible(data, rest, e)]
        best = max(open_, key=lambda e: _nats(data, [*rest, e]), default=effect)
        chosen[chosen.index(effect)] = best
    causes = tuple(_cause(data, chosen, e) for e in chosen if e in CATALOGUE)
    late = [
        f"{e} by {1e3 * _fit(data, chosen)[0][_place(data, chosen, e)][0]:.0f} ms"
        for e in chosen if e not in CATALOGUE
    ]  # fmt: skip
    unsure = [c.name for c in causes if c.probability < SURE and len(c.alternatives) == 1]
    remainder = "; ".join([*late, *(f"{name} may be something else" for name in unsure)])
    equivalents = causes[0].alternatives if causes and len(causes[0].alternatives) > 1 else ()
    if not causes:
        verdict = "unknown" if remainder else "nothing_wrong"
    elif equivalents:
        verdict = "ambiguous"
    else:
        verdict = "named_with_remainder" if remainder else "named"
    seen = _detectable(data)
    sentence = sentence_of(verdict, causes, equivalents, remainder, seen)  # type: ignore[arg-type]
    extended = model
    for cause in causes:
        limits = {p.name: p for p in CATALOGUE[cause.name].parameters}
        values = {k: min(max(p.value, limits[k].least), limits[k].most) for k, p in cause.parameters.items()}
        extended = extended.with_term(cause.name, **values)
    told = {cause.name: cause.probability for cause in causes}
    ranks = [Rank(e, told.get(e, 0.0), _z(data, [], e)) for e in data.effects() if e in CATALOGUE]
    return Criticism(
        verdict,  # type: ignore[arg-type]
        f"{sentence} ({REASON[0].upper()}{REASON[1:]}.)",
        causes,
        equivalents or tuple(c.name for c in causes),
        remainder,
        detectable=seen,
        ranking=tuple(sorted(ranks, key=lambda r: (-r.probability, -r.z))),
        covariate=_covariate(data, chosen, causes[0]) if causes else None,
        threshold=STANDS_OUT_Z,
        model=model,
        extended=extended,
        flights=tuple(f.name for f, found in zip(flights, rows, strict=True) if found),
        dropped=(*dropped, REASON),
    )


def _data(rows: Sequence[Sequence[Rows]]) -> _Data:
    names = list(dict.fromkeys(n for flight in rows for r in flight for n in r.traces))
    off = np.concatenate([r.off for flight in rows for r in flight])
    columns = {
        n: np.concatenate([r.traces.get(n, np.zeros(len(r.off))) for flight in rows for r in flight])
        for n in names
    }
    kind = np.concatenate([np.full(len(r.off), r.kind) for flight in rows for r in flight])
    flight = np.concatenate([np.full(len(r.off), k) for k, found in enumerate(rows) for r in found])
    stretch = np.concatenate([(r.times_s // STRETCH_S).astype(np.int64) for found in rows for r in found])
    _, cluster = np.unique(np.column_stack([flight, stretch]), axis=0, return_inverse=True)
    if sum(bool(found) for found in rows) >= FEWEST_FLIGHTS:
        return _Data(off, columns, kind, flight, cluster, "flight")
    return _Data(off, columns, kind, cluster % SEGMENTS, cluster, "segment")


def _fit(data: _Data, effects: Sequence[str], rows: NDArray[np.bool_] | None = None) -> tuple[Array, Array]:
    """Sizes (p,) and information (p, p)."""
    own = slice(None) if rows is None else rows
    table = data.table(effects)[own]
    information = table.T @ table
    information[np.diag_indices(len(information))] *= 1.0 + RIDGE
    information[np.diag_indices(len(information))] += 1e-12
    return np.asarray(np.linalg.solve(information, table.T @ data.off[own])), information


def _nats(data: _Data, effects: Sequence[str]) -> float:
    """What effects explain, less what their numbers cost."""
    size, _ = _fit(data, effects)
    explained = float(size @ data.table(effects).T @ data.off)
    return 0.5 * explained - sum(_cost(data, e) for e in effects)


def _cost(data: _Data, effect: str) -> float:
    return occam(len(data.of(effect)))


def _place(data: _Data, effects: Sequence[str], effect: str) -> Ints:
    begin = sum(len(data.of(e)) for e in effects[: list(effects).index(effect)])
    return np.arange(begin, begin + len(data.of(effect)))


def _covariance(data: _Data, effects: Sequence[str]) -> tuple[Array, Array]:
    """Sizes and their covariance, by how the stretches differ, and no less than white rows have it."""
    size, information = _fit(data, effects)
    table = data.table(effects)
    left = data.off - table @ size
    scores = np.zeros((int(data.cluster.max()) + 1, len(size)))
    np.add.at(scores, data.cluster, table * left[:, None])
    plain = np.linalg.inv(information)
    count = len(scores)
    between = plain @ (scores.T @ scores) @ plain * count / max(count - len(size), 1)
    wider = np.sqrt(np.maximum(np.diag(between) / np.diag(plain), 1.0))
    return size, np.asarray(plain * wider[:, None] * wider)


def _z(data: _Data, chosen: Sequence[str], effect: str) -> float:
    """How far an effect stands out beside others: the root of its chi-square, what is tolerated taken off."""
    effects = [*(e for e in chosen if e != effect), effect]
    size, covariance = _covariance(data, effects)
    own = _place(data, effects, effect)
    spread = covariance[np.ix_(own, own)] + TOLERANCE[effect] ** 2 * np.eye(len(own))
    square = float(size[own] @ np.linalg.solve(spread, size[own]))
    return float(np.sqrt(max(square - (len(own) - 1), 0.0)))


def _is_plausible(data: _Data, chosen: Sequence[str], effect: str) -> bool:
    """Whether an effect's sizes are what it may have at all."""
    if effect not in CATALOGUE:
        return True
    size, covariance = _covariance(data, [*chosen, effect])
    for k, column in zip(_place(data, [*chosen, effect], effect), data.of(effect), strict=True):
        name = column.rpartition(".")[2]
        low, high = plausible(effect, name)
        value, std = CATALOGUE[effect].parameter(name).neutral + size[k], float(np.sqrt(covariance[k, k]))
        if not low - 2 * std <= value <= high + 2 * std:
            return False
    return True


def _held_out(data: _Data, rest: Sequence[str], effect: str) -> Array:
    """Nats that an effect gains on each part, fitted on the others."""
    gains = []
    for part in np.unique(data.part):
        own = data.part == part
        miss = []
        for effects in (list(rest), [*rest, effect]):
            size, _ = _fit(data, effects, ~own)
            miss.append(data.off[own] - data.table(effects)[own] @ size)
        gains.append(0.5 * float(np.sum(miss[0] ** 2) - np.sum(miss[1] ** 2)))
    return np.array(gains)


def _cause(data: _Data, chosen: Sequence[str], effect: str) -> Cause:
    size, covariance = _covariance(data, chosen)
    rest = [e for e in chosen if e != effect]
    parameters = {}
    for k, column in zip(_place(data, chosen, effect), data.of(effect), strict=True):
        parameter = CATALOGUE[effect].parameter(column.rpartition(".")[2])
        value = float(size[k]) + parameter.neutral
        # What integrals leave of it, and the equation's own misfit, are in it beside chance.
        std = float(np.hypot(np.sqrt(covariance[k, k]), TOLERANCE[effect]))
        half = float(np.hypot(1.96 * std, MISFIT * size[k]))
        parameters[parameter.name] = Interval(value, parameter.unit, value - half, value + half)
    open_ = [e for e in data.effects() if e not in chosen and e in CATALOGUE]
    leads = {e: _lead(data, chosen, [*rest, e]) for e in open_}
    # Of two that explain the same the one with fewer numbers leads; the other may be it all the same.
    near = sorted((e for e in open_ if leads[e] < VERY_SIMILAR_NATS), key=lambda e: leads[e])
    costs = {e: 0.0 if e in near else _cost(data, e) - _cost(data, effect) for e in open_}
    behind = np.array([0.0, *(max(leads[e] + costs[e], 0.0) for e in open_)])
    rival = next(iter([*near, *sorted(open_, key=lambda e: leads[e] + costs[e])]), "")
    weights = np.exp(-np.clip(behind, -700.0, 700.0))
    gains = _held_out(data, rest, effect)
    drawn = np.random.default_rng(0).choice(gains, size=(4000, len(gains))).sum(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    gain = Gain(float(gains.sum()), (float(low), float(high)), data.by, tuple(gains.tolist()), ())
    probability, lead = float(1.0 / weights.sum()), float(behind[1:].min(initial=np.inf))
    z = _z(data, chosen, effect)
    return Cause(effect, probability, parameters, gain, z, lead, (effect, *near), rival)


def _lead(data: _Data, effects: Sequence[str], others: Sequence[str]) -> float:
    """Nats by which some effects explain more than others do, as far as stretches of ten seconds agree on it.

    Of white rows the log likelihoods differ by m with a variance of 2 m. Where stretches scatter by more,
    errors last, and the lead counts as much less: else minutes of one lasting error decide between two
    effects that leave the same trace.
    """
    left = [data.off - data.table(e) @ _fit(data, e)[0] for e in (effects, others)]
    nats = np.bincount(data.cluster, 0.5 * (left[1] ** 2 - left[0] ** 2))
    lead, variance = float(nats.sum()), len(nats) * float(nats.var())
    return lead * min(1.0, 2.0 * abs(lead) / max(variance, 1e-12))


def _covariate(data: _Data, chosen: Sequence[str], lead: Cause) -> Covariate:
    """What the leading cause and its rival make of what parts the instruments."""
    cause, rival = lead.name, lead.rival
    rest = [e for e in chosen if e != cause]
    models = {"": rest, cause: [*rest, cause]} | ({rival: [*rest, rival]} if rival else {})
    missed = {
        name: data.off - data.table(effects) @ _fit(data, effects)[0] for name, effects in models.items()
    }
    against = []
    for name in [n for n in models if n]:
        explained = missed[""] - missed[name]
        kind = max(np.unique(data.kind), key=lambda k: float(np.sum(explained[data.kind == k] ** 2)))
        own = data.kind == kind
        against.append(
            Misses(name, str(kind), "sigma", explained[own], {n: m[own] for n, m in missed.items()})
        )
    return Covariate(cause, rival, tuple(against))


def _detectable(data: _Data) -> dict[str, tuple[float, str]]:
    found = {}
    for effect in data.effects():
        if effect in CATALOGUE:
            _, covariance = _covariance(data, [effect])
            std = float(np.sqrt(np.diag(covariance).max() + TOLERANCE[effect] ** 2))
            size, parameter = (STANDS_OUT_Z + 1.28) * std, CATALOGUE[effect].parameters[0]
            if size < UNTOLD * max(abs(parameter.most), abs(parameter.least)):
                found[effect] = size, parameter.unit
    return found
