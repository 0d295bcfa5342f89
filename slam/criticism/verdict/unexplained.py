"""Findings that no cause explains, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from slam.criticism.cause import Cause
from slam.criticism.kalman.record import Record
from slam.criticism.residuals.unmodelled import outliers_of, uneven_of, vibration_of
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.rollout_fit import RolloutFit
from slam.data_quality import StreamAnomaly


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
