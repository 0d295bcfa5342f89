"""Consistency of a cause: its size in each flight, time and channel, and before and after a moment.

If one size holds everywhere, the score of each part beside the common sizes is chance: a chi-square with as
many degrees of freedom as the parts have sizes. Common parameters (nuisances, sizes) are projected out.

The greatest difference before and after a moment is the sup-Wald statistic of a break at an unknown time
(Andrews, 1993). An attitude error that comes and goes has no such moment, and a small step is no scatter.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import norm
from scipy.stats import t as student

from backend.measurements import GRAVITY_M_S2
from frontend.cores import in_threads
from slam.core.arrays import Array, Ints
from slam.criticism.finding import Inconsistency, Onset, VaryingSize
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import Run
from slam.criticism.search.effects import Effect, is_variance
from slam.criticism.search.fitted_parameters import MEAN_NUISANCES, MEAN_PERTURBATIONS, fitted_parameter
from slam.criticism.search.information import FisherInformation
from slam.criticism.search.quadratic_likelihood import RIDGE
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import deviate, with_misfit
from slam.criticism.verdict.held_out import held_out
from slam.data_quality.finding import flights_to_name
from slam.simulation.terms import CATALOGUE

PART_S = 5.0
FEWEST_PARTS = 8
"""Least number of parts of a flight in which a change has a moment."""
TELLING = 0.5
"""Greatest standard error of a segment's size, as a share of the size, for the segment to count."""
FEWEST_SIZES = 5
BEYOND_CHANCE = 4.0
"""Mean square of the segments' deviations, in variances of white rows, beyond which a size varies."""
LARGE = 0.5
"""Least scatter beyond chance, as a share of the size."""
LEVEL = ("accel_bias.x", "accel_bias.y")
"""Columns along which an attitude error acts like an error of the accelerometer."""
TRIMMED = 0.15
"""Least share of a parameter's information on either side of the moment of a change."""
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


def onset(found: SearchResult, parts: Parts) -> Onset | None:
    """Return the most certain change of a term's parameter within a flight, or None."""
    changes = [
        change
        for effect in found.last.effects if effect.is_term
        for k, perturbation in enumerate(effect.perturbations) if not is_variance(perturbation)
        for change in _changes(found, parts, effect, k) if change.z > CERTAIN_Z
    ]  # fmt: skip
    return max(changes, key=lambda change: change.z, default=None)


def _changes(found: SearchResult, parts: Parts, effect: Effect, k: int) -> list[Onset]:
    """Return the likeliest change of an effect's column k in each flight, beside the chosen effects."""
    last, fisher, column = found.last, parts.fisher, effect.columns[k]
    parameter, onsets = CATALOGUE[effect.name].parameter(effect.parameters[k]), []
    effects = [*(e for e in found.chosen if not e.repeats(effect)), effect]
    step = last.maximise(effects).whole
    rest = last.index([c for e in effects for c in e.columns if c != column])
    # What is left of the column once the others are projected out.
    along = np.zeros(len(step))
    along[last.index([column])] = 1.0
    information = last.information
    along[rest] = -np.linalg.lstsq(information[np.ix_(rest, rest)], information[rest] @ along, rcond=1e-12)[0]
    score = fisher.left_at(step) @ along
    known = (fisher.information @ along) @ along
    for flight in np.unique(fisher.flight).tolist():
        inside, name = fisher.flight == flight, flights_to_name(parts.names)[flight]
        after, change, z = _break(score[inside], known[inside], effect.tolerance)
        onsets.append(Onset(
            flight=name, effect=effect.name, parameter=parameter.name, z=z,
            time_s=float(parts.begin_s[inside][after]), change=change, unit=parameter.unit,
        ))  # fmt: skip
    return onsets


def _break(score: Array, information: Array, tolerance: float) -> tuple[int, float, float]:
    """Return the first segment after the likeliest break, the change there, and its z: Student's, as a normal
    one, by the variance of the segments about the two sizes, no less than that of white rows."""
    count, whole = len(score), float(information.sum())
    sums = np.cumsum([score, information, score**2, score * information, information**2], axis=1)
    last = np.flatnonzero(np.minimum(sums[1], whole - sums[1]) >= TRIMMED * whole)
    if count < FEWEST_PARTS or whole <= 0.0 or not len(last):
        return 0, 0.0, 0.0
    # Sums over the segments on either side of each break.
    s, n, ss, sn, nn = np.swapaxes([sums[:, last], sums[:, -1:] - sums[:, last]], 0, 1)
    sizes = s / n
    squares = ss - 2.0 * sizes * sn + sizes**2 * nn
    variance = np.sum(np.maximum(squares * count / (count - 2), n) / n**2, axis=0)
    change = sizes[1] - sizes[0]
    t = np.abs(change) / np.sqrt(variance + tolerance**2)
    k = int(np.argmax(t))
    z = float(-norm.ppf(max(float(student.sf(t[k], count - 2)), 1e-300)))
    return int(last[k]) + 1, float(change[k]), z


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
