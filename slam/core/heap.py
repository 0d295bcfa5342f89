"""Return of freed memory to the system, by the settings of the GNU C library."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Parameters of ``mallopt``: free bytes at the heap's end that are returned, and size of a large block."""
_LARGE_BYTES, _LARGEST_BYTES = 128 * 1024, 32 * 1024 * 1024
"""Sizes that count as large at the start of a process, and at most. The C library raises the first to the
second as blocks are freed, and returns free memory at the heap's end that is twice as much."""


def map_large_blocks() -> None:
    """Let each large array have pages of its own, which the system has back as soon as the array is freed.

    Without this the C library raises the size that counts as large, up to 32 MB, each time such an array is
    freed. Arrays of some megabytes then lie between small objects that stay, and their memory is lost.
    Source: mallopt(3).
    """
    _set_large_size(_LARGE_BYTES, _LARGE_BYTES)


@contextmanager
def large_blocks_kept() -> Iterator[None]:
    """Let large arrays reuse the memory of freed ones, in a stage that treats pictures.

    Pages that the system gives are cleared first. The pyramids of a photograph are 250 MB, and each picture
    needs arrays of the same sizes anew: their clearing took a fifth of the processor time of a map of
    photographs. After the stage, `trim_heap` returns what was freed.
    """
    _set_large_size(_LARGEST_BYTES, 2 * _LARGEST_BYTES)
    try:
        yield
    finally:
        map_large_blocks()


def _set_large_size(large_bytes: int, free_bytes: int) -> None:
    option = _function("mallopt")
    if option is not None:
        option(_M_MMAP_THRESHOLD, large_bytes)
        option(_M_TRIM_THRESHOLD, free_bytes)


def trim_heap() -> None:
    """Return freed memory to the system.

    A graph consists of a million small objects. The C library keeps their memory after they are freed, and
    the memory of all stages would add up.
    """
    trim = _function("malloc_trim")
    if trim is not None:
        trim(0)


def _function(name: str) -> Callable[..., int] | None:
    """Return a function of the C library; None where it has none of this name."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None
