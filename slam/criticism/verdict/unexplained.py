"""Findings that no cause explains, in words, and errors that flights without commands could not show.

Findings without commands belong to no term: wrong axes, frozen, rounded or oscillating streams, an onset, a
delay. Each is reported with its channel, its shape, its time and its size.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from slam.core.flight import Flight
from slam.criticism.cause import Cause
from slam.criticism.kalman.record import Record
from slam.criticism.residuals.unmodelled import outliers_of, uneven_of, vibration_of
from slam.criticism.search.effects import LATE
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.consistency import FEWEST_SEGMENTS, ONSET_SEGMENT_S, disagreements, onset
from slam.criticism.verdict.rollout_fit import RolloutFit
from slam.criticism.verdict.tables import NINE_OF_TEN
from slam.criticism.without_commands.axes import wrong_axes
from slam.criticism.without_commands.likelihood import columns_of, fisher_of, segments_of
from slam.criticism.without_commands.pictures import contradiction
from slam.criticism.without_commands.whitened_rows import WhitenedRows
from slam.data_quality import StreamAnomaly
from slam.data_quality.channels import noise_ratio, streams_of

NOISY = 3.0
"""Least ratio of noise to the stated figure that is reported: half an order of magnitude."""
COULD_NOT = "These flights could not show"


def left_over(
    records: Sequence[Record],
    found: SearchResult,
    doubts: Mapping[str, str],
    best: RolloutFit | None,
    judged: tuple[Sequence[Cause], Sequence[Cause]],
) -> list[str]:
    """Describe what no cause explains, residual patterns excepted.

    ``doubts``: cause -> description of what contradicts it. ``judged``: the causes that are reported, and
    those that are too faint.
    """
    reported, faint = ({c.name for c in causes} for causes in judged)
    passes = found.last.fisher.passes
    vibration, uneven = vibration_of(records, passes), uneven_of(records)
    return [
        *(f"{n if n in reported else f'what looks like {n}'} {doubt}" for n, doubt in doubts.items()),
        *(best.unhealthy if best is not None else ()),
        *([str(vibration)] if vibration else []),
        *([uneven] if uneven else []),
        *(f"what looks like {name} is something else" for name in faint if name not in doubts),
        *outliers_of(records, passes),
    ]


def untold(readings: Sequence[StreamAnomaly]) -> list[str]:
    """Describe the anomalies of streams that neither a term nor the innovations show: frozen readings, and
    rounded ones apart from ranges."""
    return [r.words for r in readings if r.kind == "frozen" or (r.kind == "rounded" and r.stream != "sonar")]


def nearest_term(found: SearchResult, threshold: float) -> list[str]:
    """Describe the term with the greatest score test on the healthy vehicle, if it reaches half the
    threshold."""
    known = [s for s in found.first.score_tests([], found.first.effects) if s.effect.is_term]
    best = max(known, key=lambda s: s.z, default=None)
    if best is None or best.z < 0.5 * threshold:
        return []
    return [f"nearest is {best.effect.name}, by {best.z:.1f} sigma where {threshold:.1f} are required"]


def axes_of(flights: Sequence[Flight]) -> tuple[list[str], list[str]]:
    """Return descriptions of wrong axes of all flights, and of axes that none of them shows."""
    each = [wrong_axes(flight) for flight in flights]
    wrong = in_words([f.name for f in flights], [told for told, _ in each])
    hidden = [set(unknown) for _, unknown in each]
    return wrong, sorted(set.intersection(*hidden)) if hidden else []


def left_over_in_comparisons(found: SearchResult, rows: Sequence[Sequence[WhitenedRows]]) -> list[str]:
    """Describe what no cause explains in comparisons of instruments."""
    fisher = fisher_of(rows, columns_of(rows), ONSET_SEGMENT_S)
    begin_s = np.asarray(ONSET_SEGMENT_S * segments_of(rows, ONSET_SEGMENT_S)[0][:, 1])
    apart, begun = contradiction(rows), onset(found, fisher, begin_s)
    return [
        *disagreements(found),
        *([apart] if apart else []),
        *([str(begun)] if begun is not None else []),
    ]


def not_shown(
    found: SearchResult,
    rows: Sequence[Sequence[WhitenedRows]],
    axes: Sequence[str],
    shown: Collection[str],
    least_z: float,
) -> list[str]:
    """Return a sentence on the errors that these flights could not show, whatever their size.

    ``axes``: those of which no flight shows whether they are right. ``shown``: terms that have a smallest
    detectable size. Delays show from ``least_z`` standard errors on, in nine of ten cases.
    """
    lines = ["a constant offset of speed or height", *axes]
    lines += [e.name for e in found.last.effects if e.is_term and e.name not in shown]
    for effect in (e for e in found.last.effects if e.name in LATE):
        std = np.hypot(
            float(np.sqrt(found.last.quadratic.maximise([effect]).covariance[0, 0])), effect.tolerance
        )
        lines.append(f"{effect.name} by less than {1e3 * (least_z + NINE_OF_TEN) * std:.0f} ms")
    times_s = np.concatenate([r.times_s for flight in rows for r in flight])
    if float(np.ptp(times_s)) < FEWEST_SEGMENTS * ONSET_SEGMENT_S:
        lines.append("an error that begins within a flight")
    return [f"{COULD_NOT} {', '.join(lines)}."]


def noise_of(flights: Sequence[Flight]) -> list[str]:
    """Return a sentence on instruments whose readings scatter far more than the recording states."""
    ratios: dict[str, float] = {}
    for stream in (s for flight in flights for s in streams_of(flight)):
        ratios[stream.name] = max(ratios.get(stream.name, 0.0), noise_ratio(stream))
    lines = [f"{name} {ratio:.2g} times" for name, ratio in ratios.items() if ratio > NOISY]
    return [f"Noise from reading to reading is larger than stated: {', '.join(lines)}."] if lines else []


def in_words(names: Sequence[str], found: Sequence[Sequence[str]]) -> list[str]:
    """Return the descriptions of each flight with its name, where there are several flights."""
    labels = [f"{name}: " if len(names) > 1 else "" for name in names]
    return [label + words for label, of in zip(labels, found, strict=True) for words in of]
