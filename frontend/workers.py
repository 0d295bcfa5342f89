"""Workers that share independent jobs: threads of this process, unless `share_with` names others.

A job is a function of a module with two arguments: what all jobs of a stage share, and its own item. Results
come in the order of the items and do not depend on the workers, so that one stage runs on threads, processes
or many machines.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Generic, TypeVar

from frontend.cores import usable_cores

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 3
"""Jobs that are handed out for each worker: one is worked on, two wait or are finished and not yet taken.
With fewer, workers wait for each other where jobs differ in length; more results take more memory."""


@dataclass(frozen=True)
class Ready(Generic[Result]):
    """An item whose result is known: it keeps its place and costs no work."""

    result: Result


class Workers:
    """Threads of this process, one on each core by default."""

    def __init__(self, count: int | None = None) -> None:
        self.count = count or usable_cores()

    def executor(self, count: int) -> AbstractContextManager[Executor]:
        """Return the executor of one stage, which runs ``count`` jobs at a time."""
        return _threads(count)

    def share(self, value: Shared) -> Shared:
        """Return what stands for ``value`` as an argument of a job."""
        return value

    def submit(
        self, pool: Executor, job: Callable[[Shared, Item], Result], shared: Shared, item: Item
    ) -> Future[Result]:
        """Hand out a job; ``shared`` as `share` returned it."""
        return pool.submit(job, shared, item)

    def within(self, at_once: int | None) -> int:
        """Return how many jobs run at a time where the memory of this machine is enough for ``at_once``."""
        return min(self.count, at_once or self.count)

    def map(
        self,
        job: Callable[[Shared, Item], Result],
        shared: Shared,
        items: Iterable[Item | Ready[Result]],
        at_once: int | None = None,
        ahead: int | None = None,
    ) -> Iterator[Result]:
        """Yield ``job(shared, item)`` for each item, in order.

        ``at_once``: as in `within`. ``ahead``: most jobs whose results wait for an earlier one, by default
        ``AHEAD`` for each worker.
        """
        count = self.within(at_once)
        coming: deque[tuple[Item | None, Future[Result]]] = deque()
        with self.executor(count) as pool:
            try:
                handed = self.share(shared)
                for item in items:
                    if isinstance(item, Ready):
                        known: Future[Result] = Future()
                        known.set_result(item.result)
                        coming.append((None, known))
                    else:
                        coming.append((item, self.submit(pool, job, handed, item)))
                    if len(coming) >= (ahead or AHEAD * count):
                        yield self._taken(job, shared, *coming.popleft())
                while coming:
                    yield self._taken(job, shared, *coming.popleft())
            finally:
                for _, future in coming:
                    future.cancel()

    def _taken(
        self, job: Callable[[Shared, Item], Result], shared: Shared, item: Item | None, done: Future[Result]
    ) -> Result:
        """Wait for the result of a job."""
        return done.result()


@contextmanager
def _threads(count: int) -> Iterator[Executor]:
    """Hold threads for jobs, and wait for them at the end of the stage, but not after a signal.

    A signal in the middle of handing out a job may leave a lock of the pool taken that a thread waits for.
    """
    pool = ThreadPoolExecutor(count)
    try:
        yield pool
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException:
        pool.shutdown()
        raise
    pool.shutdown()


_workers: ContextVar[Workers | None] = ContextVar("workers", default=None)


def workers() -> Workers:
    """Return the workers that the jobs of this thread are shared among."""
    return _workers.get() or Workers()


@contextmanager
def share_with(chosen: Workers) -> Iterator[None]:
    """Let this thread share its jobs among these workers until the block ends."""
    before = _workers.set(chosen)
    try:
        yield
    finally:
        _workers.reset(before)
