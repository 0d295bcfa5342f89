"""Comparison of pictures with the path on which all other instruments agree, as further rows.

The pictures of each ten seconds give a score g and an information H of every error that moves points of the
floor in them, or changes their tones. With H = R'R the rows are R x = R'^-1 g, of unit variance. R holds the
eigenvectors of H with significant eigenvalues.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from slam.core.arrays import Array
from slam.criticism.camera.camera_path import camera_path
from slam.criticism.camera.photometric import PICTURE_PATTERNS
from slam.criticism.camera.reprojection import reprojection_score_along
from slam.criticism.kalman.filter_parameters import CAMERA, POINTS, FilterParameters
from slam.criticism.kalman.perturbations import LikelihoodScore, Perturbation
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import is_variance
from slam.criticism.search.fitted_parameters import with_steps
from slam.criticism.search.information import SEGMENT_S
from slam.criticism.without_commands.likelihood import PATTERNS, Sizes, direction, picture_columns
from slam.criticism.without_commands.whitened_rows import FlightRows, WhitenedRows
from slam.data_quality.finding import Remark

KIND = "pictures"
HEALTHY = {"sonar.datum_m": 0.01, "floor_slope.x": 5e-3, "floor_slope.y": 5e-3}
"""Standard deviations of quantities that differ between healthy flights."""
_PRECISION = [std**-2.0 for std in HEALTHY.values()]
_FAINT = 1e-9
"""Information added on errors that nothing in a segment shows."""
TELLING = 1e-9
"""Least share of the information: a combination of errors with less is dropped."""
CONTRADICTED = 2.0
"""Ratio of residuals to their noise beyond which pictures contradict the path; 1 for healthy flights."""
FEWEST = 6
"""Least number of pictures of a segment."""


def picture_rows(record: Record, parameters: FilterParameters, sizes: Sizes) -> list[WhitenedRows]:
    """Return the rows of a flight's pictures, linear about such ``sizes`` as the parameters can hold.

    ``parameters`` have inflated process noise and lack these errors.
    """
    names = picture_columns()
    perturbations = [direction(name) for name in (*names, *HEALTHY)]
    point = _point(sizes)
    at = np.array([point.get(name, 0.0) for name in names])
    made = []
    for middle_s, seen in _segments(record, with_steps(parameters, point.items()), perturbations):
        information = seen.information + np.diag([_FAINT] * len(names) + _PRECISION)
        over = np.sqrt(_misfit(seen, information))
        root, white = _roots(*_without_healthy(information, seen.score, len(names)))
        off = (white + root @ at) / over
        traces = dict(zip(names, root.T / over, strict=True))
        made.append(WhitenedRows(KIND, np.full(len(off), middle_s), off, traces, float(over), None))
    return made


def _without_healthy(information: Array, score: Array, count: int) -> tuple[Array, Array]:
    """Return information and score of the first ``count`` errors; healthy differences are marginalised."""
    own, rest = slice(0, count), slice(count, None)
    projected = np.linalg.solve(information[rest, rest], information[rest, own]).T
    return information[own, own] - projected @ information[rest, own], score[own] - projected @ score[rest]


def _roots(information: Array, score: Array) -> tuple[Array, Array]:
    """Return R with R'R = H, and R'^-1 g."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
    known, turned = np.linalg.eigh(information / scale[:, None] / scale)
    observed = known > TELLING
    root, turned = np.sqrt(known[observed]), turned[:, observed].T
    return root[:, None] * turned * scale, turned @ (score / scale) / root


def contradiction(rows: FlightRows) -> list[Remark]:
    """Return whether pictures and path disagree by more than all errors together explain."""
    over = [r.noise for flight in rows for r in flight if r.kind == KIND]
    if not over or float(np.median(over)) < CONTRADICTED:
        return []
    by = f"{min(over):.1f} to {max(over):.1f} times their noise"
    text = f"pictures disagree with the path of the other instruments by {by}"
    return [Remark(text, channel="pictures")]


def _point(sizes: Sizes) -> Sizes:
    """Return the sizes that filter parameters can hold: those of no pattern, and no variance below 0."""
    known = [n for n in picture_columns() if n in sizes and n not in PATTERNS]
    return {n: max(sizes[n], 0.0) if is_variance(direction(n)) else sizes[n] for n in known}


def _misfit(seen: LikelihoodScore, information: Array) -> float:
    """Return the ratio of squared residuals to their noise, once all that moves points is fitted. Above 1,
    pictures and path disagree."""
    tones = [*CAMERA[POINTS:], *PICTURE_PATTERNS]
    points = np.array([k for k, name in enumerate((*picture_columns(), *HEALTHY)) if name not in tones])
    score = seen.score[points]
    explained = float(score @ np.linalg.solve(information[np.ix_(points, points)], score))
    return max((seen.chi_square - explained) / seen.rows, 1.0)


def _segments(
    record: Record, parameters: FilterParameters, perturbations: Sequence[Perturbation]
) -> Iterator[tuple[float, LikelihoodScore]]:
    """Yield the middle of each ten seconds with pictures, and the score of these."""
    matches = record.matches
    assert matches is not None
    along = camera_path(record, matches, parameters)
    number = (along.path.times_s // SEGMENT_S).astype(np.int64)
    for k in np.unique(number).tolist():
        begin, end = np.searchsorted(number, [k, k + 1]).tolist()
        if end - begin < FEWEST:
            continue
        seen = reprojection_score_along(matches, parameters, along.part(begin, end), perturbations)
        if seen.rows:
            yield (k + 0.5) * SEGMENT_S, seen
