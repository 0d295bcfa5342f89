"""Findings in comparisons that no cause explains, in words, and errors that these flights could not show.

They belong to no term: wrong axes, an onset, a delay. Each is reported with its channel, its shape, its time
and its size. The greatest difference before and after a moment is the sup-Wald statistic of a break at an
unknown time (Andrews, 1993).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from slam.core.arrays import Array
from slam.core.flight import Flight
from slam.core.units import spaced
from slam.criticism.search.effects import LATE, Effect, is_variance
from slam.criticism.search.information import FisherInformation
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.consistency import (
    FEWEST_PARTS,
    PART_S,
    SizeOverTime,
    disagreements,
    sizes_over_time,
    varying_sizes,
)
from slam.criticism.verdict.power import NINE_OF_TEN
from slam.criticism.without_commands.likelihood import columns_of, fisher_of, segments_of
from slam.criticism.without_commands.pictures import contradiction
from slam.criticism.without_commands.whitened_rows import FlightRows
from slam.data_quality.axes import wrong_axes
from slam.simulation.terms import CATALOGUE

TRIMMED = 0.15
"""Least share of a parameter's information on either side of the moment."""
CERTAIN_Z = 5.0
"""With 20 parameters the 1 % point of the statistic is 4.2 (Andrews, 1993, table I, by Bonferroni)."""
COULD_NOT = "These flights could not show"


def axes_of(flights: Sequence[Flight]) -> tuple[list[str], list[str]]:
    """Return descriptions of wrong axes of all flights, and of axes that none of them shows."""
    each = [wrong_axes(flight) for flight in flights]
    wrong = in_words([f.name for f in flights], [told for told, _ in each])
    hidden = [set(unknown) for _, unknown in each]
    return wrong, sorted(set.intersection(*hidden)) if hidden else []


def left_over_in_comparisons(found: SearchResult, rows: FlightRows) -> list[str]:
    """Describe what no cause explains in comparisons of instruments."""
    fisher = fisher_of(rows, columns_of(rows), PART_S)
    begin_s = np.asarray(PART_S * segments_of(rows, PART_S)[0][:, 1])
    apart, begun = contradiction(rows), onset(found, fisher, begin_s)
    return [*disagreements(found), *([apart] if apart else []), *([str(begun)] if begun is not None else [])]


def changing_in_comparisons(
    found: SearchResult, rows: FlightRows, flights: Sequence[Flight]
) -> tuple[SizeOverTime, ...]:
    """Return the sizes over time of parameters that vary, or that change at a moment."""
    fisher, labels = fisher_of(rows, columns_of(rows), PART_S), segments_of(rows, PART_S)[0]
    names, begin_s = [flights[k].name for k in labels[:, 0]], np.asarray(PART_S * labels[:, 1])
    begun, series = onset(found, fisher, begin_s), []
    for effect in (e for e in found.last.effects if e.is_term):
        varying = varying_sizes(found, effect) if effect in found.chosen else {}
        beside = [*(e for e in found.chosen if not e.repeats(effect)), effect]
        for k, column in enumerate(effect.columns):
            if column in varying or (begun is not None and column == begun.column):
                c, step = fisher.columns.index(column), found.last.quadratic.maximise(beside).whole
                score, known = (fisher.score - fisher.information @ step)[:, c], fisher.information[:, c, c]
                given = effect, k, found.last.parameters, float(step[c])
                series.append(sizes_over_time(*given, names, begin_s, score, known))
    return tuple(series)


def not_shown(
    found: SearchResult,
    rows: FlightRows,
    axes: Sequence[str],
    shown: Collection[str],
    least_z: float,
) -> list[str]:
    """Return a sentence on the errors that these flights could not show, whatever their size.

    ``axes``: those of which no flight shows whether they are right. ``shown``: terms that have a smallest
    detectable size. Delays show from ``least_z`` standard errors on, in nine of ten cases.
    """
    lines = ["a constant offset of speed or height", *axes]
    lines += [e.name for e in found.last.effects if e.is_term and e.name not in shown]
    for effect in (e for e in found.last.effects if e.name in LATE):
        std = np.hypot(
            float(np.sqrt(found.last.quadratic.maximise([effect]).covariance[0, 0])), effect.tolerance
        )
        lines.append(f"{effect.name} by less than {1e3 * (least_z + NINE_OF_TEN) * std:.0f} ms")
    times_s = np.concatenate([r.times_s for flight in rows for r in flight])
    if float(np.ptp(times_s)) < FEWEST_PARTS * PART_S:
        lines.append("an error that begins within a flight")
    return [f"{COULD_NOT} {', '.join(lines)}."]


