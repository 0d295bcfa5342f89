"""How the filter's kernels are compiled: without the interpreter's lock, sums free to be reordered."""

from __future__ import annotations

from pathlib import Path

from backend.compiled import discard_stale, njit

_ROOT = Path(__file__).parents[3]
discard_stale(
    [
        *(_ROOT / "slam" / "criticism").rglob("*.py"),
        _ROOT / "slam" / "simulation" / "dynamics.py",
        _ROOT / "backend" / "measurements.py",
    ]
)

kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp", "nsz"})
"""NaN keeps its meaning: a missing reading is one."""
