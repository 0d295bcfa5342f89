"""Estimated constants of reported motion, and whether it can be right."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.bundle.graph import WORLD
from backend.bundle.minimise import BundleOptimum
from backend.bundle.reported.factor import CONSTANTS_SIZE
from backend.bundle.reported.graph import REPORTED
from backend.bundle.world import WorldTransform

Array = NDArray[np.float64]


def reported_constants(optimum: BundleOptimum) -> tuple[Array, Array]:
    """Return the constants (6,), in the order of the factor, and their standard deviations.

    Raises ``SingularMatrixError`` if a direction is open.
    """
    reduced = optimum.linearise().eliminate()
    right = np.zeros((reduced.size, CONSTANTS_SIZE))
    right[reduced.structure.columns(REPORTED)] = np.eye(CONSTANTS_SIZE)
    variance = np.einsum("na,na->a", right, reduced.factor.solve(right))
    return optimum.values.atVector(REPORTED), np.sqrt(variance)


def reported_damage(optimum: BundleOptimum) -> str:
    """Describe why the reported motion of a refinement cannot be right, in words; empty if it can be."""
    part, values = optimum.problem.reported, optimum.values
    if part is None:
        return ""
    return part.damage(values, WorldTransform(values.atVector(WORLD), optimum.problem.camera.b_T_c))
