"""How long work tells how far it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Protocol, TypeVar

Part = TypeVar("Part")
Given = TypeVar("Given")
Made = TypeVar("Made")

COMPILING = "compile for this machine: once after an installation, a minute or two"


class Progress(Protocol):
    """Called by long stages; the command line draws bars from it, the library default is silent."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """``done`` of ``total`` units of ``stage`` are finished; total 0 where it is not known."""


def silent(stage: str, done: int, total: int) -> None:
    """Show nothing."""


@contextmanager
def show_compilation(progress: Progress) -> Iterator[None]:
    """Show where the block has to wait until kernels are compiled; not where they are cached."""
    from backend.numba_cache import compiling

    with compiling(lambda done: progress(COMPILING, int(done), 1)):
        yield


class Tally:
    """Counts the finished parts of a stage, by several threads too; ``total`` 0 where only the end tells."""

    def __init__(self, progress: Progress, stage: str, total: int = 0) -> None:
        self._progress, self._stage, self._total = progress, stage, total
        self._done, self._lock = 0, Lock()

    @contextmanager
    def part(self) -> Iterator[None]:
        """One part of the stage: begun here, finished with the block."""
        self._count(0)
        yield
        self._count(1)

    def counting(self, job: Callable[[Given], Made]) -> Callable[[Given], Made]:
        """The job, each call of which is one part."""

        def counted(given: Given) -> Made:
            with self.part():
                return job(given)

        return counted

    def each(self, parts: Iterable[Part]) -> Iterator[Part]:
        """The parts, each finished when the next is asked for."""
        for part in parts:
            with self.part():
                yield part

    def _count(self, parts: int) -> None:
        with self._lock:
            self._done += parts
            self._progress(self._stage, self._done, self._total)
