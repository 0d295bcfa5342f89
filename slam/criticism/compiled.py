"""How the filter's kernels are compiled: without the interpreter's lock, sums free to be reordered."""

from __future__ import annotations

from numba import njit

kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp", "nsz"})
"""NaN keeps its meaning: a missing reading is one."""
