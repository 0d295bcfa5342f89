"""Likelihood of the whitened rows of all comparisons, in the errors of instruments and cameras.

It is the same quadratic function as that of flights with commands. Its segments are clusters of ten seconds,
within which errors may be correlated. Pictures are further rows, beside the path of all other instruments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from slam.core.arrays import Array
from slam.criticism.camera.camera_path import camera_path
from slam.criticism.camera.lens import WARP_TOLERANCE, WARPS
from slam.criticism.camera.photometric import PICTURE_PATTERNS
from slam.criticism.camera.reprojection import reprojection_score
from slam.criticism.kalman.filter_parameters import CAMERA, POINTS, FilterParameters
from slam.criticism.kalman.kernel_inputs import Perturbation
from slam.criticism.kalman.readings import SENSOR
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import LATE, Effect, is_variance
from slam.criticism.search.expansion import LikelihoodExpansion
from slam.criticism.search.fitted_parameters import fitted_parameter, with_steps
from slam.criticism.search.information import SEGMENT_S, FisherInformation
from slam.criticism.search.search import SearchResult
from slam.data_quality.comparison_derivatives import SMOOTHING
from slam.data_quality.inertial_comparison import segment_numbers
from slam.data_quality.whitened_rows import (
    PICTURES,
    FlightRows,
    WhitenedRows,
    columns_of,
    segments_of,
    table_of,
)
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
    "attitude smoothed": 4e-4, "velocity smoothed": 4e-4,
    "picture brightness ~ time": 2e-2, "picture colour ~ time": 2e-2, "picture contrast ~ time": 5e-2,
    "picture sharpness ~ time": 0.2, "picture brightness ~ height": 5e-2,
    **dict(zip(WARPS, WARP_TOLERANCE.tolist(), strict=True)),
}  # fmt: skip
"""Size of each effect below which there is none (``Term.tolerance``)."""


def direction(column: str) -> Perturbation:
    """Return the perturbation of a column."""
    if column in PATTERNS:
        return Perturbation(column, "picture", PATTERNS.index(column))
    if column.endswith(SMOOTHING):
        return Perturbation(column, "channel")
    return fitted_parameter(column).perturbation


def fisher_of(
    rows: FlightRows, segment_s: float = SEGMENT_S, before_s: float = 0.0
) -> tuple[FisherInformation, Array]:
    """Return score and information of the rows' columns, and of each once more as it grows with time; and
    (segments,) the begin of each segment in s."""
    columns, (labels, begin_s, segment) = columns_of(rows), segments_of(rows, segment_s, before_s)
    off = np.concatenate([r.off for flight in rows for r in flight])
    table = table_of(rows, columns)
    # The time in minutes, 0 in the middle of each flight.
    middle_s = [np.mean([r.times_s[[0, -1]] for r in found]) if found else 0.0 for found in rows]
    each = zip(rows, middle_s, strict=True)
    minutes = np.concatenate([(r.times_s - at) / 60.0 for found, at in each for r in found])
    table = np.column_stack([table, table * minutes[:, None]])
    names = (*columns, *(name + IN_TIME for name in columns))
    return FisherInformation.of_rows(names, table, off, segment, labels[:, 0]), begin_s


def likelihood_of(rows: FlightRows, parameters: FilterParameters) -> SearchResult:
    """Return the likelihood of the rows with every effect, before any is chosen."""
    effects = _effects(columns_of(rows))
    growing = {e: [Perturbation(d.name + IN_TIME, "channel", signal="time") for d in e.perturbations]
               for e in effects if e.is_term}  # fmt: skip
    (fisher, _), (shifted, _) = fisher_of(rows), fisher_of(rows, before_s=0.5 * SEGMENT_S)
    fisher = replace(fisher, shifted=shifted)
    expansion = LikelihoodExpansion(
        fisher=fisher, parameters=parameters, model=parameters, nuisances=(), clustered=True, effects=effects,
        patterns=tuple(Effect(e.name + IN_TIME, tuple(of)) for e, of in growing.items()),
    )  # fmt: skip
    return SearchResult(model=parameters, first=expansion, last=expansion, chosen=())


def _effects(columns: Sequence[str]) -> tuple[Effect, ...]:
    """Return the effects with some columns: terms, delays and patterns of pictures."""
    of: dict[str, list[str]] = {}
    for column in columns:
        of.setdefault(DELAYS.get(column) or column.rpartition(".")[0] or column, []).append(column)
    effects = []
    for name, own in of.items():
        parameters = tuple(c.rpartition(".")[2] for c in own) if name in CATALOGUE else ()
        moved, least = tuple(map(direction, own)), TOLERANCE.get(name, 0.0)
        positive = all(map(is_variance, moved)) or name.endswith(SMOOTHING)
        effects.append(Effect(name, moved, parameters=parameters, positive=positive, tolerance=least))
    return tuple(effects)


USUAL_STD = {"sonar.datum_m": 0.01, "floor_slope.x": 5e-3, "floor_slope.y": 5e-3}
"""Standard deviations of quantities that differ between healthy flights."""
_PRIOR = 1e-9
"""Information added on errors that nothing in a segment shows."""
LEAST_INFORMATION = 1e-9
"""Least share of the information: a combination of errors with less is dropped."""
FEWEST_PICTURES = 6
"""Least number of pictures of a segment."""
PICTURE_COLUMNS = (
    *(n for n in (*CAMERA, *SENSOR) if n.partition(".")[0] in CATALOGUE and n not in UNMEASURED),
    *DELAYS, *PATTERNS,
)  # fmt: skip
"""Columns of every error that pictures may show."""
_JUDGED = (*PICTURE_COLUMNS, *USUAL_STD)


def picture_rows(
    record: Record, parameters: FilterParameters, sizes: Sizes, begin_s: float
) -> list[WhitenedRows]:
    """Return the rows of a flight's pictures, linear about such ``sizes`` as the parameters can hold.

    The pictures of each ten seconds from ``begin_s`` give a score g and an information H of every error that
    moves points of the floor in them, or changes their tones. With H = R'R the rows are R x = R'^-1 g, of
    unit variance. ``parameters`` have inflated process noise and lack these errors.
    """
    matches, count = record.matches, len(PICTURE_COLUMNS)
    assert matches is not None
    # Parameters hold no pattern, and no variance below 0.
    point = {n: sizes[n] for n in PICTURE_COLUMNS if n in sizes and n not in PATTERNS}
    point = {n: max(size, 0.0) if is_variance(direction(n)) else size for n, size in point.items()}
    at = np.array([point.get(name, 0.0) for name in PICTURE_COLUMNS])
    parameters = with_steps(parameters, point.items())
    along, perturbations = camera_path(record, matches, parameters), [*map(direction, _JUDGED)]
    points = np.array([k for k, n in enumerate(_JUDGED) if n not in (*CAMERA[POINTS:], *PICTURE_PATTERNS)])
    number, made = segment_numbers(along.times_s, begin_s, SEGMENT_S), []
    for k in np.unique(number).tolist():
        begin, end = np.searchsorted(number, [k, k + 1]).tolist()
        if end - begin < FEWEST_PICTURES:
            continue
        seen = reprojection_score(record, matches, parameters, perturbations, along.part(begin, end))
        if not seen.rows:
            continue
        information = seen.information + np.diag([_PRIOR] * count + [std**-2.0 for std in USUAL_STD.values()])
        # The ratio of squared residuals to their noise, once all that moves points is fitted.
        score, among = seen.score[points], information[np.ix_(points, points)]
        explained = float(score @ np.linalg.solve(among, score))
        over = np.sqrt(max((seen.chi_square - explained) / seen.rows, 1.0))
        # Healthy differences are marginalised.
        own, rest = slice(0, count), slice(count, None)
        projected = np.linalg.solve(information[rest, rest], information[rest, own]).T
        own_score = seen.score[own] - projected @ seen.score[rest]
        root, white = _roots(information[own, own] - projected @ information[rest, own], own_score)
        off, traces = (white + root @ at) / over, dict(zip(PICTURE_COLUMNS, root.T / over, strict=True))
        times_s = np.full(len(off), begin_s + (k + 0.5) * SEGMENT_S)
        made.append(WhitenedRows(PICTURES, times_s, off, traces, float(over), None))
    return made


def _roots(information: Array, score: Array) -> tuple[Array, Array]:
    """Return R with R'R = H, and R'^-1 g; R holds the eigenvectors of H with significant eigenvalues."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
    known, turned = np.linalg.eigh(information / scale[:, None] / scale)
    observed = known > LEAST_INFORMATION
    root, turned = np.sqrt(known[observed]), turned[:, observed].T
    return root[:, None] * turned * scale, turned @ (score / scale) / root
