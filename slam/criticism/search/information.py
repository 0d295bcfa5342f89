"""Fisher information and score of the flights: sums of products of innovations and sensitivities.

A column is a perturbation, which moves the mean of the innovations, or a change of the process noise, which
moves their variance and, through the gains, their mean. Let e be the whitened innovation, a the sensitivity
of the mean and l the change of the logarithm of the variance. The score is sum(a e + (e^2 - 1) l / 2). The
information is sum(a a' + l l' / 2), a Gaussian likelihood to second order. Tails heavier than Gaussian leave
the first part as it is. The second is weighted down by the true variance of e^2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from slam.criticism.camera.reprojection import reprojection_score
from slam.criticism.kalman.filter import USED
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import FilterPass, Run, whole
from slam.criticism.kalman.perturbations import Perturbation, Signal
from slam.criticism.kalman.readings import CHANNEL_AT, CHANNELS
from slam.criticism.kalman.record import Record
from slam.criticism.threads import in_threads

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

CUT = 9.0
"""Limit of e^2 in the variance's score: one outlier is not a change of variance."""
SEGMENT_S = 10.0
ENOUGH_S = 200.0
PARTED = 0.1


@dataclass(frozen=True)
class NoiseChange:
    """A change of the process noise, as the difference of two runs of the filter."""

    name: str
    apply: Callable[[FilterParameters], FilterParameters]
    step: float
    everywhere: bool = True
    """Whether it is computed for all flights. If not, only for the first ones of ``ENOUGH_S`` together, as it
    shows in all alike."""


def gain_column(name: str) -> str:
    """Return the name of the column of a noise change's effect on the mean alone: the trust that the filter's
    gains express."""
    return f"weight of {name}"


@dataclass(frozen=True)
class FisherInformation:
    """Score and Fisher information of all columns, for each segment of the flights."""

    columns: tuple[str, ...]
    flight: NDArray[np.int64]
    """(segments,) number of the flight."""
    information: Array
    """(segments, p, p)."""
    score: Array
    """(segments, p)."""
    log_likelihood: Array
    """(segments,)."""
    passes: tuple[FilterPass, ...]
    """Run of each flight under the parameters themselves."""
    readings: tuple[int, ...]
    """Number of segments of readings, for each flight; one more holds its pictures."""


class _Changed(NamedTuple):
    """Derivatives of the innovations by each noise change: (used + 1, changes), 0 in the last row."""

    row: Ints
    """(events, 6) row of each reading; -1, the last, where the plain run did not use it."""
    mean: Array
    log_variance: Array


class _VarianceWeight(NamedTuple):
    """Weight of squared innovations e^2, cut at ``CUT``, as evidence of the variance: (channels,)."""

    share: Array
    """2 over the variance of e^2, at most 1: less where tails are heavy."""
    expected: Array
    """Mean of e^2 of a Gaussian that is cut likewise, so that outliers do not count as noise."""


def fisher_information(
    records: Sequence[Record],
    parameters: FilterParameters,
    perturbations: Sequence[Perturbation],
    changes: Sequence[NoiseChange],
    signals: Sequence[dict[str, Signal]] | None = None,
    plain: Sequence[FilterPass] = (),
    gain_corrected: Sequence[str] = (),
) -> FisherInformation:
    """Run the filter over the flights, once with all perturbations and once for each noise change.

    ``plain`` are runs under ``parameters``, where they are known already. Each change in ``weighed`` adds
    one column, named by ``gain_column``: its effect on the mean.
    """
    if changes and not plain:
        plain = in_threads(lambda record: whole(record, parameters), records)
    changed_parameters = [c.apply(parameters) for c in changes]
    before_s = np.cumsum([0.0, *(r.duration_s for r in records)])
    tried = [(k, c) for k in range(len(records)) for c in range(len(changes))
             if changes[c].everywhere or before_s[k] < ENOUGH_S]  # fmt: skip
    runs = in_threads(lambda at: whole(records[at[0]], changed_parameters[at[1]]), tried)
    other = dict(zip(tried, runs, strict=True))
    weight = _variance_weight(records, plain)
    steps = np.array([c.step for c in changes])
    apart = np.array([k for k, c in enumerate(changes) if c.name in gain_corrected], dtype=np.int64)

    def one(k: int) -> tuple[list[_Summed], FilterPass]:
        beside = [other.get((k, c), plain[k]) for c in range(len(changes))]
        changed = _difference(plain[k] if beside else None, beside, steps, len(records[k].times_s))
        run = Run(records[k], parameters, perturbations, signals[k] if signals is not None else None)
        rows = list(_segment_terms(records[k], run, changed, apart, weight))
        return rows + _sighted(records[k], parameters, perturbations, len(changes) + len(apart)), run.passed()

    parts, passes = zip(*in_threads(one, range(len(records))), strict=True)
    flat = [part for flight in parts for part in flight]
    return FisherInformation(
        columns=(
            *(d.name for d in perturbations),
            *(c.name for c in changes),
            *map(gain_column, gain_corrected),
        ),
        flight=np.repeat(np.arange(len(records)), [len(flight) for flight in parts]),
        information=np.array([information for information, _, _ in flat]),
        score=np.array([score for _, score, _ in flat]),
        log_likelihood=np.array([nats for _, _, nats in flat]),
        passes=passes,
        readings=tuple(
            len(flight) - (r.matches is not None) for flight, r in zip(parts, records, strict=True)
        ),
    )


