"""How the filter's kernels are compiled: without the interpreter's lock, sums free to be reordered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from backend.numba_cache import discard_stale, njit

_ROOT = Path(__file__).parents[3]
discard_stale(
    [
        *(_ROOT / "slam" / "criticism").rglob("*.py"),
        _ROOT / "slam" / "simulation" / "dynamics.py",
        _ROOT / "backend" / "measurements.py",
    ]
)

_OPTIONS: dict[str, Any] = {
    "cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "arcp", "nsz"},
}  # fmt: skip
"""NaN keeps its meaning: a missing reading is one."""
kernel = njit(**_OPTIONS, _nrt=False)
"""Makes no arrays, and counts no references to those it is given: counting took half the filter's time.
Who calls it from Python holds them meanwhile."""
allocating_kernel = njit(**_OPTIONS)
"""May make arrays."""
