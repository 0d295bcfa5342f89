"""Posterior of the causes, with "nothing" and "something unknown" always among the hypotheses.

Hypotheses are the chosen set, the set without one of its terms, and the set with one of them replaced. Any
other term replaces it, or any residual pattern that these flights can separate from the term. A single effect
in place of several is one too. Each weighs its maximum likelihood, its parameters' cost, and its prior.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import softmax

from slam.criticism.finding import NameInDoubt
from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import ONE_CLASS, LikelihoodExpansion, ScoreTest
from slam.criticism.search.search import LINEAR_Z, SearchResult, with_term_replaced
from slam.criticism.search.thresholds import KNOWN, ONE_OF_ALL, UNKNOWN, VERY_SIMILAR_NATS

NOTHING, SOMETHING_ELSE = "nothing", "unknown"
CLASS_NATS = 10.0
"""Lead in nats of one of two terms that look alike (``ONE_CLASS``), beyond which its form is evidence for it.
Of a lesser one the share VERY_SIMILAR_NATS / CLASS_NATS counts in the probabilities: an alternative is never
beside a probability of 1.00."""
LAGS = 0.05
"""Share of a component's nats by which another term may lag behind it and still be as good an explanation. A
scale of 0.1 of the accelerometer, put into measured flights, lags by 0.014 to 0.027 behind a bias."""
SAME_TRACE = 0.9
"""Correlation beyond which a pattern counts as a term itself: a range by the climb rate is a lag."""


@dataclass(frozen=True)
class Place:
    """Alternatives to one chosen term."""

    names: tuple[str, ...]
    """Its own name, then those of terms that explain as much; last those without an entry in ``leads``, which
    fitted as well with the filter run anew, whatever an expansion shows of them."""
    lead_nats: float
    """Lead over the best other term, with the cost of the parameters."""
    rival: str
    """The most probable other term; empty where there is none."""
    weights: tuple[tuple[float, frozenset[str]], ...] = ()
    """Evidence of the chosen set without the term, and with each other in its place."""
    leads: Mapping[str, float] = field(default_factory=dict)
    """Alternative -> nats by which the term leads."""


@dataclass(frozen=True)
class Posterior:
    """Probabilities of names, and the alternatives to each chosen effect."""

    probability: dict[str, float]
    """Probability of every term, also of each of a pair, and of ``nothing`` and ``unknown``."""
    places: tuple[Place, ...] = ()
    """Alternatives to each chosen effect."""

    def raised(self, known: Mapping[str, float], tied: Mapping[str, Sequence[str]]) -> Posterior:
        """Return the posterior with greater probabilities of terms, as ``known`` otherwise, each shared
        equally with the ``tied`` alternatives to the term. What is left is for the others."""
        probability = dict(self.probability)
        for name, *others in (place.names for place in self.places):
            same = [name, *(n for n in others if n in tied.get(name, ()))]
            total = known.get(name, 0.0)
            if total > probability.get(name, 0.0) * len(same):
                left = {n: min(probability.get(n, 0.0), 1.0 - total) for n in others}
                probability |= left | dict.fromkeys(same, total / len(same))
        return replace(self, probability=probability)


def required_nats(effect: Effect) -> float:
    """Return the nats that held-out flights must gain before a term is more probable than not."""
    return effect.cost + ONE_OF_ALL


def posterior_of(found: SearchResult, refuted: Container[str] = ()) -> Posterior:
    """Return the probabilities beside the last expansion; ``refuted`` terms are no alternatives."""
    expansion, chosen = found.last, list(found.chosen)
    places = [_at_saturation(found, e) if e.is_saturation else _at_term(found, e, refuted) for e in chosen]
    weights = [
        (_evidence(expansion, chosen, chosen), _names(chosen)),
        *(w for place in places for w in place.weights),
    ]
    if not chosen or (len(chosen) > 1 and not any(e.is_saturation for e in chosen)):
        weights += _in_place_of_all(found)
    probability = probabilities(weights)
    for place in places:
        name, *tied = (n for n in place.names if n not in place.leads)
        share = probability.get(name, 0.0) / (1 + len(tied))
        probability |= {n: max(share, probability.get(n, 0.0)) for n in tied} | {name: share}
    # What explains more in the place of another term is no alternative to this one.
    least = {n: min(p.leads.get(n, np.inf) for p in places) for place in places for n in place.leads}
    names = [tuple(n for n in p.names if p.leads.get(n, 0.0) <= least.get(n, 0.0)) for p in places]
    return Posterior(probability, tuple(replace(p, names=own) for p, own in zip(places, names, strict=True)))


def _in_place_of_all(found: SearchResult) -> list[tuple[float, frozenset[str]]]:
    """Return the evidence of nothing, and of one effect in place of several.

    Of the expansions about the final parameters and about the healthy vehicle, the better one counts for each
    effect. Parameters with more noise hide what would be missed without it.
    """
    expansions = [found.first] if any(e.changes for e in found.chosen) else [found.last, found.first]
    nothing = _evidence(expansions[0], [], found.chosen) + _over(found, expansions[0])
    best = {"": (nothing, _names([]))}
    for expansion in expansions:
        over, among = _over(found, expansion), (*expansion.effects, *expansion.patterns)
        for effect, evidence in _beside(expansion, [], among, found.chosen):
            known = best.get(effect.label)
            if known is None or evidence + over > known[0]:
                best[effect.label] = evidence + over, _names([effect])
    return list(best.values())


def _over(found: SearchResult, expansion: LikelihoodExpansion) -> float:
    """Return the nats of an expansion's parameters above the last one's, before anything is fitted."""
    return float(expansion.fisher.log_likelihood.sum() - found.last.fisher.log_likelihood.sum())


def _at_saturation(found: SearchResult, saturation: Effect) -> Place:
    """Return the alternatives to a saturation, which the search compared by running the filter anew."""
    chosen = {e.name for e in found.chosen}
    tied = tuple(n for n in found.rivals.get(saturation.name, ()) if n not in chosen)
    if tied:
        return Place((saturation.name, *tied), 0.0, tied[0])
    # The term that explains most in its place, by the expansion without it: the first.
    others = [e for e in found.first.effects if e.is_term and e.name not in chosen]
    best = next((s.effect.name for s in found.first.score_tests([], others)[:1] if s.nats > 0.0), "")
    return Place((saturation.name,), np.inf, best)


def _at_term(found: SearchResult, term: Effect, refuted: Container[str]) -> Place:
    # Where it adds noise, what it explains shows without it only.
    expansion = found.without([term.name]).last if term.changes else found.last
    own, over = _evidence(found.last, found.chosen, found.chosen), _over(found, expansion)
    chosen, term = [expansion.own(e) for e in found.chosen], expansion.own(term)
    rest = [e for e in chosen if e is not term]
    weights = [(_evidence(expansion, rest, chosen) + over, _names(rest))]

    def repeats_term(e: Effect) -> bool:
        """Whether it is a residual pattern that these flights cannot separate from the term."""
        is_pattern = term.is_term and not (e.is_term or e.relaxes)
        return is_pattern and expansion.correlation(term, e, rest) > SAME_TRACE

    among = [
        e for e in (*expansion.effects, *expansion.patterns)
        if not (e.name in refuted or any(map(e.repeats, chosen)) or repeats_term(e))
    ]  # fmt: skip
    tried = [
        (effect, found.leads.get((term.label, effect.label), own - evidence - over))
        for effect, evidence in _beside(expansion, rest, among, chosen)
    ]
    best: dict[str, tuple[float, Effect]] = {}
    for effect, lead in sorted(tried, key=lambda one: (round(one[1], 6), one[0].name)):
        if effect.is_term and effect.name not in {c.name for c in chosen}:
            best.setdefault(effect.name, (lead, effect))
    close = [n for n, (lead, _) in best.items() if lead < CLASS_NATS]
    one_class = {n for n in close if expansion.correlation(term, best[n][1], rest) > ONE_CLASS}
    for effect, lead in tried:
        counted = lead * VERY_SIMILAR_NATS / CLASS_NATS if effect.name in one_class and lead > 0.0 else lead
        weights.append((own - counted, _names([*rest, effect])))
    # What explains nothing is no alternative, however little the term itself explains.
    near = {
        n: lead for n, (lead, _) in best.items()
        if (lead < VERY_SIMILAR_NATS or n in one_class) and own - lead > weights[0][0]
    }  # fmt: skip
    tied = tuple(n for n in found.rivals.get(term.name, ()) if n in best and n not in near)
    lead_nats = 0.0 if tied else min((lead for lead, _ in best.values()), default=np.inf)
    rival = next(iter([*near, *tied, *best]), "")
    return Place((term.name, *near, *tied), lead_nats, rival, tuple(weights), near)


def doubtful_components(found: SearchResult) -> list[NameInDoubt]:
    """Return the components of chosen vectors that another term explains as well.

    Over a hover a constant error of the vertical acceleration is a scale as well, whatever is known of the
    other two components.
    """
    last, doubts = found.last, []
    names = {e.name for e in found.chosen}
    others = [e for e in last.effects if e.is_term and len(e.columns) == 1 and e.name not in names]
    own = last.maximise(found.chosen).nats
    for effect in (e for e in found.chosen if e.is_term and len(e.columns) == len(e.perturbations) > 1):
        parts = [
            replace(effect, perturbations=(moved,), parameters=(name,))
            for moved, name in zip(effect.perturbations, effect.parameters, strict=True)
        ]
        for one in parts:
            beside = [e for e in (*found.chosen, *parts) if e is not effect and e is not one]
            explained = own - last.maximise(beside).nats
            if explained <= CLASS_NATS:
                continue
            least = explained - max(VERY_SIMILAR_NATS, LAGS * explained)
            doubts += [
                NameInDoubt((test.effect.name,), effect=effect.name, parameter=one.parameters[0])
                for test in last.score_tests(beside, others)
                if test.nats > max(least, 0.0) and last.correlation(one, test.effect, beside) > ONE_CLASS
            ]
    return doubts


def likeliest(found: SearchResult, posterior: Posterior) -> SearchResult:
    """Return the search result with chosen terms replaced by more probable ones, each by one or two."""
    tried: set[tuple[str, str]] = set()
    while other := likelier_term(found, posterior, tried):
        place, name = other
        tried.add((place.name, name))
        found = with_term_replaced(found, place, [(e,) for e in found.last.effects if e.name == name])
        posterior = posterior_of(found)
    for place in found.chosen:
        if pairs := likelier_pairs(found, place):
            found = with_term_replaced(found, place, pairs)
        if place not in found.chosen:
            break
    return found


def likelier_term(
    found: SearchResult, posterior: Posterior, tried: Container[tuple[str, str]] = ()
) -> tuple[Effect, str] | None:
    """Return a chosen term and the name of a more probable one in its place, not ``tried`` yet, or None."""
    for effect, place in zip(found.chosen, posterior.places, strict=False):
        if effect.is_term and not effect.is_saturation and not effect.changes:
            names = [n for n in place.names if (effect.name, n) not in tried]
            best = max(names, key=lambda n: posterior.probability.get(n, 0.0))
            if posterior.probability.get(best, 0.0) > posterior.probability.get(effect.name, 0.0):
                return effect, best
    return None


def likelier_pairs(found: SearchResult, place: Effect) -> list[tuple[Effect, ...]]:
    """Return pairs of terms that seem more probable in place of a chosen one, by either expansion.

    A nonlinear term, such as a ground effect, shows too much of what is lost without it from the last one.
    """
    if place.is_saturation or place.changes:
        return []
    dearer = ONE_OF_ALL if place.is_term else 0.0
    pairs = []
    for expansion in (found.first, found.last):
        rest = [expansion.own(e) for e in found.chosen if e is not place]
        own = expansion.score_tests(rest, [expansion.own(place)])[0]
        best = next(iter(expansion.ranked_pairs(rest, place)), None)
        if best and (expansion is found.last or own.z < LINEAR_Z) and best.worth - dearer > own.worth:
            pairs.append(best.effects)
    return pairs


def _evidence(expansion: LikelihoodExpansion, effects: Sequence[Effect], chosen: Sequence[Effect]) -> float:
    """Return a set's log likelihood, with its prior and cost, as compared with the ``chosen`` set."""
    return expansion.nats(effects, chosen) + _prior(expansion)(effects)


