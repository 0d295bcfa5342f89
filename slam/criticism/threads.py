"""Work on several flights side by side: the filter's kernels free the interpreter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

WORKERS = 2
Input = TypeVar("Input")
Output = TypeVar("Output")


def in_threads(job: Callable[[Input], Output], inputs: Sequence[Input]) -> list[Output]:
    """The jobs' results in order."""
    with ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(job, inputs))
