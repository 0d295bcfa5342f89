"""Sequential search: expand the likelihood, take the term that explains most, expand again.

Small effects need one expansion: everything is linear about the healthy vehicle. Where a term is far more
significant, the best candidates are fitted with the filter run anew (Gauss-Newton). The best of them enters
the filter parameters, and the likelihood is expanded there.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np

from slam.core.normal_deviates import deviate
from slam.core.progress import Progress, Tally, silent
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import recoloured
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import LikelihoodExpansion, ScoreTest, expand
from slam.criticism.search.fitting import (
    ar1_effects,
    best_candidate,
    first_parts,
    fit_nuisances,
    refit,
    with_ar1_noise,
    without_small_ar1,
)
from slam.criticism.search.thresholds import VERY_SIMILAR_NATS, Thresholds, with_misfit
from slam.simulation.terms import CATALOGUE

LINEAR_Z = 25.0
"""Least z from which candidates are fitted with the filter run anew before one is chosen."""
CURVED_Z = 6.0
"""Least z from which a size needs the filter run anew: a landing makes its effect nonlinear."""
MOST_TERMS = 6
STAGES = ("fit", "screen", "compare causes")
SHORT_S = 80.0
"""Duration of the flights on which candidates are compared: they are all highly significant."""


@dataclass(frozen=True, kw_only=True)
class SearchResult:
    """Result of the search."""

    model: FilterParameters
    first: LikelihoodExpansion
    """Expansion about the healthy vehicle."""
    last: LikelihoodExpansion
    """Expansion about the parameters with large effects in them; the first one where there are none."""
    chosen: tuple[Effect, ...]
    rivals: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Alternatives to terms that were chosen by runs of the filter: names that fitted as well then."""
    leads: dict[tuple[str, str], float] = field(default_factory=dict)
    """Labels of a chosen term and of another -> nats of evidence by which the first leads in its place, both
    fitted with the filter run anew."""
    records: tuple[Record, ...] = ()
    """The flights as expanded: with reference runs under the AR(1) noise that was found."""

    def in_place(self, effect: Effect, name: str) -> list[ScoreTest]:
        """Return tests of a term in place of a chosen effect, by the way that explains most first."""
        expansion, beside = self.last, [e for e in self.chosen if e is not effect]
        if effect.is_saturation:  # only the first expansion describes the flights without it
            expansion, beside = self.first, []
        return expansion.score_tests(beside, [e for e in expansion.effects if e.name == name])

    def z_of(self, effect: Effect) -> float:
        """Return the z of a chosen effect beside the others."""
        return max(test.z for test in self.in_place(effect, effect.name))

    def without(self, names: Container[str]) -> SearchResult:
        """Return the search without some of the chosen terms.

        An expansion about parameters with a saturation, or with more noise, does not describe the flights
        without it: there is a new one. Without any term it is that of the healthy vehicle.
        """
        kept = tuple(e for e in self.chosen if e.name not in names)
        gone = [e for e in self.chosen if e not in kept and (e.is_saturation or e.changes)]
        if not kept or not gone:
            return replace(self, last=self.last if kept else self.first, chosen=kept)
        bare = reduce(lambda known, effect: effect.without(known), gone, self.last.parameters)
        parameters = fit_nuisances(self.records, self.model, bare, kept)
        last = expand(self.records, self.model, parameters, kept)
        return replace(self, last=last, chosen=tuple(map(last.own, kept)))


