"""Verdict on flights, with and without command logs, from the evidence that they give.

It is nothing wrong, named, ambiguous, named with a remainder, or unknown.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from slam.core.progress import Progress
from slam.criticism.cause import FAINT, LIKELY, SURE, WIDE, Cause, ChannelError, Gain, Interval
from slam.criticism.finding import Inconsistency, NameInDoubt, OutOfRange, ResidualPattern
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.residuals.reading_anomalies import ENTAILS
from slam.criticism.search.effects import Effect
from slam.criticism.search.fitted_parameters import fitted_parameter
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import MISFIT, Thresholds, with_misfit
from slam.criticism.verdict.criticism import Criticism, Rank, Verdict
from slam.criticism.verdict.held_out import CONFIRMED_NATS, HeldOut, held_out
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE, Posterior, posterior_of
from slam.criticism.verdict.rollout_fit import FREE, RolloutFit
from slam.data_quality.finding import Finding, Remark
from slam.data_quality.lag import LateReadings
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

SHOWN_PATTERNS = 8
MOST_ALIKE = 4
"""Greatest number of names of an equivalence set."""
SCATTER = 1.25
"""Ratio of the scatter of found sizes about the truth to their standard error: found terms are selected, and
no noise is exactly as modelled. From 18 singles of ``python -m tests.blind.run --kinds single --seed 3
--flights 3 --seconds 30 --cases 33``."""


@dataclass(frozen=True)
class JudgedCauses:
    """Causes by their probability, and the residual patterns beside them."""

    reported: tuple[Cause, ...]
    """The leading one is first."""
    faint: tuple[Cause, ...]
    left: list[ResidualPattern]
    """Greatest first."""


@dataclass(frozen=True, kw_only=True)
class Evidence(ABC):
    """Explanation of flights, and evidence beside it: of roll-outs or, without commands, of comparisons."""

    found: SearchResult
    posterior: Posterior
    limits: Thresholds
    """Thresholds of the score tests."""
    anomalies: Sequence[Cause]
    """Causes that single readings show."""
    readings: Sequence[Finding]
    """Anomalies of whole streams."""
    model: Model
    """The nominal model."""
    progress: Progress
    doubts: Mapping[str, Inconsistency] = field(default_factory=dict)
    """Cause -> what contradicts it."""
    best: RolloutFit | None = None
    """Sizes by roll-outs for an out-of-model vehicle, else None."""
    refuted: tuple[str, ...] = ()
    withdrawn: tuple[str, ...] = ()
    """Chosen terms that contradict themselves, and ones with which held-out flights are predicted worse."""

    @cached_property
    @abstractmethod
    def causes(self) -> tuple[Cause, ...]:
        """Return the chosen terms of the catalogue as causes."""

    @abstractmethod
    def findings(self, judged: JudgedCauses) -> Sequence[Finding]:
        """Return what no cause explains, residual patterns excepted."""

    @abstractmethod
    def completed(self, found: Criticism) -> Criticism:
        """Return the criticism with the next flight, the extended model and what else the flights tell."""

    def without(self, name: str) -> Self:
        """Return the evidence with a chosen term withdrawn."""
        withdrawn, found = (*self.withdrawn, name), self.found.without([name])
        posterior = posterior_of(found, (*self.refuted, *withdrawn))
        return replace(self, found=found, posterior=posterior, withdrawn=withdrawn)

    def causes_of(self, all_together: HeldOut, channels: tuple[ChannelError, ...]) -> tuple[Cause, ...]:
        """Return the chosen terms as causes, with sizes by roll-outs where there are any.

        ``all_together``: their gain on held-out flights. ``channels``: errors without and with them.
        """
        found, causes = self.found, []
        for effect, place in zip(found.chosen, self.posterior.places, strict=True):
            if not effect.is_term:
                continue
            rest = [e for e in found.chosen if e is not effect]
            # Only the first expansion describes the flights without a saturation.
            own = held_out(found, rest) if rest and not effect.is_saturation else all_together
            cause = Cause(
                name=effect.name,
                probability=self.posterior.probability.get(effect.name, 0.0),
                parameters=fitted_sizes(found, effect),
                gain=Gain.of(own.nats, own.by, channels),
                z=found.z_of(effect),
                lead_nats=place.lead_nats,
                alternatives=place.names,
                rival=place.rival,
            )
            causes.append(cause if self.best is None else _with_rollout_size(cause, effect, self.best))
        return tuple(causes)


def judge(evidence: Evidence) -> Criticism:
    """Return the criticism of a model by the evidence of flights, still without its sentences.

    Terms that predict held-out flights worse are withdrawn, first what gains least without its best part.
    """
    while evidence.best is None and evidence.causes and evidence.causes[0].gain.flies_worse:
        evidence = evidence.without(min(evidence.causes, key=lambda cause: cause.gain.beside_best).name)
    found, posterior, limits, judged = evidence.found, evidence.posterior, evidence.limits, _judged(evidence)
    causes, left = judged.reported, judged.left
    pattern_z = with_misfit(limits.patterns, max((c.z for c in causes), default=0.0))
    entailed = [name for o in evidence.anomalies for name in ENTAILS.get(o.name, ())]
    beyond = [left_over(e, found) for e in found.chosen if not e.is_term and e.name not in entailed]
    beyond += [NameInDoubt(is_cause=False, effect=name) for name in evidence.withdrawn]
    beyond += [*evidence.findings(judged), *(pattern for pattern in left[:1] if pattern.z > pattern_z)]
    verdict, equivalents, findings = decide(causes, posterior.probability, beyond, left[:1])
    probability = posterior.probability | {c.name: c.probability for c in causes}
    return evidence.completed(
        Criticism(
            verdict=verdict, causes=causes, equivalence_set=equivalents, findings=findings,
            detectable=found.first.detectable(limits.effects), confusable=found.first.confusable(),
            ranking=ranking(found, probability, evidence.anomalies), patterns=tuple(left[:SHOWN_PATTERNS]),
            threshold=limits.effects, threshold_means=limits.meaning, model=evidence.model,
        )
    )  # fmt: skip


def _judged(evidence: Evidence) -> JudgedCauses:
    """Divide the chosen terms by their probability, and add the anomalies of single readings."""
    found, fitted = evidence.found, evidence.causes
    tests = found.last.score_tests(found.chosen, found.last.patterns)
    left = [ResidualPattern.of(s.effect.name, s.z) for s in tests]
    left.sort(key=lambda pattern: (-round(pattern.z, 2), pattern.name))
    pattern_z = with_misfit(evidence.limits.patterns, max((c.z for c in fitted), default=0.0))
    left_z = max((s.z for s in left[:1] if s.z > pattern_z), default=0.0)
    likely, faint = split_by_probability(fitted, found, evidence.posterior, evidence.doubts, left_z)
    # An anomaly that cannot be removed from every stream leaves a part of its term: it is the same cause.
    seen = {anomaly.name for anomaly in evidence.anomalies}
    likely = tuple(cause for cause in likely if cause.name not in seen)
    return JudgedCauses(by_importance([*likely, *evidence.anomalies]), faint, left)


def ranking(
    found: SearchResult, probability: dict[str, float], anomalies: Sequence[Cause]
) -> tuple[Rank, ...]:
    """Return all terms, "nothing" and "something else", by probability and by their score test alone.

    ``anomalies``: the causes that single readings show; "nothing" requires that there is none of these.
    """
    seen = {cause.name: cause for cause in anomalies}
    healthy = float(np.prod([1.0 - cause.probability for cause in seen.values()]))
    probability = probability | {NOTHING: healthy * probability.get(NOTHING, 0.0)}
    z = {name: seen[name].z if name in seen else 0.0 for name, t in CATALOGUE.items() if t.in_single_readings}
    tests = [s for s in found.first.score_tests([], found.first.effects) if s.effect.is_term]
    z |= {test.effect.name: test.z for test in sorted(tests, key=lambda s: s.z)}
    ranks = [
        Rank(name, probability.get(name, 0.0), z.get(name, 0.0)) for name in (*z, NOTHING, SOMETHING_ELSE)
    ]
    return tuple(sorted(ranks, key=lambda r: (-round(r.probability, 6), -round(r.z, 3), r.name)))


def _with_rollout_size(cause: Cause, effect: Effect, best: RolloutFit) -> Cause:
    """Return the cause with its size by roll-outs, and with their gain where they raised its probability.

    Sizes that they do not fit, or that no flight of the fit shows, are those of the filter.
    """
    sizes = dict(cause.parameters)
    for k, (name, column) in enumerate(zip(effect.parameters, effect.columns, strict=True)):
        if std := best.std.get(column):
            current = 0.0 if column in FREE else fitted_parameter(column).size_in(best.parameters)
            sizes[name] = _interval(effect, k, WIDE * std, best.parameters, current)
    found = replace(cause, parameters=sizes)
    parts = np.array(best.nats.get(effect.name, ()))
    if best.probability(effect) < cause.probability - 1e-9:
        return found
    return replace(found, gain=Gain.of(parts, cause.gain.by, cause.gain.channels))


def split_by_probability(
    causes: Sequence[Cause],
    found: SearchResult,
    posterior: Posterior,
    doubted: Container[str],
    left_z: float = 0.0,
) -> tuple[tuple[Cause, ...], tuple[Cause, ...]]:
    """Divide causes into those probable enough to be reported, and the faint ones.

    ``left_z`` is the z of the strongest residual pattern, if it is significant. Where something else than a
    term is there, some causes are at even odds a part of that: inconsistent ones (``doubted``), and process
    noise, which any unmodelled motion raises. Causes below ``left_z`` may be a part of it as well. For an
    out-of-model vehicle some pattern is always more probable than any equation: odds are not shared with it.
    """
    if posterior.probability[SOMETHING_ELSE] > SURE and not found.model.out_of_model:
        noise_only = {e.name for e in found.chosen if e.changes}
        causes = [
            replace(c, probability=0.5 * c.probability)
            if c.name in doubted or c.name in noise_only or c.z < left_z
            else c
            for c in causes
        ]
    faint = tuple(c for c in causes if c.with_alternatives(posterior.probability) < FAINT)
    return tuple(c for c in causes if c not in faint), faint


def by_importance(causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """Sort causes. The probable cause that explains most leads; the others follow by rounded probability. A
    cause that only single readings show has no gain ahead, so it leads only where no other is probable."""
    lead = sorted(causes, key=lambda c: (c.probability <= LIKELY, not c.gain.channels, -c.gain.nats))[:1]
    rest = sorted(causes, key=lambda c: (-round(c.probability, 2), not c.gain.channels, -c.gain.nats))
    return (*lead, *(c for c in rest if c is not lead[0]))


def fitted_sizes(found: SearchResult, effect: Effect) -> dict[str, Interval]:
    """Return fitted parameters of a term in the catalogue's units, with 95 % intervals.

    The intervals include chance, widened by the scatter of simulated singles, and the equation's own misfit.
    """
    expansion = found.last
    size, covariance = expansion.fitted(effect, expansion.maximise(found.chosen, judged=1))
    wide = expansion.fisher.half_interval if expansion.clustered else WIDE * SCATTER
    sizes = {}
    for k, name in enumerate(effect.parameters):
        half = wide * float(np.hypot(np.sqrt(covariance[k, k]), effect.tolerance))
        sizes[name] = _interval(effect, k, half, expansion.parameters, float(size[k]))
    return sizes


def _interval(effect: Effect, k: int, half: float, parameters: FilterParameters, at: float) -> Interval:
    """Return the interval about size ``at`` of column k by a half width, with the equation's own misfit."""
    value, *ends = (effect.in_catalogue_units(k, at + side * half, parameters) for side in (0, -1, 1))
    parameter = CATALOGUE[effect.name].parameter(effect.parameters[k])
    # The size of a limit is the limit itself: without one it is far away.
    own = MISFIT * min(abs(value - parameter.neutral), abs(value))
    low, high = min(ends), max(ends)
    return Interval(
        value, parameter.unit,
        value - float(np.hypot(value - low, own)), value + float(np.hypot(high - value, own)),
    )  # fmt: skip


