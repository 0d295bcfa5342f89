"""Consistency of a cause: its size in each flight, time and channel, and before and after a moment.

If one size holds everywhere, the score of each part beside the common sizes is chance: a chi-square with as
many degrees of freedom as the parts have sizes. Common parameters (nuisances, sizes) are projected out.

The greatest difference before and after a moment is the sup-Wald statistic of a break at an unknown time
(Andrews, 1993). An attitude error that comes and goes has no such moment, and a small step is no scatter.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.linalg import block_diag

from backend.measurements import GRAVITY_M_S2
from frontend.cores import in_threads
from slam.core.arrays import Array, Ints
from slam.core.normal_deviates import deviate
from slam.criticism.finding import Inconsistency, Onset
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import Run
from slam.criticism.kalman.readings import ATTITUDE, CHANNEL_UNITS, CHANNELS, VELOCITY, channels_of
from slam.criticism.search.effects import Effect, is_variance
from slam.criticism.search.fitted_parameters import MEAN_NUISANCES, MEAN_PERTURBATIONS, fitted_parameter
from slam.criticism.search.information import FisherInformation
from slam.criticism.search.quadratic_likelihood import RIDGE, QuadraticLikelihood
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import with_misfit
from slam.criticism.verdict.held_out import held_out
from slam.data_quality.break_in_time import likeliest_break
from slam.data_quality.finding import VaryingSize, flights_to_name
from slam.simulation.terms import CATALOGUE

PART_S = 5.0
MOMENT_S = 1.0
"""Duration of the parts before and after which sizes are compared where innovations are white."""
CONSTANTS = [f"{CHANNELS[c]} ~ one" for kind in (ATTITUDE, VELOCITY) for c in channels_of(kind)]
"""Constant errors that are no terms: an attitude or a speed that loses its reference."""
TELLING = 0.5
"""Greatest standard error of a segment's size, as a share of the size, for the segment to count."""
FEWEST_SIZES = 5
BEYOND_CHANCE = 4.0
"""Mean square of the segments' deviations, in variances of white rows, beyond which a size varies."""
LARGE = 0.5
"""Least scatter beyond chance, as a share of the size."""
LEVEL = ("accel_bias.x", "accel_bias.y")
"""Columns along which an attitude error acts like an error of the accelerometer."""
CERTAIN_Z = 5.0
"""Least z of a change. The 1 % point for 20 parameters is 4.2 (Andrews, 1993, table I, by Bonferroni)."""


@dataclass(frozen=True)
class SizeOverTime:
    """Size of one parameter in the parts of flights that show it, with all other effects as fitted."""

    effect: str
    parameter: str
    unit: str
    flights: tuple[str, ...]
    """Flight of each part."""
    begin_s: Array
    """(n,) begin of each part, which lasts ``part_s``."""
    sizes: Array
    errors: Array
    """(n,) standard errors of the sizes."""
    common: float
    """Size that fits all parts together."""
    part_s: float = PART_S

    @property
    def varies(self) -> bool:
        """Whether it varies between the parts by more than chance, and by half of itself: errors between
        instruments are correlated. A variance naturally differs from part to part."""
        if len(self.sizes) < FEWEST_SIZES:
            return False
        parameter = CATALOGUE[self.effect].parameter(self.parameter)
        chance, variance = float(np.mean(self.errors**2)), float(np.var(self.sizes, ddof=1))
        large = LARGE * (self.common - parameter.neutral)
        return variance > max(BEYOND_CHANCE * chance, chance + large**2) and not parameter.squared

    def finding(self) -> VaryingSize:
        """Return the finding that it varies between the parts."""
        least, most = float(self.sizes.min()), float(self.sizes.max())
        off_deg = float(np.degrees(np.arctan((most - least) / GRAVITY_M_S2)))
        return VaryingSize(
            effect=self.effect, parameter=self.parameter, least=least, most=most, unit=self.unit,
            segment_s=self.part_s, like_attitude_deg=off_deg * (f"{self.effect}.{self.parameter}" in LEVEL),
        )  # fmt: skip


