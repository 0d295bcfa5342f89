"""Fisher information and score of the flights: sums of products of innovations and sensitivities.

A column is a perturbation, which moves the mean of the innovations, or a change of the process noise, which
moves their variance and, through the gains, their mean. Let e be the whitened innovation, a the sensitivity
of the mean and l the change of the logarithm of the variance. The score is sum(a e + (e^2 - 1) l / 2). The
information is sum(a a' + l l' / 2), a Gaussian likelihood to second order. Tails heavier than Gaussian leave
the first part as it is. The second is weighted down by the true variance of e^2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from frontend.cores import in_threads
from slam.core.arrays import Array, Ints, Mask
from slam.criticism.camera.reprojection import reprojection_score
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import FilterPass, Run, segment_bounds, used_innovations, whole
from slam.criticism.kalman.kernel_inputs import LikelihoodScore
from slam.criticism.kalman.readings import CHANNELS
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import Effect, signals_of
from slam.criticism.search.fitted_parameters import (
    MEAN_PERTURBATIONS,
    NOISE_NUISANCES,
    FittedParameter,
    gain_column,
)

CUT = 9.0
"""Limit of e^2 in the variance's score: one outlier is not a change of variance."""
CUT_MEAN = float(chi2.cdf(CUT, 3) + CUT * chi2.sf(CUT, 1))
"""Mean of the lesser of e^2 and ``CUT`` for a standard normal e: outliers do not count as noise."""
SEGMENT_S = 10.0
ENOUGH_S = 200.0
"""Duration of the first flights for which the noise of healthy vehicles is changed: it shows in all alike."""
PARTED = 0.1
OVERLAPPING = 0.75
"""Variance of a scatter over both of two ways to divide flights, as a share of that over one (Welch 1987)."""


@dataclass(frozen=True)
class FisherInformation:
    """Score and Fisher information of all columns, for each segment of the flights."""

    columns: tuple[str, ...]
    flight: Ints
    """(segments,) number of the flight."""
    information: Array
    """(segments, p, p)."""
    score: Array
    """(segments, p)."""
    log_likelihood: Array
    """(segments,)."""
    passes: tuple[FilterPass, ...] = ()
    """Run of each flight under the parameters themselves."""
    shifted: FisherInformation | None = None
    """The same rows in segments that begin half a segment earlier; None where they are not known."""

    @staticmethod
    def of_rows(
        columns: Sequence[str], sensitivity: Array, white: Array, segment: Ints, flight: Ints
    ) -> FisherInformation:
        """Return that of white rows (n,) with their sensitivities (n, p) and the segment (n,) of each.

        ``flight`` (segments,) is that of each segment.
        """
        own = ((sensitivity[segment == k], white[segment == k]) for k in range(len(flight)))
        parts = [LikelihoodScore(a.T @ a, a.T @ e, -0.5 * float(e @ e)) for a, e in own]
        return FisherInformation.of_parts(columns, flight, parts)

    @staticmethod
    def of_parts(
        columns: Sequence[str], flight: Ints, parts: Sequence[LikelihoodScore],
        passes: Sequence[FilterPass] = (),
    ) -> FisherInformation:  # fmt: skip
        """Return that of segments with known scores; ``flight`` (segments,) is that of each."""
        return FisherInformation(
            tuple(columns), flight, np.array([part.information for part in parts]),
            np.array([part.score for part in parts]), np.array([part.log_likelihood for part in parts]),
            tuple(passes),
        )  # fmt: skip

    @property
    def half_interval(self) -> float:
        """Half of a 95 % interval in standard errors, by Student's distribution over the segments."""
        return float(student.ppf(0.975, max(self.independent - 1.0, 1.0)))

    @property
    def independent(self) -> float:
        """Number of independent segments whose scatter would be as certain."""
        return len(self.score) / (OVERLAPPING if self.shifted is not None else 1.0)

    def of(self, segments: Mask) -> FisherInformation:
        """Return score and information of some segments alone."""
        return replace(
            self, flight=self.flight[segments], information=self.information[segments],
            score=self.score[segments], log_likelihood=self.log_likelihood[segments], shifted=None,
        )  # fmt: skip

    def by_segment(self, flight: int, by_event: Array) -> Array:
        """Return (segments of a flight,) sums of (events,) values; 0 for its pictures, which are the last."""
        own = self.flight == flight
        seen = int(self.passes[flight].record.matches is not None)
        return np.pad(by_segment(by_event, int(own.sum()) - seen), (0, seen))

    def left_at(self, step: Array) -> Array:
        """Return (segments, p) what is left of the score at a step of all columns."""
        return np.asarray(self.score - self.information @ step)

    def scatter(self, free: Ints, step: Array, plain: Array, judged: int) -> Array:
        """Return the covariance of the free columns from the scatter of the segments' scores at a step.

        It is no less than ``plain``, that of white errors. A square distance of all parameters together by it
        is about chi-square if all are ``judged``, as Hotelling's. With one judged it is that of the interval
        of each parameter, however many others are fitted. Source: Bester, Conley and Hansen 2011.
        """
        every = [self] if self.shifted is None else [self, self.shifted]
        lefts = [segments.left_at(step)[:, free] for segments in every]
        between = plain @ np.mean([left.T @ left for left in lefts], axis=0) @ plain
        # The fit takes its share of the scatter; Hotelling's square has a mean above its degrees of freedom.
        between *= len(self.score) / max(len(self.score) - 1.0, 1.0)
        between *= (self.independent - 1.0) / max(self.independent - judged, 1.0)
        wider = np.sqrt(np.maximum(np.diag(between) / np.diag(plain), 1.0))
        return np.asarray(plain * wider[:, None] * wider)

    def nats_at(self, step: Array) -> Array:
        """Return (segments,) log likelihoods at a step of all columns."""
        return np.asarray(self.score @ step - 0.5 * (self.information @ step) @ step)


