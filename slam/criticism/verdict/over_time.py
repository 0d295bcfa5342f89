"""Size of a parameter over time: in each part of the flights, and before and after a moment.

The greatest difference before and after a moment is the sup-Wald statistic of a break at an unknown time
(Andrews, 1993). It and the scatter of the parts find different things: an attitude error that comes and goes
has no moment, and a step by less than half of the size is none of its scatter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from backend.measurements import GRAVITY_M_S2
from slam.core.arrays import Array
from slam.criticism.finding import Onset, VaryingSize
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.search.effects import Effect, is_variance
from slam.criticism.search.information import FisherInformation
from slam.criticism.search.search import SearchResult
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
RIDGE = 1e-9
TRIMMED = 0.15
"""Least share of a parameter's information on either side of the moment of a change."""
CERTAIN_Z = 5.0
"""Least z of a change. With 20 parameters the 1 % point of the statistic is 4.2 (Andrews, 1993, table I, by
Bonferroni)."""


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
        """Whether it varies between the parts by more than chance, and by half of itself.

        Where instruments are compared with each other, errors are correlated, and small differences are
        significant. A variance naturally differs from part to part.
        """
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
    """Name of each flight."""
    begin_s: Array
    """(parts,)."""
    part_s: float = PART_S

    def sizes_over_time(
        self, effect: Effect, step: Array, parameters: FilterParameters, held: Array | float = 0.0
    ) -> list[SizeOverTime]:
        """Return the sizes of each column of an effect, fitted together to each part beside a ``step``
        (columns,) of all else from ``parameters``, in which its sizes are ``held``."""
        own = np.array([self.fisher.columns.index(d.name) for d in effect.perturbations], dtype=np.int64)
        information = self.fisher.information[:, own[:, None], own]
        information = information * (1.0 + RIDGE * np.eye(len(own))) + 1e-12 * np.eye(len(own))
        moved = np.linalg.solve(information, self.fisher.left_at(step)[:, own, None])[:, :, 0]
        errors = np.sqrt(np.diagonal(np.linalg.inv(information), axis1=1, axis2=2))
        series = []
        for k, common in enumerate((step[own] + held).tolist()):
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
    quadratic, fisher, column = found.last.quadratic, parts.fisher, effect.columns[k]
    parameter, onsets = CATALOGUE[effect.name].parameter(effect.parameters[k]), []
    effects = [*(e for e in found.chosen if not e.repeats(effect)), effect]
    step = quadratic.maximise(effects).whole
    rest = quadratic.index([c for e in effects for c in e.columns if c != column])
    # What is left of the column once the others are projected out.
    along = np.zeros(len(step))
    along[quadratic.index([column])] = 1.0
    information = quadratic.information
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
    """Return the first segment after the likeliest break, the change there, and its z.

    The variance is that of the segments about the two sizes, no less than that of white rows; the z is
    Student's, as a normal one.
    """
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