@dataclass(frozen=True)
class Parts:
    """Flights in parts of ``part_s``."""

    fisher: FisherInformation
    """Its segments are the parts."""
    names: Sequence[str]
    begin_s: Array
    """(parts,)."""
    part_s: float = PART_S

    def sizes_over_time(
        self, effect: Effect, step: Array, parameters: FilterParameters, base_sizes: Array | float = 0.0
    ) -> list[SizeOverTime]:
        """Return the sizes of each column of an effect, fitted together to each part beside a ``step``
        (columns,) of all else from ``parameters``, in which its sizes are ``base_sizes``."""
        own = np.array([self.fisher.columns.index(d.name) for d in effect.perturbations], dtype=np.int64)
        information = self.fisher.information[:, own[:, None], own]
        information = information * (1.0 + RIDGE * np.eye(len(own))) + 1e-12 * np.eye(len(own))
        moved = np.linalg.solve(information, self.fisher.left_at(step)[:, own, None])[:, :, 0]
        errors = np.sqrt(np.diagonal(np.linalg.inv(information), axis1=1, axis2=2))
        series = []
        for k, common in enumerate((step[own] + base_sizes).tolist()):
            parameter = CATALOGUE[effect.name].parameter(effect.parameters[k])
            sure = np.flatnonzero(errors[:, k] < TELLING * max(abs(common), effect.tolerance))
            each = [(common + moved + sign * errors)[sure, k].tolist() for sign in (0.0, 1.0, -1.0)]
            sizes, high, low, whole = (
                np.array([effect.in_catalogue_units(k, x, parameters) for x in of])
                for of in (*each, [common])
            )
            series.append(SizeOverTime(
                effect=effect.name, parameter=parameter.name, unit=parameter.unit,
                flights=tuple(self.names[j] for j in self.fisher.flight[sure].tolist()),
                begin_s=self.begin_s[sure], sizes=sizes, errors=0.5 * np.abs(high - low),
                common=float(whole[0]), part_s=self.part_s,
            ))  # fmt: skip
        return series


def onset(
    last: QuadraticLikelihood, chosen: Sequence[Effect], among: Sequence[Effect], parts: Parts,
    least_z: float = CERTAIN_Z,
) -> Onset | None:  # fmt: skip
    """Return the most certain change of a size within a flight beside the chosen effects, or None. ``among``:
    the terms, and constant errors of single channels, that may change."""
    changes = [
        change
        for effect in among
        for k, perturbation in enumerate(effect.perturbations) if not is_variance(perturbation)
        for change in _changes(last, chosen, effect, k, parts) if change.z > least_z
    ]  # fmt: skip
    return max(changes, key=lambda change: change.z, default=None)


def _changes(
    last: QuadraticLikelihood, chosen: Sequence[Effect], effect: Effect, k: int, parts: Parts
) -> list[Onset]:
    """Return the likeliest change of an effect's column k in each flight, beside the chosen effects."""
    fisher, column, entry = parts.fisher, effect.columns[k], effect.perturbations[k].entry
    if effect.is_term:
        factor, parameter = fitted_parameter(column).factor, effect.parameters[k]
        unit = CATALOGUE[effect.name].parameter(parameter).unit
        concerns = {"effect": effect.name, "parameter": parameter}
    else:
        unit, concerns, factor = CHANNEL_UNITS[entry], {"channel": CHANNELS[entry]}, 1.0
    effects = [*(e for e in chosen if not e.repeats(effect)), effect]
    step, onsets = last.maximise(effects).whole, []
    rest = last.index([*last.names, *(c for e in effects for c in e.columns if c != column)])
    # What is left of the column once the others are projected out.
    along = np.zeros(len(step))
    along[last.index([column])] = 1.0
    information = last.information
    along[rest] = -np.linalg.lstsq(information[np.ix_(rest, rest)], information[rest] @ along, rcond=1e-12)[0]
    score = fisher.left_at(step) @ along
    known = (fisher.information @ along) @ along
    for flight in np.unique(fisher.flight).tolist():
        inside, name = fisher.flight == flight, flights_to_name(parts.names)[flight]
        after, change, z = likeliest_break(score[inside], known[inside], effect.tolerance, not last.clustered)
        at_s = float(parts.begin_s[inside][after])
        onsets.append(Onset(at_s, factor * change, unit, flight=name, z=z, **concerns))
    return onsets


