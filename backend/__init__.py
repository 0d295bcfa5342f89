"""Back end: from measurements in metres to one consistent trajectory."""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from backend.ekf.inputs import FilterModel, InitialState, Readings, Series
    from backend.ekf.results import Track
    from backend.ekf.track import track
    from backend.errors import BackendError
    from backend.g2o import read_g2o, write_g2o
    from backend.measurements import (
        Attitude,
        FloorTracks,
        Measurements,
        PinholeModel,
        Position,
        RelativePose,
        SlantRange,
    )
    from backend.pose_graph.certificate import Certificate, certify
    from backend.pose_graph.graph import PoseGraph, build_pose_graph
    from backend.pose_graph.incremental.estimation import Incremental
    from backend.pose_graph.solution import RangeErrors, Solution
    from backend.pose_graph.solve import solve, solve_pose_graph

logging.getLogger(__name__).addHandler(logging.NullHandler())

_MODULES = {
    "Attitude": "backend.measurements",
    "BackendError": "backend.errors",
    "Certificate": "backend.pose_graph.certificate",
    "FilterModel": "backend.ekf.inputs",
    "FloorTracks": "backend.measurements",
    "Incremental": "backend.pose_graph.incremental.estimation",
    "InitialState": "backend.ekf.inputs",
    "Measurements": "backend.measurements",
    "PinholeModel": "backend.measurements",
    "PoseGraph": "backend.pose_graph.graph",
    "Position": "backend.measurements",
    "RangeErrors": "backend.pose_graph.solution",
    "Readings": "backend.ekf.inputs",
    "RelativePose": "backend.measurements",
    "Series": "backend.ekf.inputs",
    "SlantRange": "backend.measurements",
    "Solution": "backend.pose_graph.solution",
    "Track": "backend.ekf.results",
    "build_pose_graph": "backend.pose_graph.graph",
    "certify": "backend.pose_graph.certificate",
    "read_g2o": "backend.g2o",
    "solve": "backend.pose_graph.solve",
    "solve_pose_graph": "backend.pose_graph.solve",
    "track": "backend.ekf.track",
    "write_g2o": "backend.g2o",
}
"""Public name -> the module that defines it."""

__all__ = [
    "Attitude",
    "BackendError",
    "Certificate",
    "FilterModel",
    "FloorTracks",
    "Incremental",
    "InitialState",
    "Measurements",
    "PinholeModel",
    "PoseGraph",
    "Position",
    "RangeErrors",
    "Readings",
    "RelativePose",
    "Series",
    "SlantRange",
    "Solution",
    "Track",
    "build_pose_graph",
    "certify",
    "read_g2o",
    "solve",
    "solve_pose_graph",
    "track",
    "write_g2o",
]


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that ``import backend`` loads nothing else."""
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'backend' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
