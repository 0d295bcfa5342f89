"""Second-order expansion of the likelihood about filter parameters, and score tests of every effect.

The innovations are linearised about the parameters. One run of the filter gives all sensitivities and the
effects of all changes of the noise. The rest is algebra on the Fisher information.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from slam.criticism.finding import ImplausibleSize
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import (
    Effect,
    delayed_readings,
    effects_for,
    relaxed_nuisances,
    residual_patterns,
)
from slam.criticism.search.fitted_parameters import AT, NUISANCES, fitted_parameter
from slam.criticism.search.information import fisher_information
from slam.criticism.search.quadratic_likelihood import NINE_OF_TEN, SEEN, Maximum, QuadraticLikelihood
from slam.criticism.search.thresholds import Thresholds
from slam.simulation.terms import CATALOGUE

NAMED_FIRST = 0.8
"""Share of its nats that counts for a constant out of its range or a delayed reading, which must explain more
than a term of the catalogue."""
CONFUSED = 0.9
CORRELATION_DIGITS = 4
LEAST_SHARE = 1e-6
"""Least share of a column's information that the nuisances must leave for it to be seen."""
ONE_CLASS = 0.95
"""Correlation beyond which two terms are alternatives."""


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
        return sum(e.cost for e in self.effects)

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
            wrong = any(self.backwards(e, maximum) for e in effects)
            nats = 0.0 if wrong else max(maximum.nats - base, 0.0)
            found.append(ScoreTest(effects[0], nats, self.z(effects, maximum, nats), *effects[1:]))
        return sorted(found, key=lambda s: s.cost - s.nats)

    def backwards(self, effect: Effect, maximum: Maximum) -> bool:
        """Whether a non-negative size would be negative, or a size lies far beyond its plausible range."""
        far, (size, _) = self._implausible_column(effect, maximum), self.fitted(effect, maximum)
        return (effect.positive and bool(size[0] < 0)) or (far is not None and not effect.is_profiled)

    def _implausible_column(self, effect: Effect, maximum: Maximum) -> int | None:
        size, covariance = self.fitted(effect, maximum)
        return effect.implausible_column(self.parameters, size, 2.0 * np.sqrt(np.diag(covariance)))

    def implausible_size(self, chosen: Sequence[Effect], least_z: float) -> ImplausibleSize | None:
        """Return the term that would explain most beside the chosen effects with a size beyond what is
        plausible, if it stands out by ``least_z``."""
        base, most, found = self.maximise(chosen).nats, 0.0, None
        for effect in self.effects:
            # Two effects that look alike may be large together, one against the other.
            if not effect.is_term or self.alike(effect, chosen):
                continue
            maximum = self.maximise([*chosen, effect], judged=len(effect.columns))
            k = self._implausible_column(effect, maximum)
            nats = maximum.nats - base - effect.cost
            z = self.z([effect], maximum, max(nats, 0.0))
            if k is not None and nats > most and z >= least_z:
                size = float(self.fitted(effect, maximum)[0][k])
                value = effect.in_catalogue_units(k, size, self.parameters)
                name, most = effect.parameters[k], nats
                unit = CATALOGUE[effect.name].parameter(name).unit
                found = ImplausibleSize(value, unit, effect=effect.name, parameter=name, z=z)
        return found

    def alike(self, effect: Effect, chosen: Sequence[Effect]) -> list[Effect]:
        """Return those of some effects that a term repeats, or cannot be told from: alternatives to it."""
        return [e for e in chosen if e.repeats(effect) or self.correlation(effect, e) > ONE_CLASS]

    def ranked_pairs(self, rest: Sequence[Effect], without: Effect | None = None) -> list[ScoreTest]:
        """Return tests of all pairs of terms with a slope in the mean, best first; ``without`` is in none."""
        excluded = [*rest, without] if without is not None else rest
        known = [
            e for e in self.effects
            if e.is_term and e.perturbations and not e.is_profiled and not any(map(e.repeats, excluded))
        ]  # fmt: skip
        pairs = [(one, other) for one, other in combinations(known, 2) if not one.repeats(other)]
        return [test for test in self.score_tests(rest, pairs) if test.nats > 0.0]

    def masked_pair(self, limits: Thresholds, alone: Sequence[ScoreTest] = ()) -> tuple[Effect, ...] | None:
        """Return the best pair of terms that mask each other, such as a warming sonar beside a climb stronger
        than the descent, or None. It must explain more than the first of ``alone``, the significant terms."""
        least = max((s.worth for s in alone), default=-np.inf) + np.log(len(CATALOGUE))
        worthy = (pair for pair in self.ranked_pairs([]) if pair.worth > least and pair.z >= limits.pairs)
        return next((pair.effects for pair in worthy if self.mask_each_other(pair.effects, limits)), None)

    def mask_each_other(self, two: Sequence[Effect], limits: Thresholds) -> bool:
        """Whether two terms are significant together, each beside the other, and one of them not alone."""
        one, other = two
        together = self.score_tests([], [(one, other)])[0]
        alone = min(self.score_tests([], [e])[0].z for e in two)
        beside = min(self.score_tests([one], [other])[0].z, self.score_tests([other], [one])[0].z)
        return alone < limits.effects <= beside and together.z >= limits.pairs

    def detectable(self, threshold: float) -> dict[str, tuple[float, str]]:
        """Return the smallest size of each term that nine of ten cases would have shown, and its unit."""
        found: dict[str, tuple[float, str]] = {}
        for effect in self.effects:
            if not effect.is_term or effect.is_profiled:
                continue
            sizes = self.shown_sizes(effect, threshold)
            # The component of a vector that shows least decides.
            k = int(np.argmax(sizes))
            size = float(sizes[k])
            value, neutral = (effect.in_catalogue_units(k, x, self.parameters) for x in (size, 0.0))
            value = abs(value - neutral)
            parameter = CATALOGUE[effect.name].parameter(effect.parameters[k])
            if np.isfinite(value) and value < 10 * max(abs(parameter.most), abs(parameter.least)):
                kept = found.get(effect.name)
                found[effect.name] = (min(value, kept[0]) if kept else value), parameter.unit
        tried = [e for e in self.effects if e.is_saturation and e.is_profiled]
        variances = [self.fitted(e, self.maximise([e]))[1][0, 0] for e in tried]
        each = zip(tried, variances, strict=True)
        stands_out = [e for e, variance in each if variance**-0.5 > threshold + NINE_OF_TEN]
        shown = [(float(e.columns[0].partition(AT)[2]), e.name) for e in stands_out]
        # The highest limit that shows is the smallest effect.
        return found | {name: (limit, "rad") for limit, name in sorted(shown)}

    def confusable(self) -> tuple[tuple[str, str, float], ...]:
        """Return pairs of terms whose sensitivities, without the nuisances, correlate beyond ``CONFUSED``."""
        # Without a score every nuisance stays in its range, so that its prior alone holds it.
        fisher = replace(self.fisher, score=np.zeros_like(self.fisher.score))
        flat = replace(self, fisher=fisher)
        seen: dict[str, Effect] = {}
        for effect in self.effects:
            if not effect.is_term or effect.is_profiled or effect.relaxes or effect.name in seen:
                continue
            _, covariance = flat.maximise([effect]).of(effect.columns, white=True)
            information = np.diag(flat.information)[flat.index(effect.columns)]
            left = np.diag(np.linalg.inv(covariance))
            if ((information > SEEN) & (left > LEAST_SHARE * information)).all():
                seen[effect.name] = effect
        pairs = [(a, b, flat.correlation(seen[a], seen[b])) for a, b in combinations(sorted(seen), 2)]
        return most_alike_first(p for p in pairs if p[2] > CONFUSED)