def commanded_onset(found: SearchResult, parameters: FilterParameters, least_z: float) -> Onset | None:
    """Return the most certain change within a flight with commands beside the chosen terms, which are in the
    ``parameters``, or None."""
    among = [
        e for e in (*found.last.effects, *found.last.patterns)
        if e.name in CONSTANTS or (e.is_term and e.perturbations and not e.is_profiled)
    ]  # fmt: skip
    effects = [*(e.free for e in found.chosen), *among]
    tried = list(dict.fromkeys([*MEAN_PERTURBATIONS, *(d for e in effects for d in e.perturbations)]))
    names = tuple(d.name for d in tried)

    def one(k: int) -> list[tuple[float, Array, Array]]:
        times_s, (_, _, step_s) = found.records[k].times_s, found.records[k].steps
        signals = {"one": (np.ones(len(step_s)), np.ones(len(times_s)))}
        segments = Run(found.records[k], parameters, tried, signals).segments(MOMENT_S)
        known = ((rows.events, rows.sensitivity, rows.white) for rows in segments if len(rows.events))
        return [(float(times_s[events[0]]), by.T @ by, by.T @ white) for events, by, white in known]

    each = in_threads(one, range(len(found.records)))
    if not any(each):
        return None
    begin_s, information, score = (np.array(of) for of in zip(*chain(*each), strict=True))
    flight = np.repeat(np.arange(len(each)), [len(parts) for parts in each])
    fisher = FisherInformation(names, flight, information, score, np.zeros(len(score)))
    parts = Parts(fisher, [record.name for record in found.records], begin_s, MOMENT_S)
    last = replace(found.last, fisher=fisher, parameters=parameters, nuisances=MEAN_NUISANCES)
    chosen = [e.free for e in found.chosen if {*e.free.columns} <= {*names}]
    return onset(last, chosen, among, parts, least_z)


DISAGREE_Z = 4.0
MOST_EXCESS = 0.5
"""Share of the chi-square that a cause explains, beyond which its parts do not agree on one cause."""
WEAK = 1e-6
"""Share of the strongest part's information below which a part is no evidence for the size."""
_BETWEEN = "from flight to flight", "during a flight", "from channel to channel"
"""The parts that a cause is compared between, in the order of `_parts_of`."""


