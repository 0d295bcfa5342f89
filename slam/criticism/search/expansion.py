"""Second-order expansion of the likelihood about filter parameters, and score tests of every effect.

The innovations are linearised about the parameters. One run of the filter gives all sensitivities and the
effects of all changes of the noise. The rest is algebra on the Fisher information.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from frontend.cores import in_threads
from slam.core.arrays import Array
from slam.criticism.finding import ImplausibleSize
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import (
    Effect,
    delayed_readings,
    effects_for,
    pattern_directions,
    relaxed_nuisances,
    residual_patterns,
    signals_of,
)
from slam.criticism.search.fitted_parameters import (
    GAIN_CORRECTED,
    MEAN_PERTURBATIONS,
    NOISE_NUISANCES,
    fitted_parameter,
)
from slam.criticism.search.information import fisher_information
from slam.criticism.search.quadratic_likelihood import Maximum, QuadraticLikelihood
from slam.criticism.search.thresholds import Thresholds, parameter_cost
from slam.simulation.terms import CATALOGUE

NAMED_FIRST = 0.8
"""Share of its nats that counts for a constant out of its range or a delayed reading, which must explain more
than a term of the catalogue."""
ONE_CLASS = 0.95
"""Correlation beyond which two terms are alternatives."""
PLAUSIBLE = 3.0
"""Greatest distance of a possible value from neutral, in greatest usual distances."""


@dataclass(frozen=True)
class ScoreTest:
    """Score test of one effect, or of two together, beside those already chosen."""

    effect: Effect
    nats: float
    z: float
    partner: Effect | None = None
    """The second of two effects that are tested together."""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All effects that are tested."""
        return (self.effect,) if self.partner is None else (self.effect, self.partner)

    @property
    def cost(self) -> float:
        """Cost of the parameters in nats."""
        return sum(parameter_cost(len(e.columns)) for e in self.effects)

    @property
    def worth(self) -> float:
        """Nats less the cost of the parameters. An effect that is no term names no reason: it counts less."""
        share = 1.0 if all(e.is_term for e in self.effects) else NAMED_FIRST
        return share * self.nats - self.cost


@dataclass(frozen=True, kw_only=True)
class LikelihoodExpansion(QuadraticLikelihood):
    """Second-order expansion of the likelihood of the flights, with the effects that are tried."""

    effects: tuple[Effect, ...]
    """Every effect with columns in the Fisher information, relaxed nuisances included."""
    patterns: tuple[Effect, ...]
    """The bank of residual patterns; for an out-of-model vehicle delayed readings, too."""

    def own(self, effect: Effect) -> Effect:
        """Return the same effect with this expansion's columns."""
        same = [candidate for candidate in self.effects if candidate.name == effect.name]
        return next((candidate for candidate in same if candidate.label == effect.label), same[0])

    def score_tests(
        self, chosen: Sequence[Effect], among: Sequence[Effect | tuple[Effect, Effect]]
    ) -> list[ScoreTest]:
        """Return score tests of effects, or of pairs, beside the chosen ones, most nats after cost first."""
        base = self.maximise(chosen).nats
        found = []
        for tested in among:
            effects = tested if isinstance(tested, tuple) else (tested,)
            if any(e.repeats(c) for e in effects for c in chosen):
                continue
            judged = sum(len(e.columns) for e in effects)
            maximum = self.maximise([*chosen, *effects], judged=judged)
            wrong = any(backwards(e, self, maximum) for e in effects)
            nats = 0.0 if wrong else max(maximum.nats - base, 0.0)
            found.append(ScoreTest(effects[0], nats, self.z(effects, maximum, nats), *effects[1:]))
        return sorted(found, key=lambda s: s.cost - s.nats)


def expand(
    records: Sequence[Record],
    model: FilterParameters,
    parameters: FilterParameters,
    chosen: Sequence[Effect] = (),
) -> LikelihoodExpansion:
    """Expand the likelihood with every perturbation and noise change, in one pass over the flights."""
    plain = in_threads(lambda record: whole(record, parameters), records)
    both = zip(records, plain, strict=True)
    signals = [signals_of(record, run.states, k, len(records)) for k, (record, run) in enumerate(both)]
    current = [effect.free for effect in chosen if not effect.relaxes]
    labels = {effect.label for effect in current}
    effects = [e for e in effects_for(records, parameters) if e.label not in labels] + current
    patterns = pattern_directions(records)
    late = delayed_readings(records) if model.out_of_model else []
    moved = [d for e in (*effects, *late) for d in e.perturbations]
    perturbations = [*MEAN_PERTURBATIONS, *moved, *patterns]
    changes = [*NOISE_NUISANCES, *(c for e in effects for c in e.changes)]
    fisher = fisher_information(records, parameters, perturbations, changes, signals, plain, GAIN_CORRECTED)
    # A value of a grid is tried only where the parameters hold none.
    tried = [
        fitted_parameter(c) for e in effects if not e.is_profiled for c in e.columns if c not in e.relaxes
    ]
    values = {f.name: size for f in tried if (size := f.size_in(parameters)) != 0.0}
    return LikelihoodExpansion(
        fisher=fisher,
        parameters=parameters,
        model=model,
        current=values,
        effects=(*effects, *relaxed_nuisances(model.out_of_model)),
        patterns=(*residual_patterns(patterns), *late),
    )


