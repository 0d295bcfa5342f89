"""How long each stage took, and memory given back when it is over."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from slam.core.heap import trim_heap


class Stopwatch:
    """Adds up seconds by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time what runs inside."""
        start = time.perf_counter()
        try:
            yield
        finally:
            trim_heap()
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start
