"""How long work tells how far it is."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Called by long stages; the command line draws bars from it, the library default is silent."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """``done`` of ``total`` units of ``stage`` are finished; total 0 where it is not known."""


def silent(stage: str, done: int, total: int) -> None:
    """Show nothing."""
