"""Mounts of sensors from the fixed transforms of a recording (``/tf_static``)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.io.sensor_yaml import Value

Array = NDArray[np.float64]

BODY_FRAMES = ("base_link", "body", "base_frame", "fcu", "base_footprint")
"""Usual names of the body's frame, in the order of preference."""
_WORLD_WORDS = frozenset(("map", "odom", "world", "earth", "origin", "global", "enu", "ned", "utm"))
_BODY_WORDS = frozenset(("base", "body", "fcu", "imu"))
"""Words in the name of a frame that turns with the vehicle, for example ``base_link_ned``."""


@dataclass
class MountTree:
    """Fixed transforms between named frames."""

    _graph: nx.DiGraph = field(default_factory=nx.DiGraph)

    def add(self, parent: str, child: str, parent_T_child: Array) -> None:
        """Add one transform, a (4, 4) array; a later one replaces an earlier one."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        self._graph.add_edge(parent, child, T=parent_T_child)
        self._graph.add_edge(child, parent, T=np.linalg.inv(parent_T_child))

    def body(self, sensors: Iterable[str]) -> str | None:
        """Return the frame of the body: a usual name, else that of the first sensor known; None without."""
        names = [name.lstrip("/") for name in sensors]
        return next((name for name in (*BODY_FRAMES, *names) if name in self._graph), None)

    def knows(self, frame: str) -> bool:
        """Return whether a transform leads to a frame."""
        return frame.lstrip("/") in self._graph

    def mount(self, body: str | None, sensor: str) -> Array | None:
        """Return ``b_T_s`` (4, 4), or None where the two frames are not connected."""
        sensor = sensor.lstrip("/")
        if body is None or sensor == body:
            return np.eye(4) if sensor == body else None
        if sensor not in self._graph or not nx.has_path(self._graph, body, sensor):
            return None
        path = nx.shortest_path(self._graph, body, sensor)
        b_T_s = np.eye(4)
        for a, b in pairwise(path):
            b_T_s = b_T_s @ self._graph.edges[a, b]["T"]
        return b_T_s


def is_optical(frame: str) -> bool:
    """Return whether a frame has optical axes by its name (REP 103): x right, y down, z ahead."""
    return "optical" in frame.lower()


def is_body(frame: str) -> bool:
    """Return whether a frame has the body's axes by its name, whatever its namespace."""
    return frame.rpartition("/")[2] in BODY_FRAMES


def is_world(frame: str) -> bool:
    """Return whether a frame does not turn with the vehicle by its name (REP 105)."""
    words = set(re.split(r"[^a-z]+", frame.lower()))
    return bool(words & _WORLD_WORDS) and not words & _BODY_WORDS


def is_north_east_down(frame: str) -> bool:
    """Return whether a frame has the axes of aviation by its name."""
    return "ned" in re.split(r"[^a-z]+", frame.lower())


def mount_entry(b_T_s: Array) -> Mapping[str, Value]:
    """Return a mount (4, 4) as the value of ``T_BS`` in ``sensor.yaml``."""
    return {"rows": "4", "cols": "4", "data": [repr(float(v)) for v in b_T_s.ravel()]}


def transform_of(message: Any) -> Array:
    """Return a ``geometry_msgs/Transform`` as a (4, 4) array."""
    T = np.eye(4)
    q, p = message.rotation, message.translation
    T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    T[:3, 3] = p.x, p.y, p.z
    return T
