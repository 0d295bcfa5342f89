"""Values of tags as numbers and text, whatever type a camera wrote them in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def number(value: Any) -> float | None:
    """Return a finite float from a rational, a one-tuple, "+1.5" or "3/2"; None for other values."""
    if isinstance(value, (tuple, list)):
        value = value[0] if len(value) == 1 else None
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    try:
        if isinstance(value, str) and "/" in value:
            above, below = value.split("/", 1)
            value = float(above) / float(below)
        found = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return None
    return found if np.isfinite(found) else None


def numbers(value: Any, count: int) -> NDArray[np.float64] | None:
    """Return ``count`` finite floats from a list of that length; None for other values."""
    if not isinstance(value, (tuple, list)) or len(value) != count:
        return None
    found = [number(v) for v in value]
    return None if None in found else np.array(found, dtype=float)


def positive(value: Any) -> float | None:
    """Return a finite float above 0; None for other values."""
    found = number(value)
    return found if found is not None and found > 0 else None


def text(value: Any) -> str:
    """Return the printable part of a text up to its first zero byte; empty for other values."""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    found = value.split("\0")[0] if isinstance(value, str) else ""
    return "".join(c for c in found if c.isprintable()).strip()
