"""Lemniscate: drift-free maps from a down-looking camera."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slam.core.version import VERSION

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import criticise
    from slam.evaluation import evaluate
    from slam.evaluation.loops import evaluate_loops
    from slam.io.flight_folder import read_flight
    from slam.mapping.pipeline import optimize
    from slam.mapping.relocation import Relocalizer, relocalize
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
    "Flight": "slam.core.flight",
    "criticise": "slam.criticism",
    "evaluate": "slam.evaluation",
    "evaluate_loops": "slam.evaluation.loops",
    "optimize": "slam.mapping.pipeline",
    "read_flight": "slam.io.flight_folder",
    "Relocalizer": "slam.mapping.relocation",
    "relocalize": "slam.mapping.relocation",
    "simulate": "slam.simulation",
}


def __getattr__(name: str) -> Any:
    """Import on first use, so that ``slam --help`` need not wait for gtsam and OpenCV."""
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'slam' has no attribute {name!r}")
