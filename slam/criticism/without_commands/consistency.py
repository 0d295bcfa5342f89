"""Consistency of a size over time: a size that varies is no constant error of an instrument.

Sizes are compared between segments, and before and after every moment. The greatest difference of the second
sort, in standard deviations, is the sup-Wald statistic of a break at an unknown time (Andrews, 1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

from backend.measurements import GRAVITY_M_S2
from slam.criticism.search.effects import Effect, catalogue_value, is_variance
from slam.criticism.search.information import FisherInformation
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.posterior import is_term
from slam.criticism.without_commands.likelihood import columns_of, fisher_of, segments_of
from slam.criticism.without_commands.whitened_rows import WhitenedRows
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]

FEWEST_STRETCHES = 5
RIDGE = 1e-9
BEYOND_CHANCE = 4.0
"""Mean square of the segments' deviations, in variances of white rows, beyond which a size varies."""
TELLING = 0.5
"""Greatest standard error of a segment's size, as a share of the size, for the segment to count."""
LARGE = 0.5
"""Least scatter beyond chance, as a share of the size."""
LEVEL = ("accel_bias.x", "accel_bias.y")
"""Columns along which an attitude error acts like an error of the accelerometer."""
TRIMMED = 0.15
"""Least share of a parameter's information on either side of the moment."""
ONSET_SEGMENT_S = 5.0
FEWEST_SEGMENTS = 8
CERTAIN_Z = 5.0
"""With 20 parameters the 1 % point of the statistic is 4.2 (Andrews, 1993, table I, by Bonferroni)."""


def disagreements(found: SearchResult) -> list[str]:
    """Describe parameters of the chosen terms that vary between segments by half of themselves."""
    return [words for e in found.chosen if is_term(e) for words in _disagreements(found, e)]


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
        if sure.sum() < FEWEST_STRETCHES:
            continue
        known, chance = sizes[sure, k], float(np.mean(errors[sure, k] ** 2))
        variance = float(np.var(known, ddof=1))
        scatter = float(np.sqrt(max(variance - chance, 0.0)))
        if variance > BEYOND_CHANCE * chance and scatter > LARGE * common:
            varying[name] = known
    return varying


def _disagreements(found: SearchResult, effect: Effect) -> list[str]:
    """Describe the variation of one term between segments."""
    descriptions = []
    for name, sizes in varying_sizes(found, effect).items():
        k = effect.columns.index(name)
        unit = CATALOGUE[effect.name].parameter(effect.parameters[k]).unit
        off_deg = float(np.degrees(np.arctan(np.ptp(sizes) / GRAVITY_M_S2)))
        like = f", like an attitude error of {off_deg:.0f} deg" if name in LEVEL else ""
        least, most = (
            catalogue_value(effect, k, float(x), found.last.parameters, 0.0)
            for x in (sizes.min(), sizes.max())
        )
        descriptions.append(f"{name} is {least:.2g} to {most:.2g} {unit} by segments of 10 s{like}")
    return descriptions


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
            f"{self.column} changes by {self.change:.2g}{'' if unit == '1' else f' {unit}'} at about "
            f"{self.time_s:.0f} s (z = {self.z:.1f})"
        )


def onset(found: SearchResult, rows: Sequence[Sequence[WhitenedRows]]) -> Onset | None:
    """Return the most certain change of a term's parameter within a flight, or None."""
    fisher = fisher_of(rows, columns_of(rows), ONSET_SEGMENT_S)
    begin_s = np.asarray(ONSET_SEGMENT_S * segments_of(rows, ONSET_SEGMENT_S)[0][:, 1])
    changes = [
        change
        for effect in found.last.effects if is_term(effect)
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
    if count < FEWEST_SEGMENTS or whole <= 0.0:
        return 0, 0.0, 0.0
    at, change, greatest = 0, 0.0, 0.0
    for k in range(1, count):
        sides = (slice(0, k), slice(k, count))
        known = [float(information[side].sum()) for side in sides]
        if min(known) < TRIMMED * whole:
            continue
        sizes = [float(score[side].sum()) / n for side, n in zip(sides, known, strict=True)]
        variance = 0.0
        for side, size, n in zip(sides, sizes, known, strict=True):
            off = score[side] - size * information[side]
            variance += max(float(np.sum(off**2)) * count / (count - 2), n) / n**2
        t = abs(sizes[1] - sizes[0]) / np.sqrt(variance + tolerance**2)
        if t > greatest:
            at, change, greatest = k, sizes[1] - sizes[0], t
    z = float(-norm.ppf(max(float(student.sf(greatest, count - 2)), 1e-300)))
    return at, change, z
