"""Consistency of a cause: its size in each flight, time and channel.

If one size holds everywhere, the score of each part beside the common sizes is chance. It is a chi-square
with as many degrees of freedom as the parts have sizes of their own. All common parameters (nuisances, sizes)
are projected out. Where instruments are compared with each other, errors are correlated, and small
differences are significant: there only a size that varies by half of itself counts.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2
from slam.core.arrays import Array, Ints
from slam.core.units import spaced
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import Run
from slam.criticism.kalman.perturbations import Perturbation
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import Effect, is_variance
from slam.criticism.search.fitted_parameters import MEAN_NUISANCES, MEAN_PERTURBATIONS, fitted_parameter
from slam.criticism.search.information import SEGMENT_S
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import deviate, with_misfit
from slam.criticism.threads import in_threads
from slam.simulation.terms import CATALOGUE

PART_S, MOST_PARTS = 5.0, 1000
FEWEST_PARTS = 8
"""Least number of parts of a flight in which a change has a moment."""
DISAGREE_Z = 4.0
MOST_EXCESS = 0.5
"""Share of the chi-square that a cause explains, beyond which its parts do not agree on one cause."""
WEAK = 1e-6
"""Share of the strongest part's information below which a part is no evidence for the size."""
RIDGE = 1e-9
FEWEST_SIZES = 5
BEYOND_CHANCE = 4.0
"""Mean square of the segments' deviations, in variances of white rows, beyond which a size varies."""
TELLING = 0.5
"""Greatest standard error of a segment's size, as a share of the size, for the segment to count."""
LARGE = 0.5
"""Least scatter beyond chance, as a share of the size."""
LEVEL = ("accel_bias.x", "accel_bias.y")
"""Columns along which an attitude error acts like an error of the accelerometer."""
_BETWEEN = "from flight to flight", "during a flight", "from channel to channel"
"""The parts that a cause is compared between, in the order of the columns of `consistencies`."""


@dataclass(frozen=True)
class PartConsistency:
    """Consistency of a cause between parts of the flights."""

    by: str
    """Between which parts it changes: one of ``_BETWEEN``."""
    z: float
    """Normal deviate of the chi-square of their differences."""
    excess: float
    """Excess of the chi-square over its expectation."""


def consistencies(
    records: Sequence[Record], model: FilterParameters, parameters: FilterParameters, chosen: Sequence[Effect]
) -> list[tuple[PartConsistency, ...]]:
    """Return consistencies for each chosen effect that moves the mean of the readings; none for the others.

    ``parameters`` include the effects at their sizes.
    """
    traces, white, part, precision = _rows_of(records, model, parameters, chosen)
    ends = np.cumsum([len(MEAN_NUISANCES), *(len(e.perturbations) for e in chosen)])
    columns = [np.arange(begin, end) for begin, end in pairwise(ends.tolist())]
    between = list(enumerate(_BETWEEN))
    return [
        tuple(_consistency(by, traces, white, part[:, i], own, precision) for i, by in between if len(own))
        for own in columns
    ]


