"""Least squares over the whitened rows of all comparisons, with the columns of effects.

A column is an error of an instrument or a camera: a term and its parameter, a delay, or a pattern.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from slam.criticism.camera.lens import WARP_TOLERANCE, WARPS
from slam.criticism.camera.photometric import PICTURE_PATTERNS, VARIANCE_PATTERNS
from slam.criticism.kalman.filter_parameters import CAMERA, SQUARES, catalogued
from slam.criticism.kalman.readings import SENSOR
from slam.criticism.search import effects as searched
from slam.criticism.search.thresholds import parameter_cost
from slam.criticism.verdict.held_out import parts_of
from slam.criticism.without_commands.whitened_rows import WhitenedRows
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Sizes = Mapping[str, float]
"""Column -> size."""

LATE = {f"{name}.s": parameter for name, (_, parameter) in searched.LATE.items()}
"""Columns of delays, which are no terms, and their parameters."""
PATTERNS = (*PICTURE_PATTERNS, *WARPS)
"""Patterns of pictures, which are no terms either."""
SIZE = ".size"
"""Suffix of a pattern's column."""
UNMEASURED = ("sonar_temperature.rise", "floor_slope.x", "floor_slope.y", "exposure_variation.gamma")
"""Errors that pictures do not measure: a drifting scale, of which a segment has little; differences between
healthy places; and a variance that resembles another. Varying brightness is reported as that of the gain."""
SEGMENT_S = 10.0
RIDGE = 1e-9
TOLERANCE = {
    **{name: term.tolerance for name, term in CATALOGUE.items()},
    "attitude late": 3e-3, "velocity late": 3e-3,
    "picture brightness ~ time": 2e-2, "picture colour ~ time": 2e-2, "picture contrast ~ time": 5e-2,
    "picture sharpness ~ time": 0.2, "picture brightness ~ height": 5e-2,
    **dict(zip(WARPS, WARP_TOLERANCE.tolist(), strict=True)),
}  # fmt: skip
"""Size of each effect below which there is none (``Term.tolerance``)."""


