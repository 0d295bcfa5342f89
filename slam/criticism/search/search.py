"""The search: look at the flights under a belief, take the term that explains most, look again.

Small effects need one look: everything is linear about the healthy vehicle. Where a term stands out by more,
the best candidates are fitted with the filter run anew (Gauss-Newton), the best of them enters the belief,
and the flights are looked at from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from slam.core.progress import Progress, Tally, silent
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.reference import recoloured
from slam.criticism.search.ar1_noise import ar1_effects, with_ar1_noise, without_small_ar1
from slam.criticism.search.candidates import best_candidate
from slam.criticism.search.effects import Effect
from slam.criticism.search.evidence import VERY_SIMILAR_NATS, parameter_cost
from slam.criticism.search.expansion import LikelihoodExpansion, ScoreTest, expand
from slam.criticism.search.fitting import first_seconds, fit_nuisances, refit
from slam.criticism.search.inclusion import (
    is_profiled,
    is_saturation,
    with_free_value,
    without_effect,
    without_saturation,
)
from slam.criticism.search.pairs import mask_each_other, masked_pair
from slam.criticism.search.screening import deviate
from slam.criticism.search.thresholds import Thresholds, with_misfit
from slam.simulation.terms import CATALOGUE

LINEAR_Z = 25.0
"""Beyond this candidates are fitted with the filter run anew before one is chosen."""
CURVED_Z = 6.0
"""Beyond this the size of what was chosen needs the filter run anew: a landing bends the trace."""
MOST_TERMS = 6
STAGES = ("fit", "look", "try causes")
SHORT_S = 80.0
"""Candidates are compared on so much of the flights: they all stand out by far."""
PART_S = 160.0
"""What stands out by far needs no look at more of the flights than this, where there is twice as much."""


@dataclass(frozen=True)
class SearchResult:
    """What was found."""

    model: FilterParameters
    first: LikelihoodExpansion
    """About the healthy vehicle."""
    last: LikelihoodExpansion
    """About the belief with large effects in it; the first look where there are none."""
    chosen: tuple[Effect, ...]
    rivals: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """For terms that the filter chose by runs anew: names that fitted as well then."""
    leads: dict[tuple[str, str], float] = field(default_factory=dict)
    """Labels of a chosen term and of another -> nats of evidence that the first leads by in its place, both
    fitted with the filter run anew."""
    records: tuple[Record, ...] = ()
    """The flights as the looks have them: referred to the colour that was found."""


def with_term_replaced(
    records: Sequence[Record], found: SearchResult, place: Effect, candidates: Sequence[Sequence[Effect]]
) -> SearchResult:
    """The search with one of some sets of terms in place of a chosen one, fitted with the filter run anew; as
    it was where none explains more.

    A term enters as it looks from the healthy vehicle; what others would do in its place shows only from
    there.
    """
    rest = [e for e in found.chosen if e is not place]
    bare = without_effect(place, found.last.setting)
    old, _ = refit(records, found.model, found.last.setting, found.chosen)
    old -= parameter_cost(len(place.columns))
    fits = []
    for others in candidates:
        nats, setting = refit(records, found.model, bare, [*rest, *others])
        cost = sum(parameter_cost(len(e.columns)) for e in others) + (len(others) - 1) * np.log(
            len(CATALOGUE)
        )
        fits.append((nats - cost, others, setting))
    best, others, setting = max(fits, key=lambda fit: fit[0])
    gained = best - old
    chosen = [with_free_value(e) for e in (*rest, *others)]
    alike = abs(gained) < VERY_SIMILAR_NATS
    if gained <= 0.0:
        if len(others) == 1:
            return replace(found, leads=found.leads | {(place.label, others[0].label): -gained})
        rivals = {place.name: tuple(e.name for e in others)} if alike else {}
        return replace(found, rivals=found.rivals | rivals)
    expansion = expand(records, found.model, setting, chosen)
    leads = found.leads | {(others[0].label, place.label): gained} if len(others) == 1 else {}
    rivals = found.rivals | {e.name: (place.name,) if alike else () for e in others}
    return replace(
        found, last=expansion, chosen=tuple(expansion.own(c) for c in chosen), rivals=rivals, leads=leads
    )


def search(
    records: Sequence[Record], model: FilterParameters, limits: Thresholds, progress: Progress = silent
) -> SearchResult:
    """Terms that stand out by more than the thresholds beside each other, best first."""
    way = _SequentialSearch(records, model, limits, progress)
    first = way.expansion
    while (setting := way.next_belief()) is not None:
        way.look_from(setting)
    if (way.expansion.setting.noise_correlation != first.setting.noise_correlation).any():
        # With and without the terms noise is the same.
        first = way.healthy(replace(first.setting, noise_correlation=way.expansion.setting.noise_correlation))
    most = len(way.chosen)
    way.drop_superfluous()
    # Beside one term less, too.
    leads = way.leads if len(way.chosen) == most else {}
    return SearchResult(model, first, way.expansion, tuple(way.chosen), way.rivals, leads, tuple(way.records))


class _SequentialSearch:
    """From one belief to the next: the terms that were chosen so far, and how the flights look from there."""

    def __init__(
        self, records: Sequence[Record], model: FilterParameters, limits: Thresholds, progress: Progress
    ) -> None:
        self._fits, self._looks, self._tries = (Tally(progress, stage) for stage in STAGES)
        self.records, self._model, self._limits = records, model, limits
        self.chosen: list[Effect] = []
        self.rivals: dict[str, tuple[str, ...]] = {}
        self.leads: dict[tuple[str, str], float] = {}
        self._fitted, self._greatest = True, 0.0
        self._far = LINEAR_Z
        """``LINEAR_Z``, or what is left of it where the look is at the first parts of the flights."""
        with self._fits.part():
            setting = fit_nuisances(records, model, effects=ar1_effects(model))
        self._see(setting)

    def next_belief(self) -> FilterParameters | None:
        """Choose until something must be fitted before one can tell more: the belief with all that is chosen;
        None where nothing more stands out."""
        while True:
            significant = self._significant()
            full = len(self.chosen) == MOST_TERMS
            if self._far < LINEAR_Z and (full or not by_much(significant, self._far)):
                self._expand_all(self.expansion.setting)
                continue
            if not self.chosen and (both := self._hidden(significant)):
                self.chosen, self._fitted = list(both), False
                continue
            if not significant or full:
                return None if self._fitted else self._with_chosen()
            self._greatest = max(self._greatest, significant[0].z)
            # Beside one term more those before it lead by more, or less.
            self.leads = {}
            if doubtful := _doubtful(significant, self._far):
                records = self.records
                if in_part := significant[0].z >= self._far:
                    records = [first_seconds(record, SHORT_S / len(records)) for record in records]
                best = best_candidate(
                    records, self._model, self.expansion, self.chosen, doubtful, self._tries
                )
                self.leads = {} if in_part else best.leads
                self.rivals[best.effect.name] = best.rivals
                self.chosen.append(best.effect)
                return best.setting
            self.chosen.append(significant[0].effect)
            if significant[0].effect.changes:
                # What makes noise larger bends far more than what moves a mean: beside it nothing shows.
                return self._with_chosen()
            self._fitted = self._fitted and significant[0].z < CURVED_Z

    def look_from(self, setting: FilterParameters) -> None:
        """A look about a belief that holds the chosen terms, nuisances fitted to it.

        Where another term stands out by far from where one came, the first parts of long flights will do.
        """
        long = sum(record.duration_s for record in self.records) / PART_S
        part = long > 2.0 and by_much(self._significant(), self._far)
        self.chosen = [with_free_value(c) for c in self.chosen]
        if not part:
            self._expand_all(setting)
            return
        records = [first_seconds(record, PART_S / len(self.records)) for record in self.records]
        setting = self._fit(records, setting)
        with self._looks.part():
            self.expansion = expand(records, self._model, setting, self.chosen)
        self.chosen = [self.expansion.own(c) for c in self.chosen]
        self._far, self._fitted = max(LINEAR_Z / np.sqrt(long), CURVED_Z), True

    def healthy(self, setting: FilterParameters) -> LikelihoodExpansion:
        """A look about a belief without terms, nuisances fitted to it."""
        with self._fits.part():
            setting = fit_nuisances(self.records, self._model, setting)
        with self._looks.part():
            return expand(self.records, self._model, setting)

    def drop_superfluous(self) -> None:
        """Take out the terms that the others have made superfluous."""
        before = self.chosen
        self.chosen = _needed(self.records, self._model, self.expansion, before, self._limits)
        for saturation in (e for e in before if is_saturation(e) and e not in self.chosen):
            # What the flights do beyond a wall no look at the belief that holds it tells.
            self._see(self._with_chosen(without_saturation(saturation, self.expansion.setting)))

    def _significant(self) -> list[ScoreTest]:
        threshold = with_misfit(self._limits.second, self._greatest) if self.chosen else self._limits.effects
        return beyond(self.expansion.score_tests(self.chosen, self.expansion.effects), threshold)

    def _fit(self, records: Sequence[Record], setting: FilterParameters) -> FilterParameters:
        with self._fits.part():
            free = [*self.chosen, *ar1_effects(setting)]
            return without_small_ar1(fit_nuisances(records, self._model, setting, free))

    def _expand_all(self, setting: FilterParameters) -> None:
        self._see(self._fit(self.records, setting))
        self._far, self._fitted = LINEAR_Z, True

    def _hidden(self, significant: Sequence[ScoreTest]) -> Sequence[Effect] | None:
        """Two terms in place of what stands out by little, or of nothing."""
        if significant and significant[0].z >= CURVED_Z:
            return None
        return masked_pair(self.expansion, self._limits, significant)

    def _with_chosen(self, start: FilterParameters | None = None) -> FilterParameters:
        with self._fits.part():
            return refit(self.records, self._model, start or self.expansion.setting, self.chosen)[1]

    def _see(self, setting: FilterParameters) -> None:
        with self._looks.part():
            self.records, self.expansion = _seen(self.records, self._model, setting, self.chosen)
        self.chosen = [self.expansion.own(c) for c in self.chosen]


def beyond(ranked: Sequence[ScoreTest], threshold: float) -> list[ScoreTest]:
    """What stands out by more than the threshold, worthiest first; nothing where what explains most does not,
    or where there is nothing."""
    if not any(s.z >= threshold for s in ranked[:1]):
        return []
    return sorted((s for s in ranked if s.z >= threshold), key=lambda s: -s.worth)


def by_much(significant: Sequence[ScoreTest], z: float) -> bool:
    """Whether anything stands out, the worthiest by ``z`` at least."""
    return bool(significant) and significant[0].z >= z


def _doubtful(significant: Sequence[ScoreTest], far: float) -> Sequence[ScoreTest]:
    """The candidates, best first, that must be fitted before one is chosen: all of them where the best is far
    off or has no size yet, those as good as it where traces bend, none where one look tells."""
    best = significant[0]
    if best.z >= far or is_profiled(best.effect):
        return significant
    alike = [s for s in significant if s.worth > best.worth - VERY_SIMILAR_NATS]
    return alike if best.z >= CURVED_Z and len({s.effect.name for s in alike}) > 1 else ()


def _seen(
    records: Sequence[Record],
    model: FilterParameters,
    setting: FilterParameters,
    chosen: Sequence[Effect] = (),
) -> tuple[Sequence[Record], LikelihoodExpansion]:
    """The records and a look at them; where coloured noise explains more than any term or shape would, the
    belief has it, and the records are referred to that."""
    expansion = expand(records, model, setting, chosen)
    others = expansion.score_tests(
        [expansion.own(c) for c in chosen], [*expansion.effects, *expansion.patterns]
    )
    most_nats = others[0].nats if others else 0.0
    shaded = with_ar1_noise(records, model, setting, expansion.fisher.passes, chosen, most_nats)
    if shaded is None:
        return records, expansion
    records = [recoloured(record, setting, shaded) for record in records]
    return records, expand(records, model, shaded, chosen)


def _needed(
    records: Sequence[Record],
    model: FilterParameters,
    expansion: LikelihoodExpansion,
    chosen: list[Effect],
    limits: Thresholds,
) -> list[Effect]:
    """The chosen ones without those that the others have made superfluous."""
    kept = list(chosen)
    if (
        len(chosen) == 2
        and not any(is_saturation(e) for e in chosen)
        and mask_each_other(expansion, chosen, limits)
    ):
        return kept
    alone = [
        expansion.score_tests([o for o in chosen if o is not e], [e])[0].z
        for e in chosen
        if not is_saturation(e)
    ]
    threshold = with_misfit(limits.second, max(alone, default=0.0))
    for effect in chosen:
        others = [e for e in kept if e is not effect]
        if not others:
            continue
        if is_saturation(effect):
            z = _without(records, model, expansion, others, effect)
        else:
            z = expansion.score_tests(others, [effect])[0].z
        if z < threshold:
            kept = others
    return kept


def _without(
    records: Sequence[Record],
    model: FilterParameters,
    expansion: LikelihoodExpansion,
    others: Sequence[Effect],
    saturation: Effect,
) -> float:
    """How far a wall stands out beside the others, both ways fitted with the filter run anew."""
    short = [first_seconds(record, SHORT_S / len(records)) for record in records]
    known, _ = refit(short, model, expansion.setting, [*others, saturation])
    open_way, _ = refit(short, model, without_saturation(saturation, expansion.setting), others)
    return deviate(2.0 * max(known - open_way, 0.0), len(saturation.columns))


__all__ = ["SearchResult", "search", "with_term_replaced"]
