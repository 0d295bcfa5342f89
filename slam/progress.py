"""How long work tells how far it is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

COMPILING = "compile for this machine: once after an installation, a minute or two"


class Progress(Protocol):
    """Called by long stages; the command line draws bars from it, the library default is silent."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """``done`` of ``total`` units of ``stage`` are finished; total 0 where it is not known."""


def silent(stage: str, done: int, total: int) -> None:
    """Show nothing."""


@contextmanager
def compilation_shown(progress: Progress) -> Iterator[None]:
    """Show where the block has to wait until kernels are compiled; not where they are cached."""
    from backend.compiled import compiling

    with compiling(lambda done: progress(COMPILING, int(done), 1)):
        yield
