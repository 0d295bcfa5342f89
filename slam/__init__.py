"""Lemniscate: drift-free maps from a down-looking camera."""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

from slam.core.version import VERSION

if TYPE_CHECKING:
    from slam.core.errors import InputError
    from slam.core.estimate import Estimate
    from slam.core.flight import Flight
    from slam.core.join_flights import join_flights
    from slam.criticism import Criticism, criticise
    from slam.evaluation import Evaluation, evaluate
    from slam.evaluation.loops import evaluate_loops
    from slam.inertial.navigate import navigate
    from slam.io.estimate import read_estimate, write_estimate
    from slam.io.flight_folder import read_flight, write_flight
    from slam.mapping.config import PipelineConfig
    from slam.mapping.live.mapper import LiveMapper
    from slam.mapping.pipeline import optimize
    from slam.mapping.relocation import Relocalizer, relocalize
    from slam.parallel.cluster import cluster
    from slam.simulation import simulate

__version__ = VERSION
logging.getLogger(__name__).addHandler(logging.NullHandler())

_MODULES = {
    "Criticism": "slam.criticism",
    "Estimate": "slam.core.estimate",
    "Evaluation": "slam.evaluation",
    "Flight": "slam.core.flight",
    "InputError": "slam.core.errors",
    "LiveMapper": "slam.mapping.live.mapper",
    "PipelineConfig": "slam.mapping.config",
    "Relocalizer": "slam.mapping.relocation",
    "cluster": "slam.parallel.cluster",
    "criticise": "slam.criticism",
    "evaluate": "slam.evaluation",
    "evaluate_loops": "slam.evaluation.loops",
    "join_flights": "slam.core.join_flights",
    "navigate": "slam.inertial.navigate",
    "optimize": "slam.mapping.pipeline",
    "read_estimate": "slam.io.estimate",
    "read_flight": "slam.io.flight_folder",
    "relocalize": "slam.mapping.relocation",
    "simulate": "slam.simulation",
    "write_estimate": "slam.io.estimate",
    "write_flight": "slam.io.flight_folder",
}
"""Public name -> the module that defines it."""

__all__ = [
    "Criticism",
    "Estimate",
    "Evaluation",
    "Flight",
    "InputError",
    "LiveMapper",
    "PipelineConfig",
    "Relocalizer",
    "__version__",
    "cluster",
    "criticise",
    "evaluate",
    "evaluate_loops",
    "join_flights",
    "navigate",
    "optimize",
    "read_estimate",
    "read_flight",
    "relocalize",
    "simulate",
    "write_estimate",
    "write_flight",
]


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that ``import slam`` loads nothing else."""
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'slam' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