def backwards(effect: Effect, expansion: LikelihoodExpansion, maximum: Maximum) -> bool:
    """Whether a non-negative size would be negative, or a size lies far beyond its plausible range."""
    size, covariance = expansion.fitted(effect, maximum)
    far = implausible_component(effect, expansion.parameters, size, 2.0 * np.sqrt(np.diag(covariance)))
    return (effect.positive and bool(size[0] < 0)) or (far is not None and not effect.is_profiled)


def implausible_component(
    effect: Effect, parameters: FilterParameters, size: Array, reach: Array
) -> int | None:
    """Return the first column whose size lies far beyond its plausible range, by more than its ``reach``."""
    for k, name in enumerate(effect.parameters if effect.perturbations else ()):
        usual = CATALOGUE[effect.name].parameter(name)
        far = PLAUSIBLE * max(abs(usual.high - usual.neutral), abs(usual.low - usual.neutral))
        least, most = max(usual.neutral - far, usual.least), min(usual.neutral + far, usual.most)
        values = [effect.in_catalogue_units(k, size[k] + side * reach[k], parameters) for side in (-1, 1)]
        if max(values) < least or min(values) > most:
            return k
    return None


def implausible_size(
    expansion: LikelihoodExpansion, chosen: Sequence[Effect], least_z: float
) -> ImplausibleSize | None:
    """Return the term that would explain most beside the chosen effects with a size beyond what is plausible,
    if it stands out by ``least_z``."""
    base, most, found = expansion.maximise(chosen).nats, 0.0, None
    for effect in expansion.effects:
        # Two effects that look alike may be large together, one against the other.
        if not effect.is_term or alike(expansion, effect, chosen):
            continue
        maximum = expansion.maximise([*chosen, effect], judged=len(effect.columns))
        size, covariance = expansion.fitted(effect, maximum)
        k = implausible_component(effect, expansion.parameters, size, 2.0 * np.sqrt(np.diag(covariance)))
        nats = maximum.nats - base - parameter_cost(len(effect.columns))
        z = expansion.z([effect], maximum, max(nats, 0.0))
        if k is not None and nats > most and z >= least_z:
            value = effect.in_catalogue_units(k, float(size[k]), expansion.parameters)
            unit = CATALOGUE[effect.name].parameter(effect.parameters[k]).unit
            most, found = (
                nats,
                ImplausibleSize(value, unit, effect=effect.name, parameter=effect.parameters[k], z=z),
            )
    return found


def alike(expansion: LikelihoodExpansion, effect: Effect, chosen: Sequence[Effect]) -> list[Effect]:
    """Return those of some effects that a term repeats, or cannot be told from: alternatives to it."""
    correlation = expansion.correlation
    return [e for e in chosen if e.repeats(effect) or correlation(effect, e) > ONE_CLASS]


def ranked_pairs(
    expansion: LikelihoodExpansion, rest: Sequence[Effect], without: Effect | None = None
) -> list[ScoreTest]:
    """Return tests of all pairs of terms with a slope in the mean, best first; ``without`` is in none."""
    excluded = [*rest, without] if without is not None else rest
    known = [
        e for e in expansion.effects
        if e.is_term and e.perturbations and not e.is_profiled and
        not any(map(e.repeats, excluded))
    ]  # fmt: skip
    pairs = [(one, other) for one, other in combinations(known, 2) if not one.repeats(other)]
    return [test for test in expansion.score_tests(rest, pairs) if test.nats > 0.0]


def masked_pair(
    expansion: LikelihoodExpansion, limits: Thresholds, alone: Sequence[ScoreTest] = ()
) -> tuple[Effect, ...] | None:
    """Return the best pair of terms that mask each other, or None: neither may be significant alone.

    An example is a warming sonar beside a climb stronger than the descent. The pair must explain more than
    the best of ``alone``, the terms that are significant by themselves, best first.
    """
    least = max((s.worth for s in alone), default=-np.inf) + np.log(len(CATALOGUE))
    worthy = (pair for pair in ranked_pairs(expansion, []) if pair.worth > least and pair.z >= limits.pairs)
    return next((pair.effects for pair in worthy if mask_each_other(expansion, pair.effects, limits)), None)


def mask_each_other(expansion: LikelihoodExpansion, two: Sequence[Effect], limits: Thresholds) -> bool:
    """Whether two terms are significant together, each beside the other, and one of them not alone."""
    one, other = two
    together = expansion.score_tests([], [(one, other)])[0]
    alone = min(expansion.score_tests([], [e])[0].z for e in two)
    beside = min(expansion.score_tests([one], [other])[0].z, expansion.score_tests([other], [one])[0].z)
    return alone < limits.effects <= beside and together.z >= limits.pairs
