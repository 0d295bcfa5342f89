"""Consistency of a cause: its size in each flight, time and channel.

If one size holds everywhere, the score of each part beside the common sizes is chance. It is a chi-square
with as many degrees of freedom as the parts have sizes of their own. All common parameters (nuisances, sizes)
are projected out.
"""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np
from scipy.linalg import block_diag

from frontend.cores import in_threads
from slam.core.arrays import Array, Ints
from slam.criticism.finding import Inconsistency
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import Run
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import Effect
from slam.criticism.search.fitted_parameters import MEAN_NUISANCES, MEAN_PERTURBATIONS, fitted_parameter
from slam.criticism.search.information import SEGMENT_S, FisherInformation
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import deviate, with_misfit
from slam.criticism.verdict.over_time import PART_S, RIDGE, Parts, SizeOverTime

MOST_PARTS = 1000
"""Greatest number of parts of a flight."""
DISAGREE_Z = 4.0
MOST_EXCESS = 0.5
"""Share of the chi-square that a cause explains, beyond which its parts do not agree on one cause."""
WEAK = 1e-6
"""Share of the strongest part's information below which a part is no evidence for the size."""
_BETWEEN = "from flight to flight", "during a flight", "from channel to channel"
"""The parts that a cause is compared between, in the order of `_parts_of`."""


def inconsistencies(
    records: Sequence[Record], model: FilterParameters, parameters: FilterParameters, chosen: Sequence[Effect]
) -> list[list[Inconsistency]]:
    """Return how much each chosen effect that moves the mean of the readings disagrees between parts, of each
    kind where that is more than chance; none for the others.

    ``parameters`` include the effects at their sizes.
    """
    parts = list(zip(_BETWEEN, _parts_of(records, parameters, chosen), strict=True))
    precision = _precision(model, parts[0][1].fisher.columns)
    ends = np.cumsum([len(MEAN_NUISANCES), *(len(e.perturbations) for e in chosen)])
    return [
        [x for by, p in parts if len(own) and (x := _inconsistency(effect, by, p.fisher, own, precision))]
        for effect, own in zip(chosen, np.split(np.arange(ends[-1]), ends)[1:-1], strict=True)
    ]


def _parts_of(
    records: Sequence[Record], parameters: FilterParameters, chosen: Sequence[Effect]
) -> list[Parts]:
    """Return the flights by each kind of parts of ``_BETWEEN``; channels have neither a flight nor a time."""
    perturbations = [*MEAN_PERTURBATIONS, *(d for e in chosen for d in e.perturbations)]

    def one(k: int) -> tuple[Array, Array, Ints]:
        rows = list(Run(records[k], parameters, perturbations).segments(SEGMENT_S))
        events = np.concatenate([r.events for r in rows])
        time = (records[k].times_s[events] // PART_S).astype(np.int64)
        channels = np.concatenate([r.channels for r in rows])
        part = np.column_stack([np.full(len(events), MOST_PARTS * k), MOST_PARTS * k + time, channels])
        return np.concatenate([r.sensitivity for r in rows]), np.concatenate([r.white for r in rows]), part

    found = in_threads(one, range(len(records)))
    sensitivity, white, part = (np.concatenate([f[i] for f in found]) for i in range(3))
    columns, names = [d.name for d in perturbations], [record.name for record in records]
    parts = []
    for of_row in part.T:
        labels, place = np.unique(of_row, return_inverse=True)
        fisher = FisherInformation.of_rows(columns, sensitivity, white, place, labels // MOST_PARTS)
        parts.append(Parts(fisher, names, np.asarray(PART_S * (labels % MOST_PARTS))))
    return parts


def _precision(model: FilterParameters, columns: Sequence[str]) -> Array:
    """Return (columns,) the precision of the prior of each, of which the first are the nuisances'."""
    of_nuisances = [n.prior_precision(model) for n in MEAN_NUISANCES]
    return np.pad(of_nuisances, (0, len(columns) - len(of_nuisances))) + RIDGE


def _most_probable(fisher: FisherInformation, precision: Array) -> tuple[Array, Array]:
    """Return the step to the most probable sizes, and the information with that of the priors."""
    total = fisher.information.sum(axis=0) + np.diag(precision)
    return np.linalg.solve(total, fisher.score.sum(axis=0)), total


def _inconsistency(
    effect: Effect, between: str, fisher: FisherInformation, own: Ints, precision: Array
) -> Inconsistency | None:
    """Return by how much more than chance an effect's columns ``own`` disagree between segments, or None."""
    step, total = _most_probable(fisher, precision)
    cross = fisher.information[:, own].reshape(-1, len(total))
    left = block_diag(*fisher.information[:, own[:, None], own]) - cross @ np.linalg.solve(total, cross.T)
    right = fisher.left_at(step)[:, own].ravel()
    scale = 1.0 / np.sqrt(np.tile(np.maximum(np.diag(total)[own], 1e-12), len(fisher.score)))
    values, vectors = np.linalg.eigh(left * scale[:, None] * scale)
    strong = values > WEAK
    along = vectors[:, strong].T @ (scale * right)
    chi2 = float(np.sum(along**2 / values[strong]))
    degrees = int(strong.sum())
    if chi2 <= degrees:
        return None
    return Inconsistency(between, chi2 - degrees, effect=effect.name, z=deviate(chi2, degrees))


def contradictions(
    found: SearchResult, parameters: FilterParameters
) -> tuple[dict[str, Inconsistency], set[str]]:
    """Return the inconsistencies of causes, by name, and the names of causes that contradict themselves more
    than they explain.

    For an out-of-model vehicle every cause is inconsistent, as its equations are wrong.
    """
    chosen = [e.free for e in found.chosen]
    inconsistent, refuted = {}, set()
    of_effects = inconsistencies(found.records, found.model, parameters, chosen)
    for effect, parts in zip(found.chosen, of_effects, strict=True):
        worst = max(parts, key=lambda a: a.z, default=None)
        rest = [e for e in found.chosen if e is not effect]
        whole = found.last.score_tests(rest, [effect])[0]
        if worst is None or worst.z < with_misfit(DISAGREE_Z, 0.0 if effect.is_saturation else whole.z):
            continue
        inconsistent[effect.name] = worst
        if not effect.is_saturation and max(a.excess for a in parts) > MOST_EXCESS * 2 * whole.nats:
            refuted.add(effect.name)
    return inconsistent, refuted


def changing_sizes(
    records: Sequence[Record], model: FilterParameters, parameters: FilterParameters,
    chosen: Sequence[Effect], names: Container[str],
) -> tuple[SizeOverTime, ...]:  # fmt: skip
    """Return the sizes over time of the chosen causes of some ``names``; ``parameters`` include them."""
    _, parts, _ = _parts_of(records, parameters, chosen)
    step, _ = _most_probable(parts.fisher, _precision(model, parts.fisher.columns))
    series: list[SizeOverTime] = []
    for effect in (e for e in chosen if e.name in names):
        held = np.array([fitted_parameter(d.name).size_in(parameters) for d in effect.perturbations])
        series += parts.sizes_over_time(effect, step, parameters, held)
    return tuple(series)
