"""Processor cores that this process may use: work is shared among as many threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Input = TypeVar("Input")
Output = TypeVar("Output")


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_threads(
    job: Callable[[Input], Output], inputs: Sequence[Input], threads: int | None = None
) -> list[Output]:
    """Return the results of ``job`` for each input, in order; by default with a thread for each core."""
    with ThreadPoolExecutor(threads or usable_cores()) as pool:
        return list(pool.map(job, inputs))