def _rows_of(
    records: Sequence[Record], model: FilterParameters, parameters: FilterParameters, chosen: Sequence[Effect]
) -> tuple[Array, Array, Ints, Array]:
    """Return sensitivities, innovations, numbers of their parts (rows, 3), and precisions of the priors."""
    perturbations = [*MEAN_PERTURBATIONS, *_moved(chosen)]
    precision = np.zeros(len(perturbations))
    precision[: len(MEAN_NUISANCES)] = [n.prior_precision(model) for n in MEAN_NUISANCES]

    def one(k: int) -> tuple[Array, Array, Ints]:
        rows = list(Run(records[k], parameters, perturbations).segments(SEGMENT_S))
        events = np.concatenate([r.events for r in rows])
        time = (records[k].times_s[events] // PART_S).astype(np.int64)
        channels = np.concatenate([r.channels for r in rows])
        part = np.column_stack([np.full(len(events), k), MOST_PARTS * k + time, channels])
        return np.concatenate([r.sensitivity for r in rows]), np.concatenate([r.white for r in rows]), part

    found = in_threads(one, range(len(records)))
    traces, white, part = (np.concatenate([f[i] for f in found]) for i in range(3))
    return traces, white, part, precision


def _moved(chosen: Sequence[Effect]) -> Iterator[Perturbation]:
    return (d for e in chosen for d in e.perturbations)


def _consistency(
    by: str, traces: Array, white: Array, part: Ints, own: Ints, precision: Array
) -> PartConsistency:
    total = traces.T @ traces + np.diag(precision + 1e-9)
    score = white @ traces
    step = np.linalg.solve(total, score)
    labels = np.unique(part)
    k = len(own)
    cross = np.zeros((len(labels) * k, len(total)))
    left, right = np.zeros((len(labels) * k, len(labels) * k)), np.zeros(len(labels) * k)
    for g, label in enumerate(labels):
        rows = traces[part == label]
        at = slice(g * k, (g + 1) * k)
        cross[at] = rows[:, own].T @ rows
        left[at, at] = cross[at][:, own]
        right[at] = white[part == label] @ rows[:, own] - cross[at] @ step
    left = left - cross @ np.linalg.solve(total, cross.T)
    scale = 1.0 / np.sqrt(np.tile(np.maximum(np.diag(total)[own], 1e-12), len(labels)))
    values, vectors = np.linalg.eigh(left * scale[:, None] * scale)
    strong = values > WEAK
    along = vectors[:, strong].T @ (scale * right)
    chi2 = float(np.sum(along**2 / values[strong]))
    degrees = int(strong.sum())
    return PartConsistency(by, deviate(chi2, degrees) if chi2 > degrees else 0.0, chi2 - degrees)


def contradictions(found: SearchResult, parameters: FilterParameters) -> tuple[dict[str, str], set[str]]:
    """Return descriptions of inconsistent causes, by name, and the names of causes that contradict themselves
    more than they explain.

    For an out-of-model vehicle every cause is inconsistent, as its equations are wrong.
    """
    chosen = [e.free for e in found.chosen]
    descriptions, refuted = {}, set()
    consistency = consistencies(found.records, found.model, parameters, chosen)
    for effect, parts in zip(found.chosen, consistency, strict=True):
        worst = max(parts, key=lambda a: a.z, default=None)
        rest = [e for e in found.chosen if e is not effect]
        whole = found.last.score_tests(rest, [effect])[0]
        if worst is None or worst.z < with_misfit(DISAGREE_Z, 0.0 if effect.is_saturation else whole.z):
            continue
        descriptions[effect.name] = f"changes {worst.by} (z = {worst.z:.1f})"
        if not effect.is_saturation and max(a.excess for a in parts) > MOST_EXCESS * 2 * whole.nats:
            refuted.add(effect.name)
    return descriptions, refuted


def disagreements(found: SearchResult) -> list[str]:
    """Describe parameters of the chosen terms that vary between segments by half of themselves."""
    descriptions = []
    for effect in (e for e in found.chosen if e.is_term):
        for name, sizes in varying_sizes(found, effect).items():
            k = effect.columns.index(name)
            unit = CATALOGUE[effect.name].parameter(effect.parameters[k]).unit
            off_deg = float(np.degrees(np.arctan(np.ptp(sizes) / GRAVITY_M_S2)))
            like = f", like an attitude error of {off_deg:.0f} deg" if name in LEVEL else ""
            least, most = (
                effect.in_catalogue_units(k, x, found.last.parameters) for x in (sizes.min(), sizes.max())
            )
            sizes_of = f"{least:.2g} to {most:.2g}{spaced(unit)} by segments of {SEGMENT_S:g} s"
            descriptions.append(f"{name} is {sizes_of}{like}")
    return descriptions


def varying_sizes(found: SearchResult, effect: Effect) -> dict[str, Array]:
    """Return column -> (segments,) sizes, of the parameters of a chosen term that vary between segments by
    half of themselves, with all other terms at their common sizes."""
    quadratic, fisher = found.last.quadratic, found.last.fisher
    step, own = quadratic.maximise(found.chosen).whole, quadratic.index(effect.columns)
    others = np.where(np.isin(np.arange(len(step)), own), 0.0, step)
    score = fisher.score[:, own] - fisher.information[:, own] @ others
    information = fisher.information[:, own[:, None], own]
    information = information * (1.0 + RIDGE * np.eye(len(own))) + 1e-12 * np.eye(len(own))
    sizes = np.linalg.solve(information, score[:, :, None])[:, :, 0]
    errors = np.sqrt(np.diagonal(np.linalg.inv(information), axis1=1, axis2=2))
    varying = {}
    for k, (name, perturbation) in enumerate(zip(effect.columns, effect.perturbations, strict=True)):
        if is_variance(perturbation):
            continue  # a variance naturally differs from segment to segment
        common = abs(float(step[own[k]]))
        sure = errors[:, k] < TELLING * max(common, effect.tolerance)
        if sure.sum() < FEWEST_SIZES:
            continue
        known, chance = sizes[sure, k], float(np.mean(errors[sure, k] ** 2))
        variance = float(np.var(known, ddof=1))
        scatter = float(np.sqrt(max(variance - chance, 0.0)))
        if variance > BEYOND_CHANCE * chance and scatter > LARGE * common:
            varying[name] = known
    return varying


@dataclass(frozen=True)
class SizeOverTime:
    """Size of one parameter in the parts of flights that show it, with all else as fitted."""

    column: str
    unit: str
    flights: tuple[str, ...]
    """Flight of each part."""
    begin_s: Array
    """(n,) begin of each part, which lasts ``PART_S``."""
    sizes: Array
    errors: Array
    """(n,) standard errors of the sizes."""
    common: float
    """Size that fits all parts together."""


def changing_sizes(
    records: Sequence[Record], model: FilterParameters, parameters: FilterParameters,
    chosen: Sequence[Effect], names: Container[str],
) -> tuple[SizeOverTime, ...]:  # fmt: skip
    """Return the sizes over time of the chosen causes of some ``names``; ``parameters`` include them."""
    traces, white, part, precision = _rows_of(records, model, parameters, chosen)
    step = np.linalg.solve(traces.T @ traces + np.diag(precision + RIDGE), white @ traces)
    left, columns = white - traces @ step, [d.name for d in (*MEAN_PERTURBATIONS, *_moved(chosen))]
    labels, of_row = np.unique(part[:, 1], return_inverse=True)
    flights, begin_s = [records[k].name for k in labels // MOST_PARTS], PART_S * (labels % MOST_PARTS)
    series = []
    for effect, k in ((e, k) for e in chosen if e.name in names for k in range(len(e.perturbations))):
        c = columns.index(effect.columns[k])
        common = fitted_parameter(effect.columns[k]).size_in(parameters) + float(step[c])
        score, known = np.bincount(of_row, traces[:, c] * left), np.bincount(of_row, traces[:, c] ** 2)
        series.append(sizes_over_time(effect, k, parameters, common, flights, begin_s, score, known))
    return tuple(series)


def sizes_over_time(
    effect: Effect, k: int, parameters: FilterParameters, common: float, flights: Sequence[str],
    begin_s: NDArray[Any], score: NDArray[Any], information: NDArray[Any],
) -> SizeOverTime:  # fmt: skip
    """Return the sizes of an effect's column k from the ``score`` and ``information`` (parts,) of parts of
    ``flights`` (parts,) beside the ``common`` size."""
    errors = 1.0 / np.sqrt(np.maximum(information, 1e-300))
    sure = np.flatnonzero(errors < TELLING * max(abs(common), effect.tolerance))
    ends = [common + (score * errors**2 + sign * errors)[sure] for sign in (0.0, 1.0, -1.0)]
    ends.append(np.array([common]))
    sizes, high, low, whole = (
        np.array([effect.in_catalogue_units(k, x, parameters) for x in end]) for end in ends
    )
    unit = CATALOGUE[effect.name].parameter(effect.parameters[k]).unit
    of_flights, errors = tuple(flights[j] for j in sure.tolist()), 0.5 * np.abs(high - low)
    return SizeOverTime(effect.columns[k], unit, of_flights, begin_s[sure], sizes, errors, float(whole[0]))