def with_term_replaced(
    found: SearchResult, place: Effect, candidates: Sequence[Sequence[Effect]]
) -> SearchResult:
    """Replace a chosen term by the best of some sets of terms, each fitted with the filter run anew.

    The result is unchanged where none explains more with a plausible size. A term is chosen as it looks from
    the healthy vehicle; what others would explain in its place shows only about the parameters with it.
    """
    rest = [e for e in found.chosen if e is not place]
    bare = place.without(found.last.parameters)
    old, _ = refit(found.records, found.model, found.last.parameters, found.chosen)
    old -= place.cost
    fits = []
    for others in candidates:
        nats, parameters = refit(found.records, found.model, bare, [*rest, *others])
        free = [e.free for e in others]
        sizes = [(e, e.size_in(parameters)) for e in free]
        if any(e.implausible_column(parameters, size, np.zeros_like(size)) is not None for e, size in sizes):
            nats = -np.inf
        cost = sum(e.cost for e in others) + (len(others) - 1) * np.log(len(CATALOGUE))
        fits.append((nats - cost - old, others, parameters))
    gained, others, parameters = max(fits, key=lambda fit: fit[0])
    alike = abs(gained) < VERY_SIMILAR_NATS
    if gained <= 0.0:
        leads = {(place.label, one[0].label): -more for more, one, _ in fits if len(one) == 1}
        rivals = {place.name: tuple(e.name for e in others)} if alike and len(others) > 1 else {}
        return replace(found, rivals=found.rivals | rivals, leads=found.leads | leads)
    chosen = [e.free for e in (*rest, *others)]
    expansion = expand(found.records, found.model, parameters, chosen)
    leads = found.leads | {(others[0].label, place.label): gained} if len(others) == 1 else {}
    rivals = found.rivals | {e.name: (place.name,) if alike else () for e in others}
    return replace(
        found, last=expansion, chosen=tuple(expansion.own(c) for c in chosen), rivals=rivals, leads=leads
    )


def search(
    records: Sequence[Record], model: FilterParameters, limits: Thresholds, progress: Progress = silent
) -> SearchResult:
    """Find terms that exceed the thresholds beside each other, best first."""
    state = _SequentialSearch(records, model, limits, progress)
    while (parameters := state.next_parameters()) is not None:
        state.expand_about(parameters)
    first = state.healthy()
    state.drop_superfluous()
    return SearchResult(
        model=model, first=first, last=state.expansion, chosen=tuple(state.chosen), rivals=state.rivals,
        leads=state.leads, records=tuple(state.records),
    )  # fmt: skip


