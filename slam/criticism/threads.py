"""Threads for work on several flights: the filter's kernels release the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from frontend.cores import usable_cores

Input = TypeVar("Input")
Output = TypeVar("Output")


def in_threads(job: Callable[[Input], Output], inputs: Sequence[Input]) -> list[Output]:
    """Return the results of ``job`` for each input, in order."""
    with ThreadPoolExecutor(usable_cores()) as pool:
        return list(pool.map(job, inputs))
