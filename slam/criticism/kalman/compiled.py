"""Compilation of the filter's kernels: without the interpreter's lock, with sums free to be reordered."""

from __future__ import annotations

from pathlib import Path

from backend.numba_cache import ALLOCATION_FREE, INNER, discard_stale, njit

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

kernel = njit(**ALLOCATION_FREE)
"""Decorator of kernels that allocate no arrays."""
inner_kernel = njit(**INNER)
"""Decorator of such kernels that only kernels call."""
allocating_kernel = njit(**(ALLOCATION_FREE | {"_nrt": True}))
"""Decorator of kernels that may allocate arrays."""
