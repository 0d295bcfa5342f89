"""Memory that is free goes back to the system."""

from __future__ import annotations

import ctypes
import sys


def trim_heap() -> None:
    """Hand freed memory back to the system.

    A graph is a million small objects; the C library keeps what they leave, and each stage would add its own.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
