"""Measures the time of each stage and frees its memory at the end."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager

from slam.core.heap import trim_heap

_LOG = logging.getLogger(__name__)


class Stopwatch:
    """Sums the seconds of each stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time the block, log its duration, and return freed memory to the system."""
        start = time.perf_counter()
        try:
            yield
        finally:
            trim_heap()
            taken_s = time.perf_counter() - start
            self.seconds[stage] = self.seconds.get(stage, 0.0) + taken_s
            _LOG.info("%s: %.2f s", stage, taken_s)
