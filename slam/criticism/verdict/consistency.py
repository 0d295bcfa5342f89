"""Consistency of a cause: its size in each flight, time and channel.

If one size holds everywhere, the score of each part beside the common sizes is chance. It is a chi-square
with as many degrees of freedom as the parts have sizes of their own. All common parameters (nuisances, sizes)
are projected out. Where instruments are compared with each other, errors are correlated, and small
differences are significant: there only a size that varies by half of itself counts.
"""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np
from scipy.linalg import block_diag

from backend.measurements import GRAVITY_M_S2
from frontend.cores import in_threads
from slam.core.arrays import Array, Ints
from slam.criticism.finding import Inconsistency, VaryingSize
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import Run
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import Effect, is_variance
from slam.criticism.search.fitted_parameters import MEAN_NUISANCES, MEAN_PERTURBATIONS, fitted_parameter
from slam.criticism.search.information import SEGMENT_S, FisherInformation
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import deviate, with_misfit
from slam.criticism.verdict.over_time import PART_S, TELLING, Parts, SizeOverTime
from slam.simulation.terms import CATALOGUE

MOST_PARTS = 1000
"""Greatest number of parts of a flight."""
DISAGREE_Z = 4.0
MOST_EXCESS = 0.5
"""Share of the chi-square that a cause explains, beyond which its parts do not agree on one cause."""
WEAK = 1e-6
"""Share of the strongest part's information below which a part is no evidence for the size."""
RIDGE = 1e-9
FEWEST_SIZES = 5
BEYOND_CHANCE = 4.0
"""Mean square of the segments' deviations, in variances of white rows, beyond which a size varies."""
LARGE = 0.5
"""Least scatter beyond chance, as a share of the size."""
LEVEL = ("accel_bias.x", "accel_bias.y")
"""Columns along which an attitude error acts like an error of the accelerometer."""
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
    z = deviate(chi2, degrees) if chi2 > degrees else 0.0
    return Inconsistency(between, chi2 - degrees, effect=effect.name, z=z) if z > 0.0 else None


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


def disagreements(found: SearchResult) -> list[VaryingSize]:
    """Return the parameters of the chosen terms that vary between segments by half of themselves."""
    varying = []
    for effect in (e for e in found.chosen if e.is_term):
        for name, sizes in varying_sizes(found, effect).items():
            k = effect.columns.index(name)
            parameter = CATALOGUE[effect.name].parameter(effect.parameters[k])
            off_deg = float(np.degrees(np.arctan(np.ptp(sizes) / GRAVITY_M_S2))) * (name in LEVEL)
            at = found.last.parameters
            least, most = (effect.in_catalogue_units(k, x, at) for x in (sizes.min(), sizes.max()))
            varying.append(VaryingSize(
                least, most, parameter.unit, SEGMENT_S, off_deg, effect=effect.name, parameter=parameter.name
            ))  # fmt: skip
    return varying


def varying_sizes(found: SearchResult, effect: Effect) -> dict[str, Array]:
    """Return column -> (segments,) sizes, of the parameters of a chosen term that vary between segments by
    half of themselves, with all other terms at their common sizes."""
    quadratic, fisher = found.last.quadratic, found.last.fisher
    step, own = quadratic.maximise(found.chosen).whole, quadratic.index(effect.columns)
    others = np.where(np.isin(np.arange(len(step)), own), 0.0, step)
    score = fisher.left_at(others)[:, own]
    information = fisher.information[:, own[:, None], own]
    information = information * (1.0 + RIDGE * np.eye(len(own))) + 1e-12 * np.eye(len(own))
    sizes = np.linalg.solve(information, score[:, :, None])[:, :, 0]
    errors = np.sqrt(np.diagonal(np.linalg.inv(information), axis1=1, axis2=2))
    varying = {}
    for k, (name, perturbation) in enumerate(zip(effect.columns, effect.perturbations, strict=True)):
        if is_variance(perturbation):
            continue  # a variance naturally differs from segment to segment
        common = abs(float(step[own[k]]))
        sure = errors[:, k] < TELLING * max(common, effect.tolerance)
        if sure.sum() < FEWEST_SIZES:
            continue
        known, chance = sizes[sure, k], float(np.mean(errors[sure, k] ** 2))
        variance = float(np.var(known, ddof=1))
        scatter = float(np.sqrt(max(variance - chance, 0.0)))
        if variance > BEYOND_CHANCE * chance and scatter > LARGE * common:
            varying[name] = known
    return varying


def changing_sizes(
    records: Sequence[Record], model: FilterParameters, parameters: FilterParameters,
    chosen: Sequence[Effect], names: Container[str],
) -> tuple[SizeOverTime, ...]:  # fmt: skip
    """Return the sizes over time of the chosen causes of some ``names``; ``parameters`` include them."""
    _, parts, _ = _parts_of(records, parameters, chosen)
    step, _ = _most_probable(parts.fisher, _precision(model, parts.fisher.columns))
    doubted = [(e, k) for e in chosen if e.name in names for k in range(len(e.perturbations))]
    held = [fitted_parameter(e.columns[k]).size_in(parameters) for e, k in doubted]
    each = zip(doubted, held, strict=True)
    return tuple(parts.sizes_over_time(e, k, step, parameters, x) for (e, k), x in each)
