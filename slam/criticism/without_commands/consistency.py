"""Consistency of a size over time: a size that varies is no constant error of an instrument.

Sizes are compared between segments, and before and after every moment. The greatest difference of the second
sort, in standard deviations, is the sup-Wald statistic of a break at an unknown time (Andrews, 1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

from backend.measurements import GRAVITY_M_S2
from slam.criticism.without_commands.regression import TOLERANCE, Regression, in_catalogue, is_square
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]

FEWEST_STRETCHES = 5
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


def disagreements(data: Regression, chosen: Sequence[str]) -> list[str]:
    """Describe parameters of the chosen terms that vary between segments by half of themselves."""
    return [
        descriptions
        for effect in chosen
        if effect in CATALOGUE
        for descriptions in _disagreements(data, chosen, effect)
    ]


def varying_sizes(data: Regression, chosen: Sequence[str], effect: str) -> dict[str, Array]:
    """Return column -> (segments,) sizes, of the parameters of a chosen term that vary between segments by
    half of themselves, with all other terms at their common sizes."""
    size, _ = data.fit(chosen)
    own = data.columns_of(chosen, effect)
    rest = np.delete(np.arange(len(size)), own)
    alone = replace(data, off=data.off - data.table(chosen)[:, rest] @ size[rest])
    fits = [alone.fit([effect], data.cluster == k) for k in np.unique(data.cluster)]
    sizes = np.array([fit for fit, _ in fits])
    errors = np.sqrt([np.diag(np.linalg.inv(information)) for _, information in fits])
    varying = {}
    for k, name in enumerate(data.of(effect)):
        if is_square(name):
            continue  # a variance naturally differs from segment to segment
        common = abs(float(size[own[k]]))
        sure = errors[:, k] < TELLING * max(common, TOLERANCE[effect])
        if sure.sum() < FEWEST_STRETCHES:
            continue
        found, chance = sizes[sure, k], float(np.mean(errors[sure, k] ** 2))
        variance = float(np.var(found, ddof=1))
        scatter = float(np.sqrt(max(variance - chance, 0.0)))
        if variance > BEYOND_CHANCE * chance and scatter > LARGE * common:
            varying[name] = found
    return varying


def _disagreements(data: Regression, chosen: Sequence[str], effect: str) -> list[str]:
    """Describe the variation of one term between segments."""
    descriptions = []
    for name, found in varying_sizes(data, chosen, effect).items():
        unit = CATALOGUE[effect].parameter(name.rpartition(".")[2]).unit
        off_deg = float(np.degrees(np.arctan(np.ptp(found) / GRAVITY_M_S2)))
        like = f", like an attitude error of {off_deg:.0f} deg" if name in LEVEL else ""
        least, most = (in_catalogue(name, float(x)) for x in (found.min(), found.max()))
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


def onset(data: Regression, chosen: Sequence[str]) -> Onset | None:
    """Return the most certain change of a term's parameter within a flight, or None."""
    found = [
        change
        for effect in data.effects() if effect in CATALOGUE
        for column in data.of(effect) if not is_square(column)
        if (change := _greatest(data, chosen, effect, column)) is not None
    ]  # fmt: skip
    return max(found, key=lambda change: change.z, default=None)


def _greatest(data: Regression, chosen: Sequence[str], effect: str, column: str) -> Onset | None:
    effects = [*(e for e in chosen if e != effect), effect]
    table = data.table(effects)
    names = [n for e in effects for n in data.of(e)]
    own = names.index(column)
    rest = np.delete(table, own, axis=1)
    left = data.off - table @ data.fit(effects)[0]
    trace = table[:, own]
    if rest.shape[1]:
        trace = trace - rest @ np.linalg.lstsq(rest, trace, rcond=1e-9)[0]
    best: Onset | None = None
    for flight in np.unique(data.flight):
        inside = data.flight == flight
        _, segment = np.unique(data.times_s[inside] // ONSET_SEGMENT_S, return_inverse=True)
        score = np.bincount(segment, (trace * left)[inside]).astype(np.float64)
        information = np.bincount(segment, trace[inside] ** 2).astype(np.float64)
        k, change, z = _break(score, information, TOLERANCE[effect])
        if z > CERTAIN_Z and (best is None or z > best.z):
            best = Onset(column, float(data.times_s[inside][segment == k].min()), change, z)
    return best


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
