"""Explanation of flights without a command log: the errors by which instruments differ from each other.

Each effect is a column of the whitened rows of all comparisons. Effects that predict held-out parts are
tried, greatest first. Of these the set is chosen that explains most, and in which each effect stands out.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from slam.core.flight import Flight
from slam.core.progress import Progress
from slam.criticism.camera.reprojection import reprojection_errors
from slam.criticism.cause import Cause
from slam.criticism.extended import with_certainty, with_terms
from slam.criticism.finding import NameInDoubt, Onset
from slam.criticism.next_flight import next_motion
from slam.criticism.search.effects import LATE, Effect
from slam.criticism.search.information import SEGMENT_S
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import Thresholds
from slam.criticism.verdict.criticism import Criticism
from slam.criticism.verdict.held_out import CONFIRMED_NATS, held_out
from slam.criticism.verdict.judge import Evidence, JudgedCauses
from slam.criticism.verdict.over_time import PART_S, Parts, SizeOverTime, onset
from slam.criticism.verdict.posterior import doubtful_components, posterior_of, required_nats
from slam.criticism.verdict.rollouts import Covariate, covariate_of
from slam.criticism.without_commands.likelihood import fisher_of, likelihood_of
from slam.criticism.without_commands.sensor_comparison import SensorComparison, channel_errors
from slam.data_quality.axes import axes_of_all
from slam.data_quality.break_in_time import FEWEST_PARTS
from slam.data_quality.finding import Finding, Remark
from slam.data_quality.jumps import jumps_of_all
from slam.data_quality.whitened_rows import FlightRows, WhitenedRows, contradiction, table_of
from slam.simulation.model import Model

STANDS_OUT_Z = 4.0
STANDS_OUT = (
    "set by hand where instruments are compared with each other: of 150 simulated healthy cases the greatest "
    "reaches 3.2"
)
"""``python -m tests.benchmarks.criticism_thresholds 150 9000 --without-commands``."""
NOT_JUDGED = "instruments are compared with each other, and the vehicle's motion is not judged"
LIMITS = Thresholds(STANDS_OUT_Z, np.inf, STANDS_OUT_Z, np.inf, STANDS_OUT)
ENTERS_Z = 2.0
"""Least z of an effect that is tried: it may stand out only beside others, whose errors it is not."""
MOST = 8
"""Most effects that are tried together, because every set of them is compared."""
ROUNDS = 2


@dataclass(frozen=True, kw_only=True)
class ComparedFlights(Evidence):
    """Evidence of flights whose instruments were compared with each other."""

    flights: Sequence[Flight]
    sensors: SensorComparison
    rows: list[list[WhitenedRows]]
    """Rows of each flight, linear about the effects that were found."""
    why: str
    """Reason why the motion is not judged."""

    @cached_property
    def _axes(self) -> tuple[list[Remark], list[str]]:
        """Wrong axes, and descriptions of those that no flight shows."""
        return axes_of_all(self.flights)

    def _parts(self, part_s: float) -> Parts:
        """Return the rows in parts of some seconds: of less than a segment, by their own noise."""
        rows = [[r.by_own_noise() if part_s < SEGMENT_S else r for r in flight] for flight in self.rows]
        fisher, begin_s = fisher_of(rows, part_s)
        return Parts(fisher, [flight.name for flight in self.flights], begin_s, part_s)

    @cached_property
    def _varying(self) -> list[SizeOverTime]:
        """Sizes of the chosen terms that vary between segments by half of themselves."""
        found, chosen, parts = self.found.last, self.found.chosen, self._parts(SEGMENT_S)
        step = found.maximise(chosen).whole
        each = (parts.sizes_over_time(e, step, found.parameters) for e in chosen if e.is_term)
        return [series for of_effect in each for series in of_effect if series.varies]

    @cached_property
    def _onset(self) -> Onset | None:
        terms = [effect for effect in self.found.last.effects if effect.is_term]
        return onset(self.found.last, self.found.chosen, terms, self._parts(PART_S))

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """Return the chosen terms as causes, with errors without them and with the sizes by other parts."""
        found = self.found
        if not any(e.is_term for e in found.chosen):
            return ()
        together = held_out(found)
        errors = channel_errors(found, self.rows, together.by)
        each = zip(np.unique(found.last.fisher.flight), together.before, together.after, strict=True)
        seen = [(known, *of) for k, *of in each if (known := self.sensors.records[k]) is not None]
        errors += reprojection_errors(*zip(*seen, strict=True)) if seen else ()
        causes = self.causes_of(together, errors)
        return tuple(with_varying_sizes(cause, self._varying) for cause in causes)

    def findings(self, judged: JudgedCauses) -> Sequence[Finding]:
        """Return what no cause explains, residual patterns excepted."""
        return [
            *self._axes[0],
            *jumps_of_all(self.flights, self.sensors.lags),
            *self.readings,
            *(series.finding() for series in self._varying),
            *contradiction(self.rows),
            *([self._onset] if self._onset is not None else []),
            *(NameInDoubt(is_cause=False, effect=cause.name) for cause in judged.faint),
            *self._doubts(judged),
        ]

    def _doubts(self, judged: JudgedCauses) -> Iterator[Finding]:
        """Yield alternatives that these flights do not distinguish from a cause, and an implausible size."""
        last, chosen = self.found.last, self.found.chosen
        reported = {cause.name for cause in judged.reported}
        components = [doubt for doubt in doubtful_components(self.found) if doubt.effect in reported]
        yield from components
        doubted = {(doubt.effect, *doubt.others) for doubt in components}
        tests = last.score_tests(chosen, [e for e in last.effects if e.is_term])
        for test in (test for test in tests if test.z >= STANDS_OUT_Z):
            for effect in last.alike(test.effect, chosen):
                if effect.is_term and (effect.name, test.effect.name) not in doubted:
                    yield NameInDoubt(effect=effect.name, others=(test.effect.name,))
        if beyond := last.implausible_size(chosen, STANDS_OUT_Z):
            yield beyond

    def completed(self, found: Criticism) -> Criticism:
        """Return the criticism with the next flight, the extended model, and what could not be shown."""
        searched, rivals = self.found, found.equivalence_set[:2]
        advised = ""
        if rivals[1:]:
            matches = self.sensors.matches
            advised = next_motion(self.model, searched, self.rows, rivals, matches, self.progress)
        drawn = (covariate_in_comparisons(self.rows, searched, c) for c in found.causes[:1])
        return replace(
            found, next_flight=advised, covariate=next(drawn, None), changes=self._changes(),
            extended=with_certainty(with_terms(self.model, found.causes), found.causes),
            flights=tuple(f.name for f, known in zip(self.flights, self.rows, strict=True) if known),
            not_shown=self._not_shown(found.detectable),
            dropped=(*self.sensors.dropped, f"{self.why}: {NOT_JUDGED}"),
            limits=f"{self.why.capitalize()}: the vehicle's motion is not judged.",
        )  # fmt: skip

    def _changes(self) -> tuple[SizeOverTime, ...]:
        """Return the sizes over time of parameters that vary, or that change at a moment."""
        found, begun = self.found, self._onset
        if begun is None:
            return tuple(self._varying)
        effect = next(e for e in found.last.effects if begun.column in e.columns)
        beside = [*(e for e in found.chosen if not e.repeats(effect)), effect]
        step = found.last.maximise(beside).whole
        finer = self._parts(PART_S).sizes_over_time(effect, step, found.last.parameters)
        others = [s for s in self._varying if (s.effect, s.parameter) != (begun.effect, begun.parameter)]
        return (*others, *(s for s in finer if s.parameter == begun.parameter))

    def _not_shown(self, shown: Collection[str]) -> str:
        """Return a sentence on the errors that these flights could not show, whatever their size.

        ``shown``: terms that have a smallest detectable size. Nine of ten delays show from a size on.
        """
        last = self.found.last
        lines = ["a constant offset of speed or height", *self._axes[1]]
        lines += [e.name for e in last.effects if e.is_term and e.name not in shown]
        for effect in (e for e in last.effects if e.name in LATE):
            late_s = float(last.shown_sizes(effect, LIMITS.effects)[0])
            lines.append(f"{effect.name} by less than {1e3 * late_s:.0f} ms")
        times_s = np.concatenate([r.times_s for flight in self.rows for r in flight])
        if float(np.ptp(times_s)) < FEWEST_PARTS * PART_S:
            lines.append("an error that begins within a flight")
        return f"These flights could not show {', '.join(lines)}."


def explain_comparisons(
    flights: Sequence[Flight], readings: Sequence[Finding], model: Model, why: str, progress: Progress
) -> ComparedFlights | None:
    """Return the comparisons and the effects that explain them; None where no two instruments compare.
    Pictures are linear only near the truth: their rows are computed anew about what was found."""
    sensors = SensorComparison.of(flights, model, progress)
    rows = sensors.rows({})
    if not any(rows):
        return None
    found = search_linear(likelihood_of(rows, sensors.parameters))
    if sensors.matches is not None and found.chosen:
        for _ in range(ROUNDS):
            rows = sensors.rows(found.last.sizes(found.chosen))
            found = search_linear(likelihood_of(rows, sensors.parameters))
    return ComparedFlights(
        found=found, posterior=posterior_of(found), limits=LIMITS, anomalies=sensors.anomalies,
        readings=readings, model=model, progress=progress, flights=flights, sensors=sensors, rows=rows,
        why=why,
    )  # fmt: skip


def search_linear(found: SearchResult) -> SearchResult:
    """Choose the significant effects, greatest first, by one expansion, without those that others replace."""
    for least_z in (ENTERS_Z, STANDS_OUT_Z):
        while len(found.chosen) < MOST and (best := _best(found, found.chosen, least_z)) is not None:
            found = replace(found, chosen=(*found.chosen, best))
        found = _significant(found)
    for effect in found.chosen:
        rest = tuple(e for e in found.chosen if e is not effect)
        found = replace(found, chosen=(*rest, _best(found, rest, STANDS_OUT_Z, effect) or effect))
    return found


def _significant(found: SearchResult) -> SearchResult:
    """Return the chosen effects that explain most together while each stands out beside the others. To drop
    the least significant one first may lose another that explains far more."""

    def worth(kept: SearchResult) -> float:
        return found.last.nats(kept.chosen, found.chosen) - sum(map(required_nats, kept.chosen))

    every = (s for count in range(len(found.chosen) + 1) for s in combinations(found.chosen, count))
    kept = sorted((replace(found, chosen=s) for s in every), key=worth, reverse=True)
    return next(filter(_all_stand_out, kept))


def _all_stand_out(found: SearchResult) -> bool:
    return all(found.z_of(e) >= STANDS_OUT_Z for e in found.chosen)


def _best(
    found: SearchResult, rest: tuple[Effect, ...], least_z: float, place: Effect | None = None
) -> Effect | None:
    """Return the effect that explains most beside the ``rest``, of those that stand out and predict held-out
    parts; None where there is none, or none but the one in ``place``.

    Effects that look alike are alternatives: together they would be large, one against the other. A term that
    led alone may lag behind another beside the rest. Another takes its place only if it explains the greater
    part of what that explains, and if all effects stand out with it.
    """
    tests = found.last.score_tests
    for test in tests(rest, found.last.effects):
        if test.effect is place:
            break
        more = replace(found, chosen=(*rest, test.effect))
        if test.z < least_z or found.last.alike(test.effect, rest):
            continue
        if held_out(more, rest).total < CONFIRMED_NATS:
            continue
        left = tests(more.chosen, [place])[0].nats if place else 0.0
        if place is None or (2.0 * left < tests(rest, [place])[0].nats and _all_stand_out(more)):
            return test.effect
    return None


def with_varying_sizes(cause: Cause, varying: Sequence[SizeOverTime]) -> Cause:
    """Widen the intervals of sizes that vary between segments: each must hold the sizes of most segments, as
    another error comes and goes there, not their mean."""
    parameters = dict(cause.parameters)
    for series in (s for s in varying if s.effect == cause.name):
        p, factor = parameters[series.parameter], float(np.sqrt(len(series.sizes)))
        low, high = p.value - factor * (p.value - p.low), p.value + factor * (p.high - p.value)
        parameters[series.parameter] = replace(p, low=low, high=high)
    return replace(cause, parameters=parameters)


def covariate_in_comparisons(rows: FlightRows, found: SearchResult, lead: Cause) -> Covariate | None:
    """Return covariates of the leading cause and its rival in differences; None for single readings."""
    cause, rival = lead.name, lead.rival
    if all(e.name != cause for e in found.chosen):
        return None
    known = {e.name: e for e in found.last.effects}
    rest = [e for e in found.chosen if e.name != cause]
    models = {"": rest, cause: [*rest, known[cause]]} | ({rival: [*rest, known[rival]]} if rival else {})
    off = np.concatenate([r.off for flight in rows for r in flight])
    kind = np.concatenate([np.full(len(r.off), r.kind) for flight in rows for r in flight])
    pooled = {}
    for name, effects in models.items():
        sizes = found.last.sizes(effects)
        left = off - table_of(rows, list(sizes)) @ np.array(list(sizes.values()))
        pooled[name] = {(k, "sigma"): left[kind == k] for k in np.unique(kind).tolist()}
    return covariate_of(pooled, cause, rival)
