"""Statistical power of flights: the smallest detectable sizes of terms, and terms that look alike."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import LikelihoodExpansion
from slam.criticism.search.fitted_parameters import AT
from slam.criticism.search.quadratic_likelihood import NINE_OF_TEN, SEEN
from slam.criticism.verdict.criticism import CORRELATION_DIGITS
from slam.simulation.terms import CATALOGUE

CONFUSED = 0.9
LEAST_SHARE = 1e-6
"""Least share of a column's information that the nuisances must leave for it to be seen."""


def detectable(expansion: LikelihoodExpansion, threshold: float) -> dict[str, tuple[float, str]]:
    """Return the smallest size of each term that nine of ten cases would have shown, and its unit."""
    found: dict[str, tuple[float, str]] = {}
    for effect in expansion.effects:
        if not effect.is_term or effect.is_profiled:
            continue
        sizes = expansion.shown_sizes(effect, threshold)
        # The component of a vector that shows least decides.
        k = int(np.argmax(sizes))
        size = float(sizes[k])
        value, neutral = (effect.in_catalogue_units(k, x, expansion.parameters) for x in (size, 0.0))
        value = abs(value - neutral)
        parameter = CATALOGUE[effect.name].parameter(effect.parameters[k])
        if np.isfinite(value) and value < 10 * max(abs(parameter.most), abs(parameter.least)):
            kept = found.get(effect.name)
            found[effect.name] = (min(value, kept[0]) if kept else value), parameter.unit
    tried = [e for e in expansion.effects if e.is_saturation and e.is_profiled]
    variances = [expansion.fitted(e, expansion.maximise([e]))[1][0, 0] for e in tried]
    each = zip(tried, variances, strict=True)
    stands_out = [e for e, variance in each if variance**-0.5 > threshold + NINE_OF_TEN]
    shown = [(float(e.columns[0].partition(AT)[2]), e.name) for e in stands_out]
    # The highest limit that shows is the smallest effect.
    return found | {name: (limit, "rad") for limit, name in sorted(shown)}


def confusable(expansion: LikelihoodExpansion) -> tuple[tuple[str, str, float], ...]:
    """Return pairs of terms whose sensitivities, nuisances projected out, correlate beyond ``CONFUSED``."""
    # Without a score every nuisance stays in its range, so that its prior alone holds it.
    fisher = replace(expansion.fisher, score=np.zeros_like(expansion.fisher.score))
    expansion = replace(expansion, fisher=fisher)
    seen: dict[str, Effect] = {}
    for effect in expansion.effects:
        if not effect.is_term or effect.is_profiled or effect.relaxes or effect.name in seen:
            continue
        _, covariance = expansion.maximise([effect]).of(effect.columns, white=True)
        information = np.diag(expansion.information)[expansion.index(effect.columns)]
        left = np.diag(np.linalg.inv(covariance))
        if ((information > SEEN) & (left > LEAST_SHARE * information)).all():
            seen[effect.name] = effect
    pairs = [(a, b, expansion.correlation(seen[a], seen[b])) for a, b in combinations(sorted(seen), 2)]
    return most_alike_first(p for p in pairs if p[2] > CONFUSED)


def most_alike_first(pairs: Iterable[tuple[str, str, float]]) -> tuple[tuple[str, str, float], ...]:
    """Sort pairs by their correlation as told, equal ones by name: rounding errors change no order."""
    return tuple(sorted(pairs, key=lambda pair: (-round(pair[2], CORRELATION_DIGITS), pair[:2])))


def within_reach(detectable: Mapping[str, tuple[float, str]]) -> dict[str, float]:
    """Return the terms that would have shown at a usual size, the most sharply tested first.

    Each has its smallest size as a share of the greatest usual one.
    """
    shares = {}
    for name, (size, unit) in detectable.items():
        sizes = [p for p in CATALOGUE[name].parameters if p.unit == unit]
        usual = max(max(abs(p.low - p.neutral), abs(p.high - p.neutral)) for p in sizes)
        # The lower a limit, the greater is its effect.
        shares[name] = sizes[0].low / size if sizes[0].is_limit else size / usual
    return dict(sorted((item for item in shares.items() if item[1] <= 1.0), key=lambda item: item[1]))