def _beside(
    expansion: LikelihoodExpansion, rest: Sequence[Effect], among: Sequence[Effect], chosen: Sequence[Effect]
) -> list[tuple[Effect, float]]:
    """Return the evidence of a set with each of some more effects, compared with the ``chosen`` set. An
    effect that gains nothing, or has the wrong sign, only costs."""
    prior, base = _prior(expansion), expansion.nats(rest, chosen)

    def nats(test: ScoreTest) -> float:
        if not expansion.clustered or test.nats == 0.0:
            return base + test.nats
        return expansion.nats([*rest, test.effect], chosen)

    return [(s.effect, nats(s) + prior([*rest, s.effect])) for s in expansion.score_tests(rest, among)]


def _prior(expansion: LikelihoodExpansion) -> Callable[[Sequence[Effect]], float]:
    """Return the log prior of a set, less the cost of its parameters."""
    # A term that is tried in several ways, such as a delay, is no more probable for it.
    ways = Counter(e.name for e in expansion.effects if e.is_term)
    others = len(expansion.patterns) + len(expansion.effects) - ways.total()

    def of(effects: Sequence[Effect]) -> float:
        shares = (KNOWN / len(ways) / ways[e.name] if e.is_term else UNKNOWN / others for e in effects)
        return float(sum(map(np.log, shares)) - sum(e.cost for e in effects))

    return of


def _names(effects: Sequence[Effect]) -> frozenset[str]:
    return frozenset(e.name if e.is_term else SOMETHING_ELSE for e in effects) or frozenset([NOTHING])


def probabilities(weights: Sequence[tuple[float, frozenset[str]]]) -> dict[str, float]:
    """Return the probability of each name from the evidence in nats of hypotheses: sets of names."""
    total: dict[str, float] = {NOTHING: 0.0, SOMETHING_ELSE: 0.0}
    for p, (_, names) in zip(softmax([nats for nats, _ in weights]), weights, strict=True):
        for name in names:
            # Rounding errors must not make a probability exceed 1: halved, it would be above even odds.
            total[name] = min(total.get(name, 0.0) + float(p), 1.0)
    return total
