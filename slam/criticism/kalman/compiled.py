"""Compilation of the filter's kernels: without the interpreter's lock, with sums free to be reordered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from backend.numba_cache import discard_stale, njit

_ROOT = Path(__file__).parents[3]
discard_stale(
    [
        *(_ROOT / "slam" / "criticism").rglob("*.py"),
        _ROOT / "slam" / "simulation" / "dynamics.py",
        _ROOT / "slam" / "simulation" / "state.py",
        _ROOT / "slam" / "simulation" / "terms",
        *(_ROOT / "slam" / "simulation" / "terms").glob("*.py"),
        _ROOT / "backend" / "measurements.py",
    ]
)

_OPTIONS: dict[str, Any] = {
    "cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "arcp", "nsz"},
}  # fmt: skip
"""NaN keeps its meaning, since it marks missing readings."""
kernel = njit(**_OPTIONS, _nrt=False)
"""Decorator of kernels that allocate no arrays and count no references: counting took half the filter's time.
The Python caller must hold the arrays meanwhile."""
allocating_kernel = njit(**_OPTIONS)
"""Decorator of kernels that may allocate arrays."""
