"""Findings in comparisons that no cause explains, in words, and errors that these flights could not show.

They belong to no term: wrong axes, an onset, a delay. Each is reported with its channel, its shape, its time
and its size.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from slam.core.flight import Flight
from slam.criticism.search.effects import LATE
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.consistency import FEWEST_SEGMENTS, ONSET_SEGMENT_S, disagreements, onset
from slam.criticism.verdict.power import NINE_OF_TEN
from slam.criticism.without_commands.likelihood import columns_of, fisher_of, segments_of
from slam.criticism.without_commands.pictures import contradiction
from slam.criticism.without_commands.whitened_rows import WhitenedRows
from slam.data_quality.axes import wrong_axes

COULD_NOT = "These flights could not show"


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


def in_words(names: Sequence[str], found: Sequence[Sequence[str]]) -> list[str]:
    """Return the descriptions of each flight with its name, where there are several flights."""
    labels = [f"{name}: " if len(names) > 1 else "" for name in names]
    return [label + words for label, of in zip(labels, found, strict=True) for words in of]
