"""Return of freed memory to the system, by the settings of the GNU C library."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable

_M_MMAP_THRESHOLD, _MMAP_THRESHOLD_BYTES = -3, 128 * 1024
"""Parameter of ``mallopt``, and its value at the start of a process."""


def map_large_blocks() -> None:
    """Let each large array have pages of its own, which the system has back as soon as the array is freed.

    Without this the C library raises the size that counts as large, up to 32 MB, each time such an array is
    freed. Arrays of some megabytes then lie between small objects that stay, and their memory is lost.
    Source: mallopt(3).
    """
    option = _function("mallopt")
    if option is not None:
        option(_M_MMAP_THRESHOLD, _MMAP_THRESHOLD_BYTES)


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
