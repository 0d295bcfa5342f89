"""A thread that runs jobs one after the other."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue


class Worker:
    """One thread for jobs in the order in which they come.

    The interpreter does not wait for it: a program that fails before it calls `close` ends all the same.
    """

    def __init__(self, name: str, on_error: Callable[[BaseException], None]) -> None:
        """``on_error`` gets, in that thread, what a job raises; the next job runs."""
        self._jobs: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._on_error = on_error
        self._drops = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, job: Callable[[], None]) -> None:
        """Run a job after those that came before it."""
        self._jobs.put(job)

    def drop(self) -> None:
        """Leave out the jobs that have not begun, and those that come."""
        self._drops = True

    def close(self) -> None:
        """Wait until all jobs have run, and end the thread."""
        self._jobs.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            if self._drops:
                continue
            try:
                job()
            except BaseException as error:  # noqa: BLE001 - the caller raises it in its own thread
                self._on_error(error)
