"""Consistency of a cause: its size in each flight, segment of time and channel by itself.

The innovations are independent, so their rows can be divided at will. If one size holds for all parts, the
score of each part beside the common sizes is chance. It is a chi-square with as many degrees of freedom as
the parts have sizes of their own. All common parameters (nuisances, sizes) are projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import segments
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import Effect
from slam.criticism.search.fitted_parameters import MEAN_NUISANCES, MEAN_PERTURBATIONS
from slam.criticism.search.inclusion import is_saturation, with_free_value
from slam.criticism.search.screening import deviate
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import with_misfit
from slam.criticism.threads import in_threads

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SEGMENT_S, MOST_SEGMENTS = 5.0, 1000
DISAGREE_Z = 4.0
MOST_EXCESS = 0.5
"""Share of the chi-square that a cause explains, beyond which its parts do not agree on one cause."""
WEAK = 1e-6
"""Share of the strongest part's information below which a part is no evidence for the size."""


@dataclass(frozen=True)
class PartConsistency:
    """Consistency of a cause between parts of the flights."""

    by: str
    """Kind of part: ``flight``, ``time`` or ``channel``."""
    z: float
    """Normal deviate of the chi-square of their differences."""
    excess: float
    """Excess of the chi-square over its expectation."""


def consistencies(
    records: Sequence[Record], model: FilterParameters, parameters: FilterParameters, chosen: Sequence[Effect]
) -> list[tuple[PartConsistency, ...]]:
    """Return consistencies for each chosen effect that moves the mean of the readings; none for the others.

    ``parameters`` include the effects at their sizes.
    """
    perturbations = [*MEAN_PERTURBATIONS, *(d for e in chosen for d in e.perturbations)]
    precision = np.zeros(len(perturbations))
    precision[: len(MEAN_NUISANCES)] = [n.prior_precision(model) for n in MEAN_NUISANCES]

    def one(k: int) -> tuple[Array, Array, Ints]:
        rows = list(segments(records[k], parameters, perturbations))
        events = np.concatenate([r.events for r in rows])
        time = (records[k].times_s[events] // SEGMENT_S).astype(np.int64)
        channels = np.concatenate([r.channels for r in rows])
        part = np.column_stack([np.full(len(events), k), MOST_SEGMENTS * k + time, channels])
        return np.concatenate([r.sensitivity for r in rows]), np.concatenate([r.white for r in rows]), part

    found = in_threads(one, range(len(records)))
    traces, white, part = (np.concatenate([f[i] for f in found]) for i in range(3))
    answers: list[tuple[PartConsistency, ...]] = []
    first = len(MEAN_NUISANCES)
    for effect in chosen:
        own = np.arange(first, first + len(effect.perturbations))
        first += len(effect.perturbations)
        if len(own) == 0:
            answers.append(())
            continue
        answers.append(
            tuple(
                _consistency(by, traces, white, part[:, i], own, precision)
                for i, by in enumerate(("flight", "time", "channel"))
            )
        )
    return answers


def _consistency(
    by: str, traces: Array, white: Array, part: Ints, own: Ints, precision: Array
) -> PartConsistency:
    total = traces.T @ traces + np.diag(precision + 1e-9)
    score = white @ traces
    step = np.linalg.solve(total, score)
    labels = np.unique(part)
    k = len(own)
    cross = np.zeros((len(labels) * k, len(total)))
    left, right = np.zeros((len(labels) * k, len(labels) * k)), np.zeros(len(labels) * k)
    for g, label in enumerate(labels):
        rows = traces[part == label]
        at = slice(g * k, (g + 1) * k)
        cross[at] = rows[:, own].T @ rows
        left[at, at] = cross[at][:, own]
        right[at] = white[part == label] @ rows[:, own] - cross[at] @ step
    left = left - cross @ np.linalg.solve(total, cross.T)
    scale = 1.0 / np.sqrt(np.tile(np.maximum(np.diag(total)[own], 1e-12), len(labels)))
    values, vectors = np.linalg.eigh(left * scale[:, None] * scale)
    strong = values > WEAK
    along = vectors[:, strong].T @ (scale * right)
    chi2 = float(np.sum(along**2 / values[strong]))
    degrees = int(strong.sum())
    return PartConsistency(by, deviate(chi2, degrees) if chi2 > degrees else 0.0, chi2 - degrees)


def contradictions(
    records: Sequence[Record], model: FilterParameters, found: SearchResult, parameters: FilterParameters
) -> tuple[dict[str, str], set[str]]:
    """Return descriptions of inconsistent causes, by name, and the names of causes that contradict themselves
    more than they explain.

    For an out-of-model vehicle every cause is inconsistent, as its equations are wrong.
    """
    chosen = [with_free_value(e) for e in found.chosen]
    descriptions, refuted = {}, set()
    for effect, parts in zip(found.chosen, consistencies(records, model, parameters, chosen), strict=True):
        worst = max(parts, key=lambda a: a.z, default=None)
        rest = [e for e in found.chosen if e is not effect]
        whole = found.last.score_tests(rest, [effect])[0]
        if worst is None or worst.z < with_misfit(DISAGREE_Z, 0.0 if is_saturation(effect) else whole.z):
            continue
        descriptions[effect.name] = f"is not the same in every {worst.by} (z = {worst.z:.1f})"
        if not is_saturation(effect) and max(a.excess for a in parts) > MOST_EXCESS * 2 * whole.nats:
            refuted.add(effect.name)
    return descriptions, refuted
