"""How long each stage took, and memory given back when it is over."""

from __future__ import annotations

import ctypes
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager


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
            _give_back()
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start


def _give_back() -> None:
    """Hand freed memory back to the system.

    A graph is a million small objects; the C library keeps what they leave, and each stage would add its own.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
