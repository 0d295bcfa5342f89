"""Evidence of flights with command logs: roll-outs of the causes, what is left over, and the next flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from slam.core.arrays import Array
from slam.core.progress import Progress, Tally
from slam.criticism.camera.reprojection import reprojection_errors
from slam.criticism.cause import WIDE, Cause, Interval
from slam.criticism.extended import extended_model, with_certainty, with_terms
from slam.criticism.finding import NameInDoubt, Onset
from slam.criticism.kalman.filter import OUTLIER, USED
from slam.criticism.kalman.filter_parameters import POINTS, FilterParameters
from slam.criticism.kalman.innovations import FilterPass, used_innovations
from slam.criticism.kalman.readings import CHANNELS, INSTRUMENTS, RANGE
from slam.criticism.next_flight import next_flight
from slam.criticism.prepare import PreparedFlights, untested_reasons
from slam.criticism.residuals.reading_anomalies import reading_anomalies, smallest_in_readings
from slam.criticism.search.fitted_parameters import NUISANCES
from slam.criticism.search.fitting import lag_one_correlation
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import with_misfit
from slam.criticism.verdict.criticism import ChannelCheck, Criticism
from slam.criticism.verdict.held_out import HeldOut, confirmed_terms, fitted_parameters, held_out
from slam.criticism.verdict.judge import Evidence, JudgedCauses
from slam.criticism.verdict.over_time import CERTAIN_Z, changing_sizes, commanded_onset, contradictions
from slam.criticism.verdict.posterior import likeliest, posterior_of
from slam.criticism.verdict.rollout_fit import RolloutFit, fit_rollouts
from slam.criticism.verdict.rollouts import covariate, rollout_errors
from slam.criticism.verdict.sentence import unusable
from slam.data_quality.finding import Finding, Remark
from slam.data_quality.oscillation import FEWEST, Vibration, common_line
from slam.data_quality.pictures.flicker import flicker_among
from slam.simulation.model import Model

TENTHS = 10
FEWEST_SHOWN = 5
"""Least number of effects that flights must be able to show: a tenth."""


def explain(
    prepared: PreparedFlights,
    found: SearchResult,
    readings: Sequence[Finding],
    model: Model,
    progress: Progress,
) -> CommandedFlights:
    """Compare what was found with all alternatives, and return what is more probable than these."""
    found = confirmed_terms(found)
    posterior = posterior_of(found)
    reported = likeliest(found, posterior)
    parameters = fitted_parameters(reported, reported.chosen)
    doubts, refuted = contradictions(reported, parameters)
    if refuted:
        reported = reported.without(refuted)
        parameters = fitted_parameters(reported, reported.chosen)
    best = None
    if found.model.out_of_model and reported.chosen and len(found.records) > 1:
        best = fit_rollouts(parameters, reported, progress)
        reported = replace(reported, chosen=best.chosen)
    if reported is not found:
        posterior = posterior_of(reported, refuted)
    if best is not None:
        known = {e.name: best.probability(e) for e in reported.chosen}
        posterior = posterior.raised(known, reported.rivals)
    return CommandedFlights(
        found=reported, posterior=posterior, limits=prepared.limits, readings=readings, model=model,
        anomalies=[*prepared.anomalies, *reading_anomalies(reported.last.fisher.passes)],
        progress=progress, doubts=doubts, refuted=tuple(refuted), best=best, dropped=prepared.dropped,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class CommandedFlights(Evidence):
    """Evidence of flights with command logs."""

    dropped: tuple[str, ...]
    """Flights, streams and pictures that are not judged, with the reason, one line each."""

    @cached_property
    def parameters(self) -> FilterParameters:
        """Filter parameters with the chosen causes in them."""
        best, found = self.best, self.found
        return fitted_parameters(found, found.chosen) if best is None else best.parameters

    @cached_property
    def _together(self) -> HeldOut | None:
        """Gain of all chosen terms on held-out flights; None without any."""
        return held_out(self.found) if any(e.is_term for e in self.found.chosen) else None

    @cached_property
    def _onset(self) -> Onset | None:
        """Return a change beside the chosen effects, or one that explains more than any of them."""
        found, least = self.found, max(CERTAIN_Z, self.limits.patterns)
        greatest = max(map(found.z_of, found.chosen), default=0.0)
        beside = commanded_onset(found, self.parameters, with_misfit(least, greatest))
        if beside is not None or not found.chosen:
            return beside
        alone = replace(found, last=found.first, chosen=())
        return commanded_onset(alone, found.first.parameters, max(least, greatest))

    @cached_property
    def _rolled_out(self) -> Tally:
        return Tally(self.progress, "roll out", 2)

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """Return the chosen terms of the catalogue as causes."""
        with self._rolled_out.part():
            if self._together is None:
                return ()
            records, before = self.found.records, self._together.before
            after = self._together.after if self.best is None else self.best.left_out
            errors = rollout_errors(records, before, after)
            perturbations = [d for e in self.found.chosen if e.is_term for d in e.perturbations]
            if any(d.kind == "camera" and d.entry < POINTS for d in perturbations):
                errors = (*errors, *reprojection_errors(records, before, after))
            return self.causes_of(self._together, errors)

    def findings(self, judged: JudgedCauses) -> Sequence[Finding]:
        """Return what no cause explains, residual patterns excepted."""
        reported, doubts = {c.name for c in judged.reported}, self.doubts
        passes = self.found.last.fisher.passes
        return [
            *(f for f in self.readings if not f.is_shown_otherwise),
            *([self._onset] if self._onset is not None else []),
            *(replace(doubt, is_cause=name in reported) for name, doubt in doubts.items()),
            *(self.best.unhealthy if self.best is not None else ()),
            *vibration_of(passes),
            *flicker_among(r.matches.flicker for r in self.found.records if r.matches is not None),
            *(NameInDoubt(is_cause=False, effect=c.name) for c in judged.faint if c.name not in doubts),
            *outliers_of(passes),
        ]

    def completed(self, found: Criticism) -> Criticism:
        """Return the criticism with flight, model, tables; ``unusable`` where next to nothing could show."""
        shown = list(found.within_reach)
        found = replace(found, flights=tuple(record.name for record in self.found.records))
        if found.verdict == "nothing_wrong" and len(shown) < FEWEST_SHOWN:
            reasons = untested_reasons(self.found.records, shown)
            return replace(
                unusable(reasons, self.dropped, "Fly longer, or record more."), model=found.model,
                flights=found.flights, detectable=found.detectable, threshold=found.threshold,
                threshold_means=found.threshold_means,
            )  # fmt: skip
        searched, parameters = self.found, self.parameters
        begun = [] if self._onset is None else [self._onset.effect]
        correlations = zip(INSTRUMENTS, parameters.noise_correlation.tolist(), strict=True)
        nearest, threshold, findings = max(found.ranking, key=lambda r: r.z), found.threshold, found.findings
        if found.verdict == "unknown" and not found.causes and nearest.z >= 0.5 * threshold:
            text = f"nearest is {nearest.name}, by {nearest.z:.1f} sigma where {threshold:.1f} are required"
            findings = (*findings, Remark(text, effect=nearest.name))
        with self._rolled_out.part():
            drawn = covariate(parameters, searched, found.causes[0]) if found.causes else None
        unseen: dict[str, Model] = {}
        if self._together is not None and self._together.by == "flight":
            after = self._together.after if self.best is None else self.best.left_out
            each = zip(found.flights, after, strict=True)
            unseen = {name: self._extended(found.causes, fitted) for name, fitted in each}
        return replace(
            found,
            findings=findings,
            next_flight=next_flight(self.model, searched, self.posterior, self.progress),
            detectable=found.detectable | smallest_in_readings(self.found.records),
            nuisances=_fitted_nuisances(searched, self.best),
            noise_correlation={name: share for name, share in correlations if share > 0.0},
            checks=_checks(searched.last.fisher.passes),
            covariate=drawn,
            changes=changing_sizes(searched, parameters, {*self.doubts, *begun}),
            dropped=self.dropped,
            extended=with_certainty(self._extended(found.causes, parameters), found.causes),
            unseen=unseen,
        )

    def _extended(self, causes: Sequence[Cause], parameters: FilterParameters) -> Model:
        """Return the model with the reported causes: what may as well be something else is left out."""
        seen = {anomaly.name for anomaly in self.anomalies}
        of_streams = [cause.name for cause in causes if cause.name not in seen]
        model = extended_model(self.model, parameters, of_streams, self.found.records)
        return with_terms(model, self.anomalies)


def _fitted_nuisances(found: SearchResult, best: RolloutFit | None) -> dict[str, Interval]:
    """Return this vehicle's own constants with their 95 % intervals."""
    expansion = found.last
    step, covariance = expansion.maximise(found.chosen).of(expansion.names)
    values: dict[str, Interval] = {}
    for k, nuisance in enumerate(NUISANCES):
        x, std = nuisance.value_in(expansion.parameters) + step[k], WIDE * float(np.sqrt(covariance[k, k]))
        if best is not None and best.std.get(nuisance.name):  # 0 if no flight of the fit shows the constant
            x, std = nuisance.value_in(best.parameters), WIDE * best.std[nuisance.name]
        ends = x - std, x, x + std
        low, value, high = (float(np.exp(end) if nuisance.form == "log" else end) for end in ends)
        values[nuisance.name] = Interval(value, nuisance.unit, low, high)
    return values


