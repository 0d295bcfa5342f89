"""Findings that no cause explains, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from slam.criticism.cause import Cause
from slam.criticism.kalman.record import Record
from slam.criticism.residuals.unmodelled import outliers_of, uneven_of, vibration_of
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.posterior import is_term
from slam.criticism.verdict.rollout_fit import RolloutFit


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


def nearest_term(found: SearchResult, threshold: float) -> list[str]:
    """Describe the term with the greatest score test on the healthy vehicle, if it reaches half the
    threshold."""
    known = [s for s in found.first.score_tests([], found.first.effects) if is_term(s.effect)]
    best = max(known, key=lambda s: s.z, default=None)
    if best is None or best.z < 0.5 * threshold:
        return []
    return [f"nearest is {best.effect.name}, by {best.z:.1f} sigma where {threshold:.1f} are required"]