@dataclass(frozen=True)
class Regression:
    """All n rows of all flights."""

    off: Array
    """(n,) difference of two instruments over its standard deviation."""
    columns: dict[str, Array]
    """Effect and parameter (``gyro_bias.x``) -> (n,) change of ``off`` with it."""
    kind: NDArray[np.str_]
    """(n,) instrument that is compared with the imu."""
    part: Ints
    """(n,) held-out part of a row."""
    cluster: Ints
    """(n,) segment of ten seconds: errors within one may be correlated."""
    flight: Ints
    """(n,) number of the flight."""
    times_s: Array
    """(n,) time within the flight's recording."""
    minutes: Array
    """(n,) the same in minutes, 0 in the flight's middle."""
    by: str
    """Kind of held-out part: ``flight`` or ``segment``."""
    _residuals: dict[tuple[str, ...], Array] = field(default_factory=dict, init=False, repr=False)

    @property
    def wide(self) -> float:
        """Half of a 95 % interval in standard errors, by Student's distribution over the number of
        segments."""
        return float(student.ppf(0.975, max(int(self.cluster.max()), 1)))

    def table(self, effects: Sequence[str]) -> Array:
        """Return the columns (n, columns) of some effects."""
        names = [n for e in effects for n in self.of(e)]
        return np.column_stack([self.columns[n] for n in names]) if names else np.zeros((len(self.off), 0))

    def of(self, effect: str) -> list[str]:
        """Return the names of an effect's columns."""
        return [n for n in self.columns if n.rpartition(".")[0] == effect]

    def effects(self) -> list[str]:
        """Return all effects that the streams can show."""
        return list(dict.fromkeys(n.rpartition(".")[0] for n in self.columns))

    def fit(self, effects: Sequence[str], rows: NDArray[np.bool_] | None = None) -> tuple[Array, Array]:
        """Return sizes (p,) and information (p, p)."""
        own = slice(None) if rows is None else rows
        table = self.table(effects)[own]
        information = table.T @ table
        information[np.diag_indices(len(information))] *= 1.0 + RIDGE
        information[np.diag_indices(len(information))] += 1e-12
        return np.asarray(np.linalg.solve(information, table.T @ self.off[own])), information

    def _residual(self, effects: tuple[str, ...]) -> Array:
        """Return what some effects leave (n,) of the differences. A posterior compares each set with many."""
        if effects not in self._residuals:
            self._residuals[effects] = self.off - self.table(effects) @ self.fit(effects)[0]
        return self._residuals[effects]

    def sizes(self, effects: Sequence[str], rows: NDArray[np.bool_] | None = None) -> Sizes:
        """Return the sizes by column."""
        names = [n for e in effects for n in self.of(e)]
        return dict(zip(names, self.fit(effects, rows)[0].tolist(), strict=True))

    def sizes_by_others(self, effects: Sequence[str]) -> dict[int, Sizes]:
        """Return for each part the sizes fitted on all others."""
        return {part: self.sizes(effects, self.part != part) for part in np.unique(self.part).tolist()}

    def nats(self, effects: Sequence[str]) -> float:
        """Return the nats that effects explain, less the cost of their parameters."""
        size, _ = self.fit(effects)
        explained = float(size @ self.table(effects).T @ self.off)
        return 0.5 * explained - sum(self.cost(e) for e in effects)

    def cost(self, effect: str) -> float:
        """Return the nats that an effect must gain to pay for its parameters."""
        return parameter_cost(len(self.of(effect)))

    def columns_of(self, effects: Sequence[str], effect: str) -> Ints:
        """Return the indices of an effect's columns in the ``table`` of several."""
        begin = sum(len(self.of(e)) for e in effects[: list(effects).index(effect)])
        return np.arange(begin, begin + len(self.of(effect)))

    def covariance(self, effects: Sequence[str], one_by_one: bool = False) -> tuple[Array, Array]:
        """Return sizes and their cluster-robust covariance over segments, no less than that of white rows.

        A square distance of all parameters together by it is about chi-square, as Hotelling's. With
        ``one_by_one`` it is that of the interval of each parameter: Student's over the segments (``wide``),
        however many others are fitted. Source: Bester, Conley and Hansen 2011.
        """
        size, information = self.fit(effects)
        table = self.table(effects)
        left = self.off - table @ size
        scores = np.zeros((int(self.cluster.max()) + 1, len(size)))
        np.add.at(scores, self.cluster, table * left[:, None])
        plain = np.linalg.inv(information)
        count, judged = len(scores), 1 if one_by_one else len(size)
        between = plain @ (scores.T @ scores) @ plain * count / max(count - judged, 1)
        wider = np.sqrt(np.maximum(np.diag(between) / np.diag(plain), 1.0))
        return size, np.asarray(plain * wider[:, None] * wider)

    def z(self, chosen: Sequence[str], effect: str) -> float:
        """Return the z of an effect beside others: the root of its chi-square, with its tolerance added to
        the variance."""
        effects = [*(e for e in chosen if e != effect), effect]
        size, covariance = self.covariance(effects)
        if all(map(is_square, self.of(effect))):
            # The differences between segments are what a variance consists of: none means no variance.
            covariance = np.asarray(np.linalg.inv(self.fit(effects)[1]))
        own = self.columns_of(effects, effect)
        spread = covariance[np.ix_(own, own)] + TOLERANCE.get(effect, 0.0) ** 2 * np.eye(len(own))
        square = float(size[own] @ np.linalg.solve(spread, size[own]))
        return float(np.sqrt(max(square - (len(own) - 1), 0.0)))

    def held_out(self, rest: Sequence[str], effect: str) -> Array:
        """Return the nats that an effect gains on each part, fitted on the others."""
        gains = []
        for part in np.unique(self.part):
            own = self.part == part
            residual = []
            for effects in (list(rest), [*rest, effect]):
                size, _ = self.fit(effects, ~own)
                residual.append(self.off[own] - self.table(effects)[own] @ size)
            gains.append(0.5 * float(np.sum(residual[0] ** 2) - np.sum(residual[1] ** 2)))
        return np.array(gains)

    def lead(self, effects: Sequence[str], others: Sequence[str]) -> float:
        """Return the nats by which some effects explain more than others, weighted by the agreement of
        segments.

        For white rows the log likelihoods differ by m with a variance of 2 m. Where segments scatter by more,
        errors are correlated, and the lead counts proportionally less. Otherwise minutes of one lasting error
        would decide between two effects with the same sensitivity.
        """
        left = [self._residual(tuple(e)) for e in (effects, others)]
        nats = np.bincount(self.cluster, 0.5 * (left[1] ** 2 - left[0] ** 2))
        lead, variance = float(nats.sum()), len(nats) * float(nats.var())
        return lead * min(1.0, 2.0 * abs(lead) / max(variance, 1e-12))


