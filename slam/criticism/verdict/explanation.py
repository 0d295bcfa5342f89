"""Explanation of the flights: the most probable set of terms, what contradicts it, and its sizes."""

from __future__ import annotations

from dataclasses import dataclass, replace

from slam.core.progress import Progress
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.consistency import contradictions
from slam.criticism.verdict.decision import confirmed_terms, rollout_probability
from slam.criticism.verdict.held_out import fitted_parameters
from slam.criticism.verdict.posterior import Posterior, likeliest, posterior_of
from slam.criticism.verdict.rollout_fit import RolloutFit, fit_rollouts


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


def explain(found: SearchResult, progress: Progress) -> Explanation:
    """Compare what was found with all alternatives, and return what is more probable than these."""
    records, nominal = found.records, found.model
    found = confirmed_terms(records, found)
    posterior = posterior_of(found)
    reported = likeliest(records, found, posterior)
    parameters = fitted_parameters(reported, reported.chosen)
    doubts, refuted = contradictions(records, nominal, reported, parameters)
    if refuted:
        reported = replace(reported, chosen=tuple(e for e in reported.chosen if e.name not in refuted))
        parameters = fitted_parameters(reported, reported.chosen)
    best = None
    if nominal.out_of_model and reported.chosen and len(records) > 1:
        best = fit_rollouts(records, parameters, reported.first.parameters, reported, progress)
        reported, parameters = replace(reported, chosen=best.chosen), best.parameters
    if reported is not found:
        posterior = posterior_of(reported)
    if best is not None:
        known = {e.name: rollout_probability(best, e) for e in reported.chosen}
        posterior = posterior.raised(known, reported.rivals)
    return Explanation(reported, parameters, posterior, doubts, best)