def fisher_information(
    records: Sequence[Record], parameters: FilterParameters, effects: Sequence[Effect],
    nuisances: Sequence[FittedParameter], in_full: bool = False,
) -> FisherInformation:  # fmt: skip
    """Run the filter over the flights once, with the columns of some effects and nuisances.

    Those of the mean are always included. ``in_full``: effects may inject the signals of ``signals_of``, and
    each noise nuisance adds one column, named by ``gain_column``: its effect on the mean.
    """
    perturbations = list(dict.fromkeys([*MEAN_PERTURBATIONS, *(d for e in effects for d in e.perturbations)]))
    changes = [*(n for n in NOISE_NUISANCES if n in nuisances), *(c for e in effects for c in e.changes)]
    plain = in_threads(lambda record: whole(record, parameters), records) if changes else []
    before_s = np.cumsum([0.0, *(r.duration_s for r in records)])
    # Where tails are heavy, squared innovations e^2 are less evidence of the variance: 2 over their variance.
    weight = np.ones(len(CHANNELS))
    if plain:
        for channel in range(len(CHANNELS)):
            cut = np.minimum(used_innovations(plain, channel) ** 2, CUT)
            weight[channel] = 1.0 / max(float(np.var(cut)) / 2.0, 1.0) if len(cut) else 1.0
    apart = np.array([k for k, c in enumerate(changes) if in_full and c in NOISE_NUISANCES], dtype=int)
    gains = (gain_column(changes[k].name) for k in apart.tolist())
    names = *(d.name for d in perturbations), *(c.name for c in changes), *gains

    def one(k: int) -> tuple[list[LikelihoodScore], FilterPass]:
        left_out = NOISE_NUISANCES if before_s[k] >= ENOUGH_S else ()
        steps = np.array([np.inf if c in left_out else c.difference(parameters) for c in changes])
        changed = [
            c.stepped(parameters, step) for c, step in zip(changes, steps, strict=True) if step < np.inf
        ]
        signals = signals_of(records[k], plain[k].states, k, len(records)) if in_full else {}
        run = Run(records[k], parameters, perturbations, signals, changed)
        terms, passed = list(_segment_terms(run, steps, apart, weight)), run.passed()
        nats = by_segment(passed.nats.sum(axis=1), len(terms)).tolist()
        parts = [replace(part, log_likelihood=x) for part, x in zip(terms, nats, strict=True)]
        if (matches := records[k].matches) is not None:
            # Given the readings, pictures are independent of all innovations: they are one more segment.
            seen = reprojection_score(records[k], matches, parameters, perturbations)
            parts.append(seen.by(np.eye(len(perturbations), len(names))))
        return parts, passed

    parts, passes = zip(*in_threads(one, range(len(records))), strict=True)
    flight = np.repeat(np.arange(len(records)), [len(of_flight) for of_flight in parts])
    return FisherInformation.of_parts(names, flight, [part for of in parts for part in of], passes)


def _segment_terms(run: Run, steps: Array, apart: Ints, weight: Array) -> Iterator[LikelihoodScore]:
    """Yield information and score of each segment of a flight.

    ``steps`` (changes,) are the sizes of the changes of the noise, infinite for those that did not run.
    ``weight`` (channels,) is that of squared innovations."""
    ran = np.flatnonzero(steps < np.inf)
    for rows in run.segments(SEGMENT_S):
        d, end = rows.sensitivity.shape[1], rows.sensitivity.shape[1] + len(steps)
        traces = np.zeros((len(rows.white), end + len(apart)))
        widened = np.zeros((len(rows.white), len(steps)))
        traces[:, :d] = rows.sensitivity
        white, wider = rows.white[:, None], rows.change_of_log_variance
        beside = (white - rows.change_of_mean) * np.exp(-0.5 * wider)
        # Where a change moves an innovation far, it is no small one, and the slope is meaningless.
        near = np.abs(white - beside) < PARTED * (1.0 + np.abs(white))
        traces[:, d + ran] = np.where(near, rows.change_of_mean, 0.0) / steps[ran]
        traces[:, end:] = traces[:, d + apart]
        widened[:, ran] = np.where(near, wider, 0.0) / steps[ran]
        spread = widened * weight[rows.channels, None]
        score = rows.white @ traces
        information = traces.T @ traces
        excess = np.minimum(rows.white**2, CUT) - CUT_MEAN
        score[d:end] += 0.5 * (excess * weight[rows.channels]) @ widened
        information[d:end, d:end] += 0.5 * spread.T @ widened
        yield LikelihoodScore(information, score)


def by_segment(by_event: Array, segments: int) -> Array:
    """Return (segments,) sums of (events,) values over the segments of ``Run.segments``."""
    ends = segment_bounds(len(by_event), segments)[1:]
    segment = np.searchsorted(ends, np.arange(len(by_event)), side="right")
    return np.asarray(np.bincount(segment, weights=by_event, minlength=segments), dtype=float)
