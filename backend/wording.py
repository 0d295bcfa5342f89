"""Counts in messages."""

from __future__ import annotations


def counted(count: int, one: str, many: str = "") -> str:
    """Return a count with its noun, and what follows it: ``1 edge is``, ``3 edges are``.

    ``many`` is by default ``one`` with an s.
    """
    return f"{count} {either(count, one, many or f'{one}s')}"


def either(count: int, one: str, many: str) -> str:
    """Return the word for a count of one, or for any other count."""
    return one if count == 1 else many