def regression_of(rows: Sequence[Sequence[WhitenedRows]]) -> Regression:
    """Join the rows of each flight's comparisons; held out by flight where there are three, else by part."""
    names = list(dict.fromkeys(n for flight in rows for r in flight for n in r.traces))
    off = np.concatenate([r.off for flight in rows for r in flight])
    columns = {
        n: np.concatenate([r.traces.get(n, np.zeros(len(r.off))) for flight in rows for r in flight])
        for n in names
    }
    kind = np.concatenate([np.full(len(r.off), r.kind) for flight in rows for r in flight])
    flight = np.concatenate([np.full(len(r.off), k) for k, found in enumerate(rows) for r in found])
    segment = np.concatenate([(r.times_s // SEGMENT_S).astype(np.int64) for found in rows for r in found])
    middle_s = [np.mean([r.times_s[[0, -1]] for r in found]) if found else 0.0 for found in rows]
    minutes = np.concatenate(
        [(r.times_s - at) / 60.0 for found, at in zip(rows, middle_s, strict=True) for r in found]
    )
    clusters, cluster = np.unique(np.column_stack([flight, segment]), axis=0, return_inverse=True)
    part, by = parts_of(clusters[:, 0])
    return Regression(
        off=off,
        columns=columns,
        kind=kind,
        part=part[cluster],
        cluster=cluster,
        flight=flight,
        times_s=np.concatenate([r.times_s for found in rows for r in found]),
        minutes=minutes,
        by=by,
    )


def part_of_segments(rows: Sequence[Sequence[WhitenedRows]], data: Regression) -> list[dict[float, int]]:
    """Return for each flight of the ``rows`` of ``data``: number of a segment -> its part."""
    parts, begin = [], 0
    for flight in rows:
        count = sum(len(r.off) for r in flight)
        segment = np.concatenate([r.times_s // SEGMENT_S for r in flight]) if flight else np.zeros(0)
        parts.append(dict(zip(segment.tolist(), data.part[begin : begin + count].tolist(), strict=True)))
        begin += count
    return parts


def picture_effects() -> list[str]:
    """Return every error that pictures may show."""
    terms = [n for n in (*CAMERA, *SENSOR) if n.partition(".")[0] in CATALOGUE and n not in UNMEASURED]
    return [*terms, *LATE, *(name + SIZE for name in PATTERNS)]


def in_catalogue(column: str, size: float) -> float:
    """Return a column's size in the catalogue's unit: for a variance, the standard deviation."""
    if column in CAMERA:
        return catalogued(CAMERA.index(column), size)
    effect, _, parameter = column.rpartition(".")
    return size + CATALOGUE[effect].parameter(parameter).neutral


def is_square(column: str) -> bool:
    """Whether a column is a square, or a variance: its size cannot be negative."""
    if column in CAMERA:
        return CAMERA.index(column) in SQUARES
    return column.removesuffix(SIZE) in VARIANCE_PATTERNS
