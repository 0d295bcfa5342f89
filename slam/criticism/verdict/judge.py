"""Verdict on flights, with and without command logs, from the evidence that they give."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from slam.core.progress import Progress
from slam.criticism.cause import Cause
from slam.criticism.finding import Inconsistency, ResidualPattern
from slam.criticism.residuals.reading_anomalies import ENTAILS
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import Thresholds, with_misfit
from slam.criticism.verdict.criticism import Criticism, Rank
from slam.criticism.verdict.decision import by_importance, decide, left_over, split_by_probability
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE, Posterior
from slam.criticism.verdict.power import confusable, detectable
from slam.criticism.verdict.sentence import with_sentences
from slam.data_quality.finding import Finding
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

SHOWN_PATTERNS = 8


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

    @abstractmethod
    def causes(self) -> tuple[Cause, ...]:
        """Return the chosen terms of the catalogue as causes."""

    @abstractmethod
    def findings(self, judged: JudgedCauses) -> Sequence[Finding]:
        """Return what no cause explains, residual patterns excepted."""

    @abstractmethod
    def completed(self, found: Criticism) -> Criticism:
        """Return the criticism with the next flight, the extended model and what else the flights tell."""


def judge(evidence: Evidence) -> Criticism:
    """Return the criticism of a model by the evidence of flights."""
    found, posterior, limits = evidence.found, evidence.posterior, evidence.limits
    judged = _judged(evidence)
    causes, left = judged.reported, judged.left
    pattern_z = with_misfit(limits.patterns, max((c.z for c in causes), default=0.0))
    entailed = [name for o in evidence.anomalies for name in ENTAILS.get(o.name, ())]
    beyond = [left_over(e, found) for e in found.chosen if not e.is_term and e.name not in entailed]
    beyond += [*evidence.findings(judged), *(pattern for pattern in left[:1] if pattern.z > pattern_z)]
    verdict, equivalents, findings = decide(causes, posterior.probability, beyond, left[:1])
    probability = posterior.probability | {c.name: c.probability for c in causes}
    criticism = evidence.completed(
        Criticism(
            verdict=verdict, causes=causes, equivalence_set=equivalents, findings=findings,
            detectable=detectable(found.first, limits.effects), confusable=confusable(found.first),
            ranking=ranking(found, probability, evidence.anomalies), patterns=tuple(left[:SHOWN_PATTERNS]),
            threshold=limits.effects, threshold_means=limits.meaning, model=evidence.model,
        )
    )  # fmt: skip
    return criticism if criticism.verdict == "unusable" else with_sentences(criticism)


def _judged(evidence: Evidence) -> JudgedCauses:
    """Divide the chosen terms by their probability, and add the anomalies of single readings."""
    found, fitted = evidence.found, evidence.causes()
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
