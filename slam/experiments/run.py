"""Parallel trials in processes of their own, one core each."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context

from slam.core.errors import InputError
from slam.core.progress import Progress, silent
from slam.experiments.experiment import Conclusion, Trial
from slam.experiments.registry import experiment


def run(
    names: Sequence[str], seeds: int, jobs: int, progress: Progress = silent
) -> dict[str, tuple[Trial, ...]]:
    """Fly ``seeds`` trials of each experiment in up to ``jobs`` processes; the first one also for drawing.

    The result does not depend on ``jobs``. An experiment that is not random has one trial.
    """
    tasks = [(name, seed) for name in names for seed in range(seeds if experiment(name).random else 1)]
    total = {name: sum(1 for task in tasks if task[0] == name) for name in names}
    found: dict[str, dict[int, Trial]] = {name: {} for name in names}
    for name, trial in _done(tasks, min(jobs, len(tasks))):
        found[name][trial.seed] = trial
        progress(name, len(found[name]), total[name])
    return {name: tuple(trials[seed] for seed in sorted(trials)) for name, trials in found.items()}


def conclude(names: Sequence[str], trials: dict[str, tuple[Trial, ...]]) -> dict[str, Conclusion]:
    """Return the conclusion of each experiment from its trials."""
    return {name: experiment(name).conclude(trials[name]) for name in names}


def _done(tasks: Sequence[tuple[str, int]], jobs: int) -> Iterator[tuple[str, Trial]]:
    """Yield trials as they are finished."""
    if jobs <= 1:
        with _one_thread():
            for name, seed in tasks:
                yield name, _fly(name, seed)
        return
    # Processes are spawned: a fork would share the locks of OpenCV's and BLAS's threads.
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_limit_worker) as pool:
        coming: dict[Future[Trial], str] = {pool.submit(_fly, name, seed): name for name, seed in tasks}
        try:
            for done in as_completed(coming):
                yield coming[done], done.result()
        except BrokenProcessPool:
            raise InputError(
                "a process that flew an experiment was ended from outside (is memory short?); give fewer "
                f"--jobs than {jobs}"
            ) from None
        except BaseException:
            # Do not wait for the remaining flights.
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in active_children():
                worker.terminate()
            raise


def _fly(name: str, seed: int) -> Trial:
    return experiment(name).trial(seed, seed == 0)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limit OpenCV to one thread until the block ends."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def _limit_worker() -> None:
    """Limit a worker to one thread and ignore Ctrl-C, which the parent process handles."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import cv2
    from threadpoolctl import threadpool_limits

    cv2.setNumThreads(1)
    threadpool_limits(1)