def _parts_of(found: SearchResult, parameters: FilterParameters, chosen: Sequence[Effect]) -> list[Parts]:
    """Return the flights by each kind of parts of ``_BETWEEN``; channels have neither a flight nor a time."""
    perturbations = [*MEAN_PERTURBATIONS, *(d for e in chosen for d in e.perturbations)]
    records = found.records

    def one(k: int) -> tuple[Array, Array, Ints]:
        (rows,) = Run(records[k], parameters, perturbations).segments(np.inf)
        time = (records[k].times_s[rows.events] // PART_S).astype(np.int64)
        part = np.column_stack([np.full(len(rows.events), k), time, rows.channels])
        return rows.sensitivity, rows.white, part

    each = in_threads(one, range(len(records)))
    sensitivity, white, part = (np.concatenate([of[i] for of in each]) for i in range(3))
    columns, names = [d.name for d in perturbations], [record.name for record in records]
    (flight, time, channel), none, parts = part.T, np.zeros(len(part), np.int64), []
    for of_row in ((flight, none), (flight, time), (none, channel)):
        labels, place = np.unique(np.column_stack(of_row), axis=0, return_inverse=True)
        fisher = FisherInformation.of_rows(columns, sensitivity, white, place.ravel(), labels[:, 0])
        parts.append(Parts(fisher, names, PART_S * labels[:, 1]))
    return parts


def _precision(model: FilterParameters, columns: Sequence[str]) -> Array:
    """Return (columns,) the precision of the prior of each, of which the first are the nuisances'."""
    of_nuisances = [n.prior_precision(model) for n in MEAN_NUISANCES]
    return np.pad(of_nuisances, (0, len(columns) - len(of_nuisances))) + RIDGE


def _most_probable(fisher: FisherInformation, precision: Array) -> tuple[Array, Array]:
    """Return the step to the most probable sizes, and the information with that of the priors."""
    total = fisher.information.sum(axis=0) + np.diag(precision)
    return np.linalg.solve(total, fisher.score.sum(axis=0)), total


def _inconsistency(
    effect: Effect, between: str, fisher: FisherInformation, own: Ints, precision: Array
) -> Inconsistency | None:
    """Return by how much more than chance an effect's columns ``own`` disagree between segments, or None."""
    step, total = _most_probable(fisher, precision)
    cross = fisher.information[:, own].reshape(-1, len(total))
    left = block_diag(*fisher.information[:, own[:, None], own]) - cross @ np.linalg.solve(total, cross.T)
    right = fisher.left_at(step)[:, own].ravel()
    scale = 1.0 / np.sqrt(np.tile(np.maximum(np.diag(total)[own], 1e-12), len(fisher.score)))
    values, vectors = np.linalg.eigh(left * scale[:, None] * scale)
    strong = values > WEAK
    along = vectors[:, strong].T @ (scale * right)
    chi2 = float(np.sum(along**2 / values[strong]))
    degrees = int(strong.sum())
    if chi2 <= degrees:
        return None
    return Inconsistency(between, chi2 - degrees, effect=effect.name, z=deviate(chi2, degrees))


def contradictions(
    found: SearchResult, parameters: FilterParameters
) -> tuple[dict[str, Inconsistency], set[str]]:
    """Return the inconsistencies of causes by name, and the causes that contradict more than they explain.
    Only effects that move the mean of the readings are compared. ``parameters`` include them."""
    chosen = [e.free for e in found.chosen]
    kinds = list(zip(_BETWEEN, _parts_of(found, parameters, chosen), strict=True))
    precision = _precision(found.model, kinds[0][1].fisher.columns)
    ends = np.cumsum([len(MEAN_NUISANCES), *(len(e.perturbations) for e in chosen)])
    inconsistent, refuted = {}, set()
    for effect, own in zip(found.chosen, np.split(np.arange(ends[-1]), ends)[1:-1], strict=True):
        each = (_inconsistency(effect, by, p.fisher, own, precision) for by, p in kinds if len(own))
        parts = [inconsistency for inconsistency in each if inconsistency is not None]
        worst = max(parts, key=lambda a: a.z, default=None)
        rest = [e for e in found.chosen if e is not effect]
        whole = found.last.score_tests(rest, [effect])[0]
        if worst is None or worst.z < with_misfit(DISAGREE_Z, 0.0 if effect.is_saturation else whole.z):
            continue
        inconsistent[effect.name] = worst
        explained = whole.nats
        if effect.is_saturation:  # no expansion shows what it explains
            explained = np.inf if found.model.out_of_model else held_out(found).total
        if max(a.excess for a in parts) > MOST_EXCESS * 2 * explained:
            refuted.add(effect.name)
    return inconsistent, refuted


def changing_sizes(
    found: SearchResult, parameters: FilterParameters, names: Container[str]
) -> tuple[SizeOverTime, ...]:
    """Return the sizes over time of causes of some ``names``, and of terms that look like one of these."""
    known = {effect.name for effect in found.chosen}
    others = {e.name: e for e in reversed(found.last.effects) if e.name in names and e.name not in known}
    chosen = [e.free for e in (*found.chosen, *others.values())]
    if not (shown := [e for e in chosen if e.is_term and e.name in names]):
        return ()
    _, parts, _ = _parts_of(found, parameters, chosen)
    step, _ = _most_probable(parts.fisher, _precision(found.model, parts.fisher.columns))
    series: list[SizeOverTime] = []
    for effect in shown:
        base_sizes = np.array([fitted_parameter(d.name).size_in(parameters) for d in effect.perturbations])
        series += parts.sizes_over_time(effect, step, parameters, base_sizes)
    return tuple(series)
