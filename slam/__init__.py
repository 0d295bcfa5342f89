"""Lemniscate: drift-free maps from a down-looking camera."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slam.version import VERSION

if TYPE_CHECKING:
    from slam.criticism import criticise
    from slam.evaluation import evaluate
    from slam.flight import Flight
    from slam.io.flight_folder import read_flight
    from slam.loops import evaluate_loops
    from slam.pipeline import optimize
    from slam.relocation import Relocalizer, relocalize
    from slam.simulation import simulate

__version__ = VERSION
__all__ = [
    "Flight",
    "Relocalizer",
    "criticise",
    "evaluate",
    "evaluate_loops",
    "optimize",
    "read_flight",
    "relocalize",
    "simulate",
]

_HOME = {
    "Flight": "slam.flight",
    "criticise": "slam.criticism",
    "evaluate": "slam.evaluation",
    "evaluate_loops": "slam.loops",
    "optimize": "slam.pipeline",
    "read_flight": "slam.io.flight_folder",
    "Relocalizer": "slam.relocation",
    "relocalize": "slam.relocation",
    "simulate": "slam.simulation",
}


def __getattr__(name: str) -> Any:
    """Import on first use, so that ``slam --help`` need not wait for gtsam and OpenCV."""
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'slam' has no attribute {name!r}")
