"""Terms that change single readings, not their mean.

These are spikes, quantisation and a dead zone of the sonar, lost pictures, moving objects and highlights.
They are mixtures: each anomalous reading adds its log likelihood ratio against a healthy instrument, in nats.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.special import expit

from slam.core.arrays import Array
from slam.criticism.cause import WIDE, Cause, Gain, Interval
from slam.criticism.kalman.filter import OUTLIER, USED
from slam.criticism.kalman.innovations import FilterPass
from slam.criticism.kalman.readings import RANGE, SONAR
from slam.criticism.kalman.record import Record
from slam.criticism.search.thresholds import ONE_OF_ALL, parameter_cost
from slam.data_quality.frozen import at_least_value, lowest_run
from slam.data_quality.lost_pictures import HEALTHY_LOSS, LOST_NATS, LostPictures, share_for, smallest_share
from slam.data_quality.pictures.highlights import are_lamps, strength_of
from slam.data_quality.pictures.moving_objects import passes_of
from slam.data_quality.quantisation import STEP_STD_M, Quantisation, quantisation_of, strongest_step
from slam.simulation.terms import CATALOGUE

_Flight = TypeVar("_Flight")

SECOND_ECHO = (1.6, 2.4)
"""Limits of a spike: its ratio to the predicted range."""
FEWEST_SPIKES, NATS_A_SPIKE = 2, 9.0
"""Evidence of a reading ten deviations off or more, even with Student's tails, less its rarity's cost."""
ENTAILS = {"sonar_quantisation": ("sonar_noise out of range",), "sonar_spikes": ("sonar_noise out of range",)}
"""Nuisance findings that an anomaly explains."""
LIMIT_STD_M = 0.01
NATS_A_REPEAT = 4.0
NATS_A_PAIR = 9.0


def cause_in_readings(
    name: str, sizes: dict[str, Interval], nats: Sequence[float], by_others: Sequence[float] = ()
) -> Cause:
    """Return the cause that single readings show, with the ``nats`` of each flight at the common sizes.

    ``by_others`` are those at the sizes of the others; none where no size enters or there are no others.
    """
    total = sum(nats)
    lead = float(total - parameter_cost(1) - ONE_OF_ALL)
    gain = Gain.of(np.array(by_others or nats), "flight" if by_others else None)
    return Cause(name, float(expit(lead)), sizes, gain, float(np.sqrt(2 * max(total, 0.0))), lead)


def without_dead_zone(records: Sequence[Record]) -> tuple[list[Record], list[Cause]]:
    """Return the records without the readings of a dead zone, and the dead zone if there is one.

    Quantised readings repeat themselves without one.
    """
    if quantisation_in(records) is not None:
        return list(records), []
    stuck, kept = [], []
    for record in records:
        rows = np.flatnonzero(record.kinds == SONAR)
        at = at_least_value(record.values[rows, 0])
        stuck.append(record.values[rows[at], 0])
        values = record.values.copy()
        values[rows[at], 0] = np.nan
        kept.append(replace(record, values=values) if at.any() else record)
    if not any(map(len, stuck)):
        return list(records), []
    size = _sized("sonar_dead_zone", float(np.median(np.concatenate(stuck))), LIMIT_STD_M)

    def beside(own: Array, others: Sequence[Array]) -> float:
        """Return the nats of the flight's repeated readings at the others' limit."""
        limit = np.concatenate(others)
        near = np.abs(own - np.median(limit)) < 2.0 * LIMIT_STD_M if len(limit) else np.zeros(len(own), bool)
        return NATS_A_REPEAT * float(near.sum())

    nats = [NATS_A_REPEAT * float(len(own)) for own in stuck]
    return kept, [cause_in_readings("sonar_dead_zone", size, nats, predicted_by_others(stuck, beside))]


def predicted_by_others(
    flights: Sequence[_Flight], nats: Callable[[_Flight, Sequence[_Flight]], float]
) -> tuple[float, ...]:
    """Return ``nats`` of each flight with the size of all others; empty without others."""
    if len(flights) < 2:
        return ()
    return tuple(nats(own, [*flights[:k], *flights[k + 1 :]]) for k, own in enumerate(flights))


def reading_anomalies(passes: Sequence[FilterPass]) -> list[Cause]:
    """Return all anomalies but the dead zone, from the readings and a filter run."""
    records = [run.record for run in passes]
    return [
        *_spikes(passes), *_quantised(records), *_dropped(records), *_moving_objects(records),
        *_highlights(records),
    ]  # fmt: skip


def _dropped(records: Sequence[Record]) -> list[Cause]:
    """Return the lost pictures, a Poisson number estimated from gaps between stamps."""
    counts = [(m.missing, m.taken) if (m := r.matches) is not None else (0, 0) for r in records]
    flights = [LostPictures(float(lost), float(lost + taken)) for lost, taken in counts]
    lost = sum(flight.lost for flight in flights)
    if lost == 0.0:
        return []
    share = lost / sum(flight.due for flight in flights)

    def beside(own: LostPictures, others: Sequence[LostPictures]) -> float:
        """Return the nats of the flight's losses at the others' share; a flight without losses is healthy."""
        gone, due = (sum(part) for part in zip(*((f.lost, f.due) for f in others), strict=True))
        return own.nats(max(gone / max(due, 1.0), HEALTHY_LOSS))

    nats = [flight.nats(share) for flight in flights]
    if share < HEALTHY_LOSS or sum(nats) < LOST_NATS:
        return []
    size = _sized("dropped_frames", share, share / float(np.sqrt(lost)))
    return [cause_in_readings("dropped_frames", size, nats, predicted_by_others(flights, beside))]


def _highlights(records: Sequence[Record]) -> list[Cause]:
    """Return the highlights: lamps mirrored in the floor."""
    seen = [
        np.zeros((0, 3)) if r.matches is None or r.matches.lens_distortion.notable else r.matches.spots
        for r in records
    ]
    every = np.concatenate(seen)
    if not are_lamps(every):
        return []
    strength, low, high = strength_of(every)
    nats = [NATS_A_PAIR * float(np.sum(flight[:, 0] > 0)) for flight in seen]
    return [cause_in_readings("specular_highlights", {"strength": Interval(strength, "1", low, high)}, nats)]


def _moving_objects(records: Sequence[Record]) -> list[Cause]:
    seen = (record.matches for record in records)
    passes = [passes_of(m.moving_s) if m is not None and not m.uneven else [] for m in seen]
    found = sum(map(len, passes))
    if found == 0:
        return []
    size = _sized("moving_objects", float(found), float(np.sqrt(found)), least=1.0)
    return [cause_in_readings("moving_objects", size, [NATS_A_PAIR * float(sum(p)) for p in passes])]


def _spikes(passes: Sequence[FilterPass]) -> list[Cause]:
    counts, totals = [], []
    for run in passes:
        rows = run.record.kinds == SONAR
        due, read = run.states[rows, 2], run.record.values[rows, 0]
        outlier = run.status[rows, 0] == OUTLIER
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = read / due
        counts.append(int(np.sum(outlier & (ratio > SECOND_ECHO[0]) & (ratio < SECOND_ECHO[1]))))
        totals.append(int(np.sum(outlier | (run.status[rows, 0] == USED))))
    count, total = sum(counts), sum(totals)
    if count < FEWEST_SPIKES:
        return []
    size = _sized("sonar_spikes", count / total, float(np.sqrt(count)) / total)
    return [cause_in_readings("sonar_spikes", size, [NATS_A_SPIKE * c for c in counts])]


def ranges_of(records: Sequence[Record]) -> Array:
    """Return (n,) the ranges of all sonars, in metres."""
    every = np.concatenate([r.values[r.kinds == SONAR, 0] for r in records])
    return np.asarray(every[np.isfinite(every)])


def quantisation_in(records: Sequence[Record]) -> Quantisation | None:
    """Return the step that the ranges are multiples of; None without one."""
    return quantisation_of(ranges_of(records), float(np.median([r.noise_std[RANGE] for r in records])))


def _quantised(records: Sequence[Record]) -> list[Cause]:
    found = quantisation_in(records)
    if found is None:
        return []
    size = _sized("sonar_quantisation", found.step_m, STEP_STD_M)
    nats = tuple(len(ranges_of([record])) * found.strength**2 for record in records)
    by_others = predicted_by_others(records, nats_by_others)
    return [cause_in_readings("sonar_quantisation", size, nats, by_others)]


def nats_by_others(own: Record, others: Sequence[Record]) -> float:
    """Return the nats of a flight's ranges for the step of the others."""
    ranges, step = ranges_of([own]), strongest_step(ranges_of(others))
    return step.nats_of(ranges) if step is not None and len(ranges) else 0.0


def _sized(term: str, value: float, std: float, least: float = 0.0) -> dict[str, Interval]:
    """Return the size of a term's first parameter."""
    size = CATALOGUE[term].parameters[0]
    return {size.name: Interval(value, size.unit, max(value - WIDE * std, least), value + WIDE * std)}


def smallest_in_readings(records: Sequence[Record]) -> dict[str, tuple[float, str]]:
    """Return name -> size and unit of a sonar's second echoes and dead zone, and of lost pictures."""
    found = {
        "sonar_spikes": share_for(FEWEST_SPIKES, len(ranges_of(records))),
        "sonar_dead_zone": min(lowest_run(r.values[r.kinds == SONAR, 0]) for r in records),
        "dropped_frames": smallest_share(sum(r.matches.taken for r in records if r.matches is not None)),
    }
    return {n: (size, CATALOGUE[n].parameters[0].unit) for n, size in found.items() if np.isfinite(size)}
