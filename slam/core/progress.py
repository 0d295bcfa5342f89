"""Progress of long stages, reported through a callback."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Protocol, TypeVar

Item = TypeVar("Item")
Input = TypeVar("Input")
Output = TypeVar("Output")

COMPILING = "compile for this machine: once after an installation, about a minute"


class Progress(Protocol):
    """Callback of long stages; the command line draws bars, and the library's default is silent."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report that ``done`` of ``total`` units of ``stage`` are finished; total 0 where it is unknown."""


def silent(stage: str, done: int, total: int) -> None:
    """Ignore the progress."""


@contextmanager
def show_compilation(progress: Progress) -> Iterator[None]:
    """Report when the block has to wait for the compilation of kernels; cached kernels need none."""
    from backend.compilation import compiling

    with compiling(lambda done: progress(COMPILING, int(done), 1)):
        yield


class Tally:
    """Counts the finished parts of a stage; thread-safe. ``total`` is 0 where it is unknown."""

    def __init__(self, progress: Progress, stage: str, total: int = 0) -> None:
        self._progress, self._stage, self._total = progress, stage, total
        self._done, self._lock = 0, Lock()

    @contextmanager
    def part(self) -> Iterator[None]:
        """Count one part of the stage as finished when the block ends."""
        self._count(0)
        yield
        self._count(1)

    def counting(self, job: Callable[[Input], Output]) -> Callable[[Input], Output]:
        """Return the job with each call counted as one part."""

        def counted(value: Input) -> Output:
            with self.part():
                return job(value)

        return counted

    def each(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield the items; each counts as finished when the next one is requested."""
        for item in items:
            with self.part():
                yield item

    def _count(self, parts: int) -> None:
        with self._lock:
            self._done += parts
            self._progress(self._stage, self._done, self._total)
