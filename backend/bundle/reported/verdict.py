"""Whether the reported motion of a refinement can be right."""

from __future__ import annotations

from backend.bundle.graph import WORLD
from backend.bundle.minimise import BundleOptimum
from backend.bundle.world import WorldTransform


def reported_damage(optimum: BundleOptimum) -> str:
    """Describe why the reported motion of a refinement cannot be right, in words; empty if it can be."""
    part, values = optimum.problem.reported, optimum.values
    if part is None:
        return ""
    return part.damage(values, WorldTransform(values.atVector(WORLD), optimum.problem.camera.b_T_c))
