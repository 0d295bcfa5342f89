"""Maps with given poses and parts, without pictures behind them."""

from __future__ import annotations

from collections import Counter

import numpy as np

from backend.pose_graph.heights import HeightEstimate
from backend.pose_graph.solution import Solution
from frontend.camera import Camera
from frontend.store import FeatureStore
from slam.mapping.front_end import Observations
from slam.mapping.lift_edges import Edges
from slam.mapping.map import Map

CAMERA = Camera(focal_px=(250.0, 250.0), center_px=(159.5, 119.5), size_px=(320, 240))


def made_map(w_T_b: np.ndarray, component: np.ndarray) -> Map:
    """Poses (n, 4, 4) that are certain, in the parts of ``component`` (n,)."""
    n = len(w_T_b)
    nothing_seen = Observations(
        FeatureStore(), np.arange(n), np.arange(n, dtype=float), (None,) * n, (), (), n, Counter()
    )
    heights = HeightEstimate(w_T_b[:, 2, 3], np.zeros(n), np.ones(n, dtype=bool))
    graph = Solution(
        w_T_b=w_T_b,
        covariances=None,
        component=component,
        edge_kept=np.empty(0, dtype=bool),
        edge_reason=(),
        edge_residual=np.empty(0),
        error=0.0,
        iterations=0,
        converged=True,
    )
    return Map(
        observations=nothing_seen,
        edges=Edges((), (), heights),
        graph=graph,
        w_T_b=w_T_b,
        covariances=np.zeros((n, 6, 6)),
        over_floor_covariances=np.zeros((n, 6, 6)),
        component=component,
        camera=CAMERA,
        height_std_m=(0.0,) * n,
    )