def most_alike_first(pairs: Iterable[tuple[str, str, float]]) -> tuple[tuple[str, str, float], ...]:
    """Sort pairs by their correlation as reported, equal ones by name: rounding errors change no order."""
    return tuple(sorted(pairs, key=lambda pair: (-round(pair[2], CORRELATION_DIGITS), pair[:2])))


def expand(
    records: Sequence[Record],
    model: FilterParameters,
    parameters: FilterParameters,
    chosen: Sequence[Effect] = (),
) -> LikelihoodExpansion:
    """Expand the likelihood with every perturbation and noise change, in one pass over the flights."""
    current = [effect.free for effect in chosen if not effect.relaxes]
    labels = {effect.label for effect in current}
    effects = [e for e in effects_for(records, parameters) if e.label not in labels] + current
    patterns = residual_patterns(records)
    late = delayed_readings(records) if model.out_of_model else []
    tried = [*effects, *late, *patterns]
    fisher = fisher_information(records, parameters, tried, NUISANCES, in_full=True)
    # A value of a grid is tried only where the parameters hold none.
    own = [fitted_parameter(c) for e in effects if not e.is_profiled for c in e.columns if c not in e.relaxes]
    values = {f.name: size for f in own if (size := f.size_in(parameters)) != 0.0}
    return LikelihoodExpansion(
        fisher=fisher,
        parameters=parameters,
        model=model,
        current=values,
        effects=(*effects, *relaxed_nuisances(model.out_of_model)),
        patterns=(*patterns, *late),
    )
