"""Workers that are processes of their own, for jobs that hold the interpreter's lock."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context

from frontend.workers import Workers
from slam.core.errors import InputError


class Processes(Workers):
    """Processes of this machine with one thread each."""

    @contextmanager
    def executor(self, count: int) -> Iterator[Executor]:
        """Raises ``InputError`` where a process is ended from outside."""
        before = active_children()
        # Processes are spawned: a fork would share the locks of OpenCV's and BLAS's threads.
        with ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_begin) as pool:
            try:
                yield pool
            except BrokenProcessPool:
                raise InputError(
                    f"a process was ended from outside (is memory short?); give fewer --jobs than {count}"
                ) from None
            except BaseException:
                # Do not wait for the remaining jobs.
                pool.shutdown(wait=False, cancel_futures=True)
                for worker in active_children():
                    if worker not in before:
                        worker.terminate()
                raise


def _begin() -> None:
    """Ignore Ctrl-C, which the parent process handles, and use one thread."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_threads()


def limit_threads() -> None:
    """Limit the libraries of this process to one thread each: other processes use the other cores."""
    import cv2
    from threadpoolctl import threadpool_limits

    cv2.setNumThreads(1)
    threadpool_limits(1)
