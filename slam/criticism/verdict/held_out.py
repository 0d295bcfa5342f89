"""Gain in prediction on flights that the sizes were not fitted to.

For each flight (or segment, where there are fewer than three flights) nuisances and sizes are fitted on all
others. The gain is the difference of its log likelihoods with and without the terms, in nats. Each is
averaged over the uncertainty of the others: where they do not show an effect, its size is only a guess.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slam.core.arrays import Array, Ints, Mask
from slam.criticism.kalman.filter import IGNORED
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import whole
from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import LikelihoodExpansion
from slam.criticism.search.fitted_parameters import with_steps
from slam.criticism.search.information import FisherInformation
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import SIZE_PRIOR

FEWEST_FLIGHTS = 3
PATTERN_KINDS = ("channel", "force", "picture")
CONFIRMED_NATS = 2.0
"""Least gain on held-out flights that confirms a term."""
PLAIN_Z = 8.0
"""Least z that chance does not reach; the term stays without confirmation by held-out flights."""
ALONE_NATS = 0.5
"""Nats of readings that only one of two parameter sets judges, beyond which the flights are run anew."""


@dataclass(frozen=True)
class HeldOut:
    """Gains of each held-out part."""

    nats: Array
    """(parts,)."""
    by: str
    """``flight`` or ``segment``."""
    before: tuple[FilterParameters, ...]
    """Parameters without the terms for each flight, fitted on the other parts."""
    after: tuple[FilterParameters, ...]

    @property
    def total(self) -> float:
        """Sum of the gains."""
        return float(self.nats.sum())


def parts_of(flight: Ints) -> tuple[Ints, str]:
    """Return (segments,) the part of each segment, and the kind of part, ``flight`` or ``segment``."""
    if len(np.unique(flight)) >= FEWEST_FLIGHTS:
        return flight, "flight"
    return np.arange(len(flight)) % max(min(len(flight), 6), 1), "segment"


def held_out(found: SearchResult, without: Sequence[Effect] = ()) -> HeldOut:
    """Return the gain of the chosen terms over ``without`` (by default over none of them)."""
    last = found.last
    base, begin = (found.first, ()) if not without else (last, tuple(without))
    part, by = parts_of(last.fisher.flight)
    plain_nats, known_nats = _of_the_same_readings(base.fisher, last.fisher)
    of_one_alone = (last.fisher.log_likelihood - known_nats) - (base.fisher.log_likelihood - plain_nats)
    nats, fitted_by_others = [], dict[int, tuple[FilterParameters, FilterParameters]]()
    for k in np.unique(part):
        own, others = part == k, part != k
        if not others.any():
            others = own
        before_nats, before = _prediction(base, begin, own, others)
        after_nats, after = _prediction(last, found.chosen, own, others)
        gain = after_nats + known_nats[own].sum() - before_nats - plain_nats[own].sum()
        if np.abs(of_one_alone[own]).sum() > ALONE_NATS and not any(r.matches for r in found.records):
            gain = _gain_rerun(found, own, before, after)
        nats.append(gain)
        fitted_by_others |= dict.fromkeys(np.unique(last.fisher.flight[own]).tolist(), (before, after))
    each = [fitted_by_others[flight] for flight in sorted(fitted_by_others)]
    return HeldOut(np.array(nats), by, tuple(p for p, _ in each), tuple(p for _, p in each))


def _prediction(
    expansion: LikelihoodExpansion, effects: Sequence[Effect], own: Mask, others: Mask
) -> tuple[float, FilterParameters]:
    """Return the log likelihood of the segments ``own`` above the expansion's parameters, averaged over the
    uncertainty of a fit on ``others``, and the most probable parameters by these."""
    # The prior of a size has the standard deviation of the evidence's, no less than the size found.
    maximum = expansion.maximise(effects)
    reach: dict[str, float] = {}
    for effect in effects:
        size, covariance = expansion.fitted(effect, maximum)
        std = np.sqrt(SIZE_PRIOR * np.diag(covariance) + size**2).tolist()
        reach |= {c: x for c, x in zip(effect.columns, std, strict=True) if c not in effect.relaxes}
    fitted = expansion.over(others).maximise(effects, reach)
    judged = expansion.over(own)
    return judged.predicted(fitted), with_step(expansion, fitted.whole, effects)


def _gain_rerun(found: SearchResult, own: Mask, before: FilterParameters, after: FilterParameters) -> float:
    """Return the gain of some segments from one parameter set to another, with the filter run anew.

    Only readings that both judge count. An expansion includes the readings that were judged there. A
    touch-down that one parameter set alone judges can outweigh all others.
    """
    gain, fisher = 0.0, found.last.fisher
    for k in np.unique(fisher.flight[own]).tolist():
        runs = [whole(found.records[k], parameters) for parameters in (before, after)]
        both = np.logical_and(*(run.status != IGNORED for run in runs))
        by_event = np.where(both, runs[1].nats - runs[0].nats, 0.0).sum(axis=1)
        gain += float(fisher.by_segment(k, by_event)[own[fisher.flight == k]].sum())
    return gain


def _of_the_same_readings(one: FisherInformation, other: FisherInformation) -> tuple[Array, Array]:
    """Return (segments,) log likelihoods of two expansions, without readings that either did not judge.

    Readings near the floor, or near the outlier gate, are judged under one parameter set and not under
    another. No reading may count in one alone.
    """
    nats = one.log_likelihood.copy(), other.log_likelihood.copy()
    if one is other:
        return nats
    for k, runs in enumerate(zip(one.passes, other.passes, strict=True)):
        judged = [run.status != IGNORED for run in runs]
        for side, run in enumerate(runs):
            alone = judged[side] & ~judged[1 - side]
            by_event = np.where(alone, run.nats, 0.0).sum(axis=1)
            nats[side][one.flight == k] -= one.by_segment(k, by_event)
    return nats


def with_step(expansion: LikelihoodExpansion, step: Array, effects: Sequence[Effect]) -> FilterParameters:
    """Return the expansion's parameters after a step of all columns."""
    skip = {e.columns[0] for e in effects if e.is_profiled}
    # No filter parameters hold a pattern.
    skip |= {d.name for e in effects for d in e.perturbations if d.kind in PATTERN_KINDS}
    each = zip(expansion.fisher.columns, step.tolist(), strict=True)
    return with_steps(
        expansion.parameters, ((column, x) for column, x in each if x != 0.0 and column not in skip)
    )


def fitted_parameters(found: SearchResult, effects: Sequence[Effect]) -> FilterParameters:
    """Return the most probable parameters with some effects at the last expansion."""
    return with_step(found.last, found.last.maximise(effects).whole, effects)


def confirmed_terms(found: SearchResult) -> SearchResult:
    """Return the search without terms that held-out flights do not confirm beside the others, weakest first.

    A highly significant term stays, confirmed or not: something is there. Without any term the expansion is
    that of the healthy vehicle.
    """
    chosen = list(found.chosen)
    while any(e.is_term for e in chosen):
        gains = []
        tried = replace(found, chosen=tuple(chosen))
        for effect in (e for e in chosen if e.is_term):
            rest = [e for e in chosen if e is not effect]
            # No expansion about parameters with a saturation can test it beside others.
            if not (effect.is_saturation and rest) and tried.z_of(effect) < PLAIN_Z:
                gains.append((held_out(tried, rest).total, effect))
        least, weakest = min(gains, key=lambda g: g[0], default=(np.inf, None))
        if least >= (CONFIRMED_NATS if len(chosen) > 1 else 0.0):
            break
        chosen = [e for e in chosen if e is not weakest]
    return found.without([e.name for e in found.chosen if e not in chosen])
