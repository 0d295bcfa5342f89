"""Kalman filter of a flight: whitened innovations, and their sensitivity to each filter parameter."""

from __future__ import annotations

from pathlib import Path

from backend.compilation import discard_stale

_ROOT = Path(__file__).parents[3]
# Before any kernel is loaded: numba would run cached code of older sources.
discard_stale(
    [
        *(_ROOT / "slam" / "criticism").rglob("*.py"),
        _ROOT / "slam" / "core" / "arrays.py",
        *(_ROOT / "slam" / "simulation" / name for name in ("dynamics.py", "state.py")),
        _ROOT / "slam" / "simulation" / "terms",
        *(_ROOT / "slam" / "simulation" / "terms").glob("*.py"),
        _ROOT / "backend" / "measurements" / "__init__.py",
        _ROOT / "backend" / "sparse_product.py",
    ]
)
