"""Parallel trials on workers, one core each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from frontend.workers import Workers
from slam.core.progress import Progress, silent
from slam.experiments.experiment import Conclusion, Trial
from slam.experiments.registry import experiment


def run(
    names: Sequence[str], seeds: int, workers: Workers, progress: Progress = silent
) -> dict[str, tuple[Trial, ...]]:
    """Fly ``seeds`` trials of each experiment on workers; the first one also for drawing.

    The result does not depend on the workers. A single worker is replaced by this process. An experiment
    that is not random has one trial.
    """
    tasks = [(name, seed) for name in names for seed in range(seeds if experiment(name).random else 1)]
    total = {name: sum(1 for task in tasks if task[0] == name) for name in names}
    found: dict[str, list[Trial]] = {name: [] for name in names}
    for (name, _), trial in zip(tasks, _flown(tasks, workers), strict=True):
        found[name].append(trial)
        progress(name, len(found[name]), total[name])
    return {name: tuple(trials) for name, trials in found.items()}


def conclude(names: Sequence[str], trials: dict[str, tuple[Trial, ...]]) -> dict[str, Conclusion]:
    """Return the conclusion of each experiment from its trials."""
    return {name: experiment(name).conclude(trials[name]) for name in names}


def _flown(tasks: Sequence[tuple[str, int]], workers: Workers) -> Iterator[Trial]:
    """Yield the trial of each experiment and seed."""
    if min(workers.count, len(tasks)) > 1:
        # All are handed out at once, as the trials of some experiments take much longer than others.
        yield from workers.map(_fly, None, tasks, at_once=len(tasks), ahead=len(tasks))
        return
    with _one_thread():
        for task in tasks:
            yield _fly(None, task)


def _fly(shared: None, task: tuple[str, int]) -> Trial:
    name, seed = task
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