def decide(
    causes: Sequence[Cause],
    probability: Mapping[str, float],
    beyond: Sequence[Finding],
    strongest: Sequence[ResidualPattern] = (),
) -> tuple[Verdict, tuple[str, ...], tuple[Finding, ...]]:
    """Return verdict, equivalence set and findings.

    ``causes``: the leading one first. ``beyond``: what they leave over. ``strongest``: the greatest residual
    pattern, reported where something unknown leaves no other finding.
    """
    remains = list(beyond)
    if not causes:
        return ("unknown" if remains else "nothing_wrong"), (), tuple(remains)
    lead, others = causes[0], causes[1:]
    if is_unknown(causes, probability):
        return "unknown", (), tuple(remains or strongest)
    for cause in others:
        if len(cause.alternatives) > 1 or cause.probability < SURE:
            remains.append(NameInDoubt(cause.alternatives[1:MOST_ALIKE], effect=cause.name))
    if len(lead.alternatives) > 1:
        return "ambiguous", lead.alternatives[:MOST_ALIKE], tuple(remains)
    if lead.probability < SURE:
        remains.append(NameInDoubt(effect=lead.name))
    if lead.gain.nats < CONFIRMED_NATS or (lead.gain.by and len(lead.gain.parts) < 2):
        remains.append(Remark("held-out flights do not confirm it"))
    return ("named_with_remainder" if remains else "named"), (lead.name,), tuple(remains)


def is_unknown(causes: Sequence[Cause], probability: Mapping[str, float]) -> bool:
    """Whether something else than a term is more probable than not, and no cause with its alternatives is."""
    likeliest = max((c.with_alternatives(probability) for c in causes), default=0.0)
    return likeliest <= LIKELY < probability[SOMETHING_ELSE]


def left_over(effect: Effect, found: SearchResult) -> Finding:
    """Return a chosen effect that is no term as a finding."""
    if effect.relaxes:
        return OutOfRange(channel=effect.relaxes[0])
    channel, _, lag = effect.name.partition(" ")
    if lag not in (LateReadings.BY_DELAY, LateReadings.BY_FILTER):
        return ResidualPattern.of(effect.name)
    size, _ = found.last.fitted(effect, found.last.maximise(found.chosen))
    size = size if lag == LateReadings.BY_DELAY else np.sqrt(size)
    return LateReadings(float(size[0]), lag, channel=channel)
