"""Verdict on flights, with and without command logs, from the evidence that they give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slam.criticism.cause import Cause
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.residuals.reading_anomalies import ENTAILS, ReadingAnomaly
from slam.criticism.search.expansion import ScoreTest
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import Thresholds, with_misfit
from slam.criticism.verdict.criticism import Criticism, Rank
from slam.criticism.verdict.decision import by_importance, decide, split_by_probability
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE, Posterior
from slam.criticism.verdict.power import confusable, detectable
from slam.criticism.verdict.rollout_fit import RolloutFit
from slam.criticism.verdict.sentence import with_sentences
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

SHOWN_PATTERNS = 8
"""Number of residual patterns shown."""


@dataclass(frozen=True)
class Explanation:
    """Explanation of the flights by the terms of the catalogue."""

    found: SearchResult
    parameters: FilterParameters
    """Filter parameters with the chosen causes in them."""
    posterior: Posterior
    doubts: dict[str, str]
    """Cause -> description of what contradicts it."""
    best: RolloutFit | None
    """Sizes by roll-outs for an out-of-model vehicle, else None."""


@dataclass(frozen=True)
class JudgedCauses:
    """Causes by their probability, and the residual patterns beside them."""

    reported: tuple[Cause, ...]
    """The leading one is first."""
    faint: tuple[Cause, ...]
    left: list[ScoreTest]
    """Residual patterns, greatest first."""


class Evidence(Protocol):
    """Evidence of flights beside the explanation, of roll-outs or of comparisons of instruments."""

    @property
    def explanation(self) -> Explanation:
        """Explanation by the terms of the catalogue."""
        ...

    @property
    def limits(self) -> Thresholds:
        """Thresholds of the score tests."""
        ...

    @property
    def anomalies(self) -> Sequence[ReadingAnomaly]:
        """Anomalies of single readings."""
        ...

    def causes(self) -> tuple[Cause, ...]:
        """Return the chosen terms of the catalogue as causes."""
        ...

    def unexplained(self, judged: JudgedCauses) -> Sequence[str]:
        """Describe what no cause explains, residual patterns excepted."""
        ...

    def completed(self, found: Criticism) -> Criticism:
        """Return the criticism with the next flight, the extended model and what else the flights tell."""
        ...


def judge(evidence: Evidence, model: Model) -> Criticism:
    """Return the criticism of a model by the evidence of flights."""
    explanation, limits, anomalies = evidence.explanation, evidence.limits, evidence.anomalies
    found, posterior = explanation.found, explanation.posterior
    judged = _judged(explanation, evidence.causes(), anomalies, limits)
    causes, left = judged.reported, judged.left
    pattern_z = with_misfit(limits.patterns, max((c.z for c in causes), default=0.0))
    entailed = [name for o in anomalies for name in ENTAILS.get(o.name, ())]
    unexplained = evidence.unexplained(judged)
    verdict, equivalents, remainder = decide(causes, found, posterior, left, unexplained, pattern_z, entailed)
    probability = posterior.probability | {c.name: c.probability for c in causes}
    criticism = evidence.completed(
        Criticism(
            verdict=verdict,
            causes=causes,
            equivalence_set=equivalents,
            remainder=remainder,
            detectable=detectable(found.first, limits.effects),
            ranking=ranking(found, probability, [o.cause() for o in anomalies]),
            confusable=confusable(found.first),
            patterns=tuple((s.effect.name, s.z) for s in left[:SHOWN_PATTERNS]),
            threshold=limits.effects,
            threshold_means=limits.meaning,
            model=model,
        )
    )
    return criticism if criticism.verdict == "unusable" else with_sentences(criticism)


def _judged(
    explanation: Explanation, fitted: Sequence[Cause], anomalies: Sequence[ReadingAnomaly], limits: Thresholds
) -> JudgedCauses:
    """Divide the chosen terms ``fitted`` by their probability, and add the anomalies of single readings."""
    found = explanation.found
    tests = found.last.score_tests(found.chosen, found.last.patterns)
    left = sorted(tests, key=lambda s: (-round(s.z, 2), s.effect.name))
    pattern_z = with_misfit(limits.patterns, max((c.z for c in fitted), default=0.0))
    left_z = max((s.z for s in left[:1] if s.z > pattern_z), default=0.0)
    likely, faint = split_by_probability(fitted, found, explanation.posterior, explanation.doubts, left_z)
    # An anomaly that cannot be removed from every stream leaves a part of its term: it is the same cause.
    likely = tuple(cause for cause in likely if cause.name not in {o.name for o in anomalies})
    return JudgedCauses(by_importance([*likely, *(o.cause() for o in anomalies)]), faint, left)


def ranking(
    found: SearchResult, probability: dict[str, float], anomalies: Sequence[Cause]
) -> tuple[Rank, ...]:
    """Return all terms, "nothing" and "something else", by probability and by their score test alone.

    ``anomalies``: the causes that single readings show; "nothing" requires that there is none of these
    either.
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
