"""Decision on the verdict: nothing wrong, named, ambiguous, named with a remainder, or unknown."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit

from slam.criticism.camera.reprojection import reprojection_errors
from slam.criticism.cause import FAINT, LIKELY, SURE, Cause, ChannelError, Gain, Interval
from slam.criticism.finding import LateReadings, NameInDoubt, OutOfRange, ResidualPattern
from slam.criticism.kalman.filter_parameters import POINTS, FilterParameters
from slam.criticism.kalman.readings import STREAMS
from slam.criticism.search.effects import LATE, Effect
from slam.criticism.search.expansion import LikelihoodExpansion
from slam.criticism.search.fitted_parameters import fitted_parameter
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import MISFIT
from slam.criticism.verdict.criticism import Verdict
from slam.criticism.verdict.held_out import HeldOut, held_out
from slam.criticism.verdict.posterior import SOMETHING_ELSE, Posterior, required_nats
from slam.criticism.verdict.rollout_fit import FREE, RolloutFit
from slam.criticism.verdict.rollouts import rollout_errors
from slam.data_quality.finding import Finding, Remark
from slam.simulation.terms import CATALOGUE

CONFIRMED_NATS = 2.0
"""Least gain on held-out flights that confirms a term."""
PLAIN_Z = 8.0
"""Least z that chance does not reach; the term stays without confirmation by held-out flights."""
MOST_ALIKE = 4
"""Greatest number of names of an equivalence set."""
WIDE = 1.96
SCATTER = 1.25
"""Ratio of the scatter of found sizes about the truth to their standard error: found terms are selected, and
no noise is exactly as modelled. From 18 singles of ``python -m tests.blind.run --kinds single --seed 3
--flights 3 --seconds 30 --cases 33``."""


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
        least = min(gains, key=lambda g: g[0], default=(np.inf, None))
        if least[0] >= (CONFIRMED_NATS if len(chosen) > 1 else 0.0):
            break
        chosen = [e for e in chosen if e is not least[1]]
    return replace(found, last=found.last if chosen else found.first, chosen=tuple(chosen))


def errors_of(
    found: SearchResult, all_together: HeldOut, best: RolloutFit | None = None
) -> tuple[ChannelError, ...]:
    """Return errors of roll-outs and pictures without the chosen terms, and with ``all_together`` of them."""
    fitted_by_others = all_together.before, all_together.after if best is None else best.left_out
    channels = rollout_errors(found.records, *fitted_by_others)
    perturbations = [d for e in found.chosen if e.is_term for d in e.perturbations]
    if any(d.kind == "camera" and d.entry < POINTS for d in perturbations):
        channels = (*channels, *reprojection_errors(found.records, *fitted_by_others))
    return channels


def causes_of(
    found: SearchResult,
    posterior: Posterior,
    all_together: HeldOut,
    channels: tuple[ChannelError, ...],
    best: RolloutFit | None = None,
) -> tuple[Cause, ...]:
    """Return the chosen terms of the catalogue as causes, with sizes by roll-outs where ``best`` is given.

    ``all_together``: their gain on held-out flights. ``channels``: errors without and with them.
    """
    causes = []
    for effect, place in zip(found.chosen, posterior.places, strict=True):
        if not effect.is_term:
            continue
        rest = [e for e in found.chosen if e is not effect]
        # Only the first expansion describes the flights without a saturation.
        own = held_out(found, rest) if rest and not effect.is_saturation else all_together
        cause = Cause(
            name=effect.name,
            probability=posterior.probability.get(effect.name, 0.0),
            parameters=fitted_sizes(found.last, effect, found.chosen),
            gain=Gain.of(own.nats, own.by, channels),
            z=found.z_of(effect),
            lead_nats=place.lead_nats,
            alternatives=place.names,
            rival=place.rival,
        )
        causes.append(cause if best is None else _with_rollout_size(cause, effect, best))
    return tuple(causes)


def _with_rollout_size(cause: Cause, effect: Effect, best: RolloutFit) -> Cause:
    """Return the cause with its size by roll-outs, and with their gain where they raised its probability."""
    sizes = {}
    for k, (name, column) in enumerate(zip(effect.parameters, effect.columns, strict=True)):
        # A term that roll-outs do not fit keeps its current value.
        current = 0.0 if column in FREE else fitted_parameter(column).size_in(best.parameters)
        sizes[name] = _interval(effect, k, WIDE * best.std.get(column, 0.0), best.parameters, current)
    found = replace(cause, parameters=sizes)
    parts = np.array(best.nats.get(effect.name, ()))
    if rollout_probability(best, effect) < cause.probability - 1e-9:
        return found
    return replace(found, gain=Gain.of(parts, cause.gain.by, cause.gain.channels))


def rollout_probability(best: RolloutFit, effect: Effect) -> float:
    """Return the probability of a term, its alternatives among them, by held-out roll-outs."""
    return float(expit(sum(best.nats.get(effect.name, ())) - required_nats(effect)))


def split_by_probability(
    causes: Sequence[Cause],
    found: SearchResult,
    posterior: Posterior,
    doubted: Container[str],
    left_z: float = 0.0,
) -> tuple[tuple[Cause, ...], tuple[Cause, ...]]:
    """Divide causes into those probable enough to be reported, and the faint ones.

    ``left_z`` is the z of the strongest residual pattern, if it is significant. Where something else than a
    term is there, some causes are at even odds a part of that: inconsistent ones (``doubted``), those that
    worsen roll-outs, and process noise, which any unmodelled motion raises. Causes below ``left_z`` may be a
    part of it as well. For an out-of-model vehicle some pattern is always more probable than any equation:
    odds are not shared with it.
    """
    if posterior.probability[SOMETHING_ELSE] > SURE and not found.model.out_of_model:
        noise_only = {e.name for e in found.chosen if e.changes}
        causes = [
            replace(c, probability=0.5 * c.probability)
            if c.name in doubted or c.name in noise_only or c.gain.flies_worse or c.z < left_z
            else c
            for c in causes
        ]
    faint = tuple(c for c in causes if c.with_alternatives(posterior.probability) < FAINT)
    return tuple(c for c in causes if c not in faint), faint


def by_importance(causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """Sort causes. The probable cause that explains most leads; the others follow by probability, as told. A
    cause that only single readings show has no gain ahead, so it leads only where no other is probable."""
    lead = sorted(causes, key=lambda c: (c.probability <= LIKELY, not c.gain.channels, -c.gain.nats))[:1]
    rest = sorted(causes, key=lambda c: (-round(c.probability, 2), not c.gain.channels, -c.gain.nats))
    return (*lead, *(c for c in rest if c is not lead[0]))


def fitted_sizes(
    expansion: LikelihoodExpansion, effect: Effect, chosen: Sequence[Effect]
) -> dict[str, Interval]:
    """Return fitted parameters of a term in the catalogue's units, with 95 % intervals.

    The intervals include chance, widened by the scatter of simulated singles, and the equation's own misfit.
    """
    size, covariance = expansion.fitted(effect, expansion.maximise(chosen, judged=1))
    wide = expansion.fisher.half_interval if expansion.clustered else WIDE * SCATTER
    found = {}
    for k, name in enumerate(effect.parameters):
        half = wide * float(np.hypot(np.sqrt(covariance[k, k]), effect.tolerance))
        found[name] = _interval(effect, k, half, expansion.parameters, float(size[k]))
    return found


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
    pattern, which is told of something unknown that is nowhere else.
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
    if lead.gain.nats < CONFIRMED_NATS:
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
    if effect.name not in LATE:
        return ResidualPattern.of(effect.name)
    size, _ = found.last.fitted(effect, found.last.maximise(found.chosen))
    return LateReadings(float(size[0]), channel=STREAMS[LATE[effect.name][0]])