def in_words(names: Sequence[str], found: Sequence[Sequence[str]]) -> list[str]:
    """Return the descriptions of each flight with its name, where there are several flights."""
    labels = [f"{name}: " if len(names) > 1 else "" for name in names]
    return [label + words for label, of in zip(labels, found, strict=True) for words in of]


@dataclass(frozen=True)
class Onset:
    """A change of one parameter."""

    column: str
    time_s: float
    change: float
    z: float

    def __str__(self) -> str:
        effect, _, parameter = self.column.rpartition(".")
        unit = CATALOGUE[effect].parameter(parameter).unit
        return (
            f"{self.column} changes by {self.change:.2g}{spaced(unit)} at about "
            f"{self.time_s:.0f} s (z = {self.z:.1f})"
        )


def onset(found: SearchResult, fisher: FisherInformation, begin_s: Array) -> Onset | None:
    """Return the most certain change of a term's parameter within a flight, or None.

    ``fisher`` is the information of short segments, which begin at ``begin_s`` (segments,).
    """
    changes = [
        change
        for effect in found.last.effects if effect.is_term
        for perturbation in effect.perturbations if not is_variance(perturbation)
        for change in _changes(found, fisher, begin_s, effect, perturbation.name) if change.z > CERTAIN_Z
    ]  # fmt: skip
    return max(changes, key=lambda change: change.z, default=None)


def _changes(
    found: SearchResult, fisher: FisherInformation, begin_s: Array, effect: Effect, column: str
) -> list[Onset]:
    """Return the likeliest change of a column in each flight, beside the chosen effects; ``begin_s``
    (segments,) are the times of the segments of ``fisher``."""
    quadratic = found.last.quadratic
    effects = [*(e for e in found.chosen if not e.repeats(effect)), effect]
    step = quadratic.maximise(effects).whole
    rest = quadratic.index([c for e in effects for c in e.columns if c != column])
    # What is left of the column once the others are projected out.
    along = np.zeros(len(step))
    along[quadratic.index([column])] = 1.0
    information = quadratic.information
    along[rest] = -np.linalg.lstsq(information[np.ix_(rest, rest)], information[rest] @ along, rcond=1e-12)[0]
    score = (fisher.score - fisher.information @ step) @ along
    known = (fisher.information @ along) @ along
    onsets = []
    for inside in (fisher.flight == flight for flight in np.unique(fisher.flight)):
        k, change, z = _break(score[inside], known[inside], effect.tolerance)
        onsets.append(Onset(column, float(begin_s[inside][k]), change, z))
    return onsets


def _break(score: Array, information: Array, tolerance: float) -> tuple[int, float, float]:
    """Return the first segment after the likeliest break, the change there, and its z.

    The variance is that of the segments about the two sizes, no less than that of white rows; the z is
    Student's, as a normal one.
    """
    count, whole = len(score), float(information.sum())
    if count < FEWEST_PARTS or whole <= 0.0:
        return 0, 0.0, 0.0
    at, change, greatest = 0, 0.0, 0.0
    for k in range(1, count):
        sides = [(score[side], information[side]) for side in (slice(0, k), slice(k, count))]
        known = [float(n.sum()) for _, n in sides]
        if min(known) < TRIMMED * whole:
            continue
        sizes = [float(s.sum()) / n for (s, _), n in zip(sides, known, strict=True)]
        squares = [float(np.sum((s - x * n) ** 2)) for (s, n), x in zip(sides, sizes, strict=True)]
        variance = sum(max(q * count / (count - 2), n) / n**2 for q, n in zip(squares, known, strict=True))
        t = abs(sizes[1] - sizes[0]) / np.sqrt(variance + tolerance**2)
        if t > greatest:
            at, change, greatest = k, sizes[1] - sizes[0], t
    z = float(-norm.ppf(max(float(student.sf(greatest, count - 2)), 1e-300)))
    return at, change, z
