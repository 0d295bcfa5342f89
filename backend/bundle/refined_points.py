"""Places of the floor points of a refined map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.bundle.graph import WORLD
from backend.bundle.minimise import BundleOptimum
from backend.bundle.world import WorldTransform

Array = NDArray[np.float64]


def metric_points(optimum: BundleOptimum) -> Array:
    """Return (t, 3) the floor points in the measured world, in metres."""
    world = optimum.values.atVector(WORLD)
    transform = WorldTransform(world, optimum.problem.camera.b_T_c)
    place = transform.scale * optimum.at.point @ transform.slope.T + transform.w_T_f.translation()
    return np.asarray(place)
