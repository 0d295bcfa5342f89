"""Whether the reported motion of a refinement can be right."""

from __future__ import annotations

from backend.bundle.minimise import BundleOptimum


def reported_damage(optimum: BundleOptimum) -> str:
    """Describe why the reported motion of a refinement cannot be right, in words; empty if it can be."""
    part, values = optimum.problem.reported, optimum.values
    if part is None:
        return ""
    return part.damage(values, optimum.transform)
