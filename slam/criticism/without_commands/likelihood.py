"""Likelihood of the whitened rows of all comparisons, in the errors of instruments and cameras.

It is the same quadratic function as that of flights with commands. Its segments are clusters of ten seconds,
within which errors may be correlated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from slam.core.arrays import Array, Ints
from slam.criticism.camera.lens import WARP_TOLERANCE, WARPS
from slam.criticism.camera.photometric import PICTURE_PATTERNS
from slam.criticism.kalman.filter_parameters import CAMERA, FilterParameters
from slam.criticism.kalman.perturbations import Perturbation
from slam.criticism.kalman.readings import SENSOR
from slam.criticism.search.effects import LATE, Effect, is_variance
from slam.criticism.search.expansion import LikelihoodExpansion
from slam.criticism.search.fitted_parameters import fitted_parameter
from slam.criticism.search.information import SEGMENT_S, FisherInformation
from slam.criticism.search.quadratic_likelihood import quadratic_likelihood
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.held_out import parts_of
from slam.criticism.without_commands.whitened_rows import FlightRows
from slam.simulation.terms import CATALOGUE

Sizes = Mapping[str, float]
"""Column -> size."""

DELAYS = {parameter: name for name, (_, parameter) in LATE.items()}
"""Columns of delays, which are no terms, and their names."""
PATTERNS = (*PICTURE_PATTERNS, *WARPS)
"""Patterns of pictures, which are no terms either."""
IN_TIME = " ~ time"
"""Suffix of an error that grows with time."""
UNMEASURED = ("sonar_temperature.rise", "floor_slope.x", "floor_slope.y", "exposure_variation.gamma")
"""Errors that pictures do not measure: a drifting scale, of which a segment has little; differences between
healthy places; and a variance that resembles another. Varying brightness is reported as that of the gain."""
TOLERANCE = {
    **{name: term.tolerance for name, term in CATALOGUE.items()},
    "attitude late": 3e-3, "velocity late": 3e-3,
    "picture brightness ~ time": 2e-2, "picture colour ~ time": 2e-2, "picture contrast ~ time": 5e-2,
    "picture sharpness ~ time": 0.2, "picture brightness ~ height": 5e-2,
    **dict(zip(WARPS, WARP_TOLERANCE.tolist(), strict=True)),
}  # fmt: skip
"""Size of each effect below which there is none (``Term.tolerance``)."""


def picture_columns() -> list[str]:
    """Return the columns of every error that pictures may show."""
    terms = [n for n in (*CAMERA, *SENSOR) if n.partition(".")[0] in CATALOGUE and n not in UNMEASURED]
    return [*terms, *DELAYS, *PATTERNS]


def direction(column: str) -> Perturbation:
    """Return the perturbation of a column."""
    if column in PATTERNS:
        return Perturbation(column, "picture", PATTERNS.index(column))
    return fitted_parameter(column).perturbation


def columns_of(rows: FlightRows) -> list[str]:
    """Return the columns that some of the rows have."""
    return list(dict.fromkeys(n for flight in rows for r in flight for n in r.traces))


def table_of(rows: FlightRows, columns: Sequence[str]) -> Array:
    """Return (rows, columns) the change of all rows with each column."""
    every = [r for flight in rows for r in flight]
    table = np.zeros((sum(len(r.off) for r in every), len(columns)))
    for k, name in enumerate(columns):
        table[:, k] = np.concatenate([r.traces.get(name, np.zeros(len(r.off))) for r in every])
    return table


def segments_of(rows: FlightRows, segment_s: float) -> tuple[Ints, Ints]:
    """Return (segments, 2) flight and number of each segment, and (rows,) the segment of each row."""
    of_row = [
        np.column_stack([np.full(len(r.off), k), (r.times_s // segment_s).astype(np.int64)])
        for k, flight in enumerate(rows)
        for r in flight
    ]
    labels, segment = np.unique(np.concatenate(of_row), axis=0, return_inverse=True)
    return labels, segment


def fisher_of(rows: FlightRows, columns: Sequence[str], segment_s: float = SEGMENT_S) -> FisherInformation:
    """Return score and information of the rows' columns, and of each once more as it grows with time."""
    labels, segment = segments_of(rows, segment_s)
    off = np.concatenate([r.off for flight in rows for r in flight])
    table = table_of(rows, columns)
    table = np.column_stack([table, table * _minutes(rows)[:, None]])
    names = (*columns, *(name + IN_TIME for name in columns))
    return FisherInformation.of_rows(names, table, off, segment, labels[:, 0])


def _minutes(rows: FlightRows) -> Array:
    """Return (rows,) the time in minutes, 0 in the middle of each flight."""
    middle_s = [np.mean([r.times_s[[0, -1]] for r in found]) if found else 0.0 for found in rows]
    each = zip(rows, middle_s, strict=True)
    return np.concatenate([(r.times_s - at) / 60.0 for found, at in each for r in found])


def likelihood_of(rows: FlightRows, parameters: FilterParameters) -> SearchResult:
    """Return the likelihood of the rows with every effect, before any is chosen."""
    columns = columns_of(rows)
    fisher = fisher_of(rows, columns)
    effects = _effects(columns)
    expansion = LikelihoodExpansion(
        parameters=parameters,
        fisher=fisher,
        quadratic=quadratic_likelihood(fisher, parameters, parameters, {}, (), clustered=True),
        effects=effects,
        patterns=tuple(_growing(e) for e in effects if e.is_term),
    )
    return SearchResult(model=parameters, first=expansion, last=expansion, chosen=())


def _effects(columns: Sequence[str]) -> tuple[Effect, ...]:
    """Return the effects with some columns: terms, delays and patterns of pictures."""
    of: dict[str, list[str]] = {}
    for column in columns:
        of.setdefault(DELAYS.get(column) or column.rpartition(".")[0] or column, []).append(column)
    return tuple(
        Effect(
            name,
            tuple(map(direction, own)),
            parameters=tuple(c.rpartition(".")[2] for c in own) if name in CATALOGUE else (),
            positive=all(is_variance(direction(c)) for c in own),
            tolerance=TOLERANCE.get(name, 0.0),
        )
        for name, own in of.items()
    )


def _growing(effect: Effect) -> Effect:
    """Return the error of an effect as it grows with time."""
    growing = (Perturbation(d.name + IN_TIME, "channel", signal="time") for d in effect.perturbations)
    return Effect(effect.name + IN_TIME, tuple(growing))


def sizes_by_others(found: SearchResult, rows: FlightRows) -> list[dict[float, Sizes]]:
    """Return for each flight: number of a segment -> sizes of the chosen terms by all other parts."""
    part, _ = parts_of(found.last.fisher.flight)
    terms = [e.name for e in found.chosen if e.is_term]
    of_part = {k: found.last.over(part != k).sizes(found.chosen) for k in np.unique(part).tolist()}
    sizes: list[dict[float, Sizes]] = [{} for _ in rows]
    for (flight, number), k in zip(segments_of(rows, SEGMENT_S)[0].tolist(), part.tolist(), strict=True):
        sizes[flight][number] = {c: x for c, x in of_part[k].items() if c.rpartition(".")[0] in terms}
    return sizes