class _SequentialSearch:
    """Sequential search: the terms chosen so far, and the expansion about the parameters with them."""

    def __init__(
        self, records: Sequence[Record], model: FilterParameters, limits: Thresholds, progress: Progress
    ) -> None:
        self._fits, self._expansions, self._tries = (Tally(progress, stage) for stage in STAGES)
        self.records, self._model, self._limits = records, model, limits
        self.chosen: list[Effect] = []
        self.rivals: dict[str, tuple[str, ...]] = {}
        self.leads: dict[tuple[str, str], float] = {}
        self._fitted, self._greatest_z = True, 0.0
        with self._fits.part():
            parameters = fit_nuisances(records, model, effects=ar1_effects(model))
        self._expand(parameters)
        self._first = self.expansion

    def next_parameters(self) -> FilterParameters | None:
        """Choose terms until a fit is needed; return parameters with all, or None for nothing more."""
        while True:
            limits = self._limits
            threshold = with_misfit(limits.second, self._greatest_z) if self.chosen else limits.effects
            tests = self.expansion.score_tests(self.chosen, self.expansion.effects)
            significant = beyond(tests, threshold)
            full = len(self.chosen) == MOST_TERMS
            weak = not significant or significant[0].z < CURVED_Z
            if not self.chosen and weak and (both := self.expansion.masked_pair(limits, significant)):
                # Two terms in place of weakly significant ones, or of none.
                self.chosen, self._fitted = list(both), False
                continue
            if not significant or full:
                return None if self._fitted else self._with_chosen()
            self._greatest_z = max(self._greatest_z, significant[0].z)
            # With one term more, the leads of those before it change.
            self.leads = {}
            if doubtful := _doubtful(significant):
                records = self.records
                if in_part := significant[0].z >= LINEAR_Z:
                    records = first_parts(records, SHORT_S)
                best = best_candidate(records, self.expansion, self.chosen, doubtful, self._tries)
                self.leads, self.rivals[best.effect.name] = {} if in_part else best.leads, best.rivals
                self.chosen.append(best.effect)
                return best.parameters
            self.chosen.append(significant[0].effect)
            if significant[0].effect.changes:
                # More noise is far less linear than a change of the mean: nothing else shows beside it.
                return self._with_chosen()
            self._fitted = self._fitted and significant[0].z < CURVED_Z

    def expand_about(self, parameters: FilterParameters) -> None:
        """Expand about parameters that hold the chosen terms, with nuisances fitted to them."""
        self.chosen = [c.free for c in self.chosen]
        with self._fits.part():
            free = [*self.chosen, *ar1_effects(parameters)]
            parameters = without_small_ar1(fit_nuisances(self.records, self._model, parameters, free))
        self._expand(parameters)
        self._fitted = True

    def healthy(self) -> LikelihoodExpansion:
        """Expand about parameters without terms, with their nuisances fitted to the noise that was found."""
        correlation = self.expansion.parameters.noise_correlation
        if (correlation == self._first.parameters.noise_correlation).all():
            return self._first
        parameters = replace(self._first.parameters, noise_correlation=correlation)
        with self._fits.part():
            parameters = fit_nuisances(self.records, self._model, parameters)
        with self._expansions.part():
            return expand(self.records, self._model, parameters)

    def drop_superfluous(self) -> None:
        """Remove the terms that the others have made superfluous."""
        before, score_tests = self.chosen, self.expansion.score_tests
        bounded = [e for e in before if e.is_saturation]
        if len(before) == 2 and not bounded and self.expansion.mask_each_other(before, self._limits):
            return
        alone = [
            score_tests([o for o in before if o is not e], [e])[0].z for e in before if not e.is_saturation
        ]
        threshold = with_misfit(self._limits.second, max(alone, default=0.0))
        for effect in before:
            others = [e for e in self.chosen if e is not effect]
            if not others:
                continue
            z = self._z_of(effect, others) if effect.is_saturation else score_tests(others, [effect])[0].z
            if z < threshold:
                # The leads hold beside the same terms only.
                self.chosen, self.leads = others, {}
        for saturation in (e for e in bounded if e not in self.chosen):
            # An expansion about parameters with a saturation does not show what the flights do beyond it.
            self._expand(self._with_chosen(saturation.without(self.expansion.parameters)))

    def _z_of(self, saturation: Effect, others: Sequence[Effect]) -> float:
        """Return the z of a saturation beside the others, both hypotheses fitted with the filter run anew."""
        short, parameters = first_parts(self.records, SHORT_S), self.expansion.parameters
        known, _ = refit(short, self._model, parameters, [*others, saturation])
        open_way, _ = refit(short, self._model, saturation.without(parameters), others)
        return deviate(2.0 * max(known - open_way, 0.0), len(saturation.columns))

    def _with_chosen(self, start: FilterParameters | None = None) -> FilterParameters:
        with self._fits.part():
            return refit(self.records, self._model, start or self.expansion.parameters, self.chosen)[1]

    def _expand(self, parameters: FilterParameters) -> None:
        """Expand about parameters. Where AR(1) noise explains more than any term or pattern, they include it,
        and the records' reference runs are redone."""
        with self._expansions.part():
            found = expand(self.records, self._model, parameters, self.chosen)
            beside = [found.own(c) for c in self.chosen]
            tests = found.score_tests(beside, [*found.effects, *found.patterns])
            correlated = with_ar1_noise(found, self.chosen, tests[0].nats if tests else 0.0)
            if correlated is not None:
                self.records = [recoloured(record, parameters, correlated) for record in self.records]
                found = expand(self.records, self._model, correlated, self.chosen)
        self.expansion, self.chosen = found, [found.own(c) for c in self.chosen]


def beyond(ranked: Sequence[ScoreTest], threshold: float) -> list[ScoreTest]:
    """Return the tests beyond the threshold, worthiest first; none where that of the most nats is below."""
    if not any(s.z >= threshold for s in ranked[:1]):
        return []
    return sorted((s for s in ranked if s.z >= threshold), key=lambda s: -s.worth)


def _doubtful(significant: Sequence[ScoreTest]) -> Sequence[ScoreTest]:
    """Return the candidates, best first, that must be fitted before one is chosen: all where the best is
    highly significant or has no size yet, those as good where it is nonlinear, none if one run decides."""
    best = significant[0]
    if best.z >= LINEAR_Z or best.effect.is_profiled:
        return significant
    alike = [s for s in significant if s.worth > best.worth - VERY_SIMILAR_NATS]
    return alike if best.z >= CURVED_Z and len({s.effect.name for s in alike}) > 1 else ()