_Summed: TypeAlias = tuple[Array, Array, float]
"""Information (p, p), score (p,) and log likelihood of a segment."""


def _sighted(
    record: Record, parameters: FilterParameters, perturbations: Sequence[Perturbation], changes: int
) -> list[_Summed]:
    """Return the pictures as one more segment: given the readings they are independent of all innovations."""
    if record.matches is None:
        return []
    seen, p = (
        reprojection_score(record, record.matches, parameters, perturbations),
        len(perturbations) + changes,
    )
    information, score = np.zeros((p, p)), np.zeros(p)
    information[: len(perturbations), : len(perturbations)] = seen.information
    score[: len(perturbations)] = seen.score
    return [(information, score, seen.log_likelihood)]


def _segment_terms(
    record: Record, run: Run, changed: _Changed, apart: Ints, weight: _VarianceWeight
) -> Iterator[_Summed]:
    """Yield information, score and log likelihood of each segment of a flight."""
    for rows in run.segments(SEGMENT_S):
        column = rows.channels - CHANNEL_AT[record.kinds[rows.events], 0]
        own = changed.row[rows.events, column]
        shifted, widened = changed.mean[own], changed.log_variance[own]
        d, end = rows.sensitivity.shape[1], rows.sensitivity.shape[1] + widened.shape[-1]
        traces = np.hstack([rows.sensitivity, shifted, shifted[:, apart]])
        spread = widened * weight.share[rows.channels, None]
        score = rows.white @ traces
        information = traces.T @ traces
        excess = np.minimum(rows.white**2, CUT) - weight.expected[rows.channels]
        score[d:end] += 0.5 * (excess * weight.share[rows.channels]) @ widened
        information[d:end, d:end] += 0.5 * spread.T @ widened
        yield information, score, run.passed(rows.begin, rows.end).log_likelihood


def _difference(
    plain: FilterPass | None, others: Sequence[FilterPass], steps: Array, events: int
) -> _Changed:
    """Return the differences of other runs from the plain one; 0 where a reading was not used in both."""
    row = np.full((events, 6), -1, dtype=np.int64)
    if plain is None:
        return _Changed(row, np.zeros((1, 0)), np.zeros((1, 0)))
    used = np.flatnonzero(plain.status.ravel() == USED)
    row.ravel()[used] = np.arange(len(used))
    white, log_variance = plain.white.ravel()[used], plain.log_variance.ravel()[used]
    near = PARTED * (1.0 + np.abs(white))
    moved, widened = (np.zeros((len(used) + 1, len(others))) for _ in range(2))
    for k, other in enumerate(others):
        beside = other.white.ravel()[used]
        # Where one run uses an outlier that the other rejects, they differ for good, and the slope is
        # meaningless.
        both = (other.status.ravel()[used] == USED) & (np.abs(white - beside) < near)
        wider = np.where(both, other.log_variance.ravel()[used] - log_variance, 0.0)
        moved[:-1, k] = np.where(both, white - beside * np.exp(0.5 * wider), 0.0) / steps[k]
        widened[:-1, k] = wider / steps[k]
    return _Changed(row, moved, widened)


def _variance_weight(records: Sequence[Record], plain: Sequence[FilterPass]) -> _VarianceWeight:
    """Return the weights from the plain runs; without runs, those of a Gaussian."""
    weight = np.ones(len(CHANNELS))
    mean = np.full(len(CHANNELS), _CUT_MEAN)
    squares: list[list[Array]] = [[] for _ in CHANNELS]
    for record, run in zip(records, plain, strict=False):
        events, column = np.nonzero(run.status == USED)
        channel = CHANNEL_AT[record.kinds[events], column]
        cut = np.minimum(run.white[events, column] ** 2, CUT)
        for k in np.unique(channel):
            squares[k].append(cut[channel == k])
    for k, found in enumerate(squares):
        if found:
            weight[k] = 1.0 / max(float(np.var(np.concatenate(found))) / 2.0, 1.0)
    return _VarianceWeight(weight, mean)


def _cut_mean() -> float:
    """Return E[min(e^2, CUT)] of a standard normal e."""
    from math import erf, exp, pi, sqrt

    c = sqrt(CUT)
    inside = erf(c / sqrt(2.0)) - 2.0 * c * exp(-CUT / 2.0) / sqrt(2.0 * pi)
    return inside + CUT * (1.0 - erf(c / sqrt(2.0)))


_CUT_MEAN = _cut_mean()
