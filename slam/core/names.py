"""Lists of names in messages."""

from __future__ import annotations

from collections.abc import Sequence

_MAX_LISTED = 5


def listed(names: Sequence[str]) -> str:
    """Return the first names and the number of the others."""
    more = len(names) - _MAX_LISTED
    return ", ".join(names[:_MAX_LISTED]) + (f" and {more} more" if more > 0 else "")