def _checks(passes: Sequence[FilterPass]) -> tuple[ChannelCheck, ...]:
    """Check that each channel's whitened innovations are white: mean square, lag-one correlation and
    distribution (the probability integral transform, Dawid 1984)."""
    correlation, _ = lag_one_correlation(passes)
    found = []
    for channel, name in enumerate(CHANNELS):
        white = used_innovations(passes, channel)
        if len(white) > 1:
            square, next_one = float(np.mean(white**2)), float(correlation[channel])
            tenths = np.histogram(ndtr(white), bins=TENTHS, range=(0.0, 1.0))[0] / len(white)
            found.append(ChannelCheck(name, len(white), square, next_one, tuple(tenths.tolist())))
    return tuple(found)


LARGEST_SHARE, FEWEST_OUTLIERS = 0.05, 5
"""Share and number of a channel's outliers above which they are reported. Noise with the tails of Student's t
of four degrees of freedom has 0.4 %."""


def vibration_of(passes: Sequence[FilterPass]) -> list[Vibration]:
    """Return the least probable line of all channels; none where noise may make each."""
    each = (common_line(name, [_white(c, run) for run in passes]) for c, name in enumerate(CHANNELS))
    return sorted((line for line in each if line is not None), key=lambda line: line.log10_chance)[:1]


def _white(channel: int, run: FilterPass) -> tuple[Array, float]:
    """Return a channel's whitened innovations at even times (0 where unused), and the time step."""
    rows, innovations, status = run.of_channel(channel)
    used = status == USED
    if used.sum() < FEWEST:
        return np.zeros(0), 0.0
    times_s, white = run.record.times_s[rows], np.where(used, innovations, 0.0)
    step_s = float(np.median(np.diff(times_s)))
    at = np.rint((times_s - times_s[0]) / step_s).astype(np.int64)
    return np.asarray(np.bincount(at, weights=white - white.mean()), dtype=float), step_s


def outliers_of(passes: Sequence[FilterPass]) -> list[Remark]:
    """Return the channels with more rejected readings than noise explains, spikes aside."""
    found = []
    for channel, name in enumerate(CHANNELS[:RANGE]):
        status = np.concatenate([run.of_channel(channel)[2] for run in passes])
        out = int(np.count_nonzero(status == OUTLIER))
        both = out + int(np.count_nonzero(status == USED))
        if out >= FEWEST_OUTLIERS and out > LARGEST_SHARE * both:
            far = f"{out} of {both} readings of {name} are far from anything that the model allows"
            found.append(Remark(far, channel=name))
    return found
