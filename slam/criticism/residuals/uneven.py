"""Pictures with light that changes within them: their brightness is no evidence for other terms."""

from __future__ import annotations

from collections.abc import Sequence

from slam.criticism.kalman.record import Record


def uneven_of(records: Sequence[Record]) -> str | None:
    """Return a phrase for the worst flight, or None."""
    uneven = [r.matches.flicker for r in records if r.matches is not None and r.matches.uneven]
    if not uneven:
        return None
    worst = 100 * max(uneven)
    return f"picture brightness changes in bands, by {worst:.0f} %, otherwise from picture to picture"
