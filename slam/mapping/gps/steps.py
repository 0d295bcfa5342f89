"""The warning about fixes that lie aside from one photograph or moment on, by the pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.bundle.position_steps import PositionStep
from slam.core.messages import Message, about
from slam.core.units import length
from slam.mapping.gps.fixes import Fixes, nearest

_AXES = ("east", "north", "up")


def step_warning(step: PositionStep, fixes: Fixes, stamps_s: NDArray[np.float64]) -> Message:
    """Return the warning about a step of ``fixes`` on a map with keyframes at ``stamps_s`` (m,)."""
    name = fixes.names[int(nearest(fixes.stamps_s, stamps_s[[step.keyframe]])[0])]
    size = length(float(np.linalg.norm(step.shift_m)))
    each = zip(_AXES, step.shift_m, step.std_m, strict=False)
    figures = ", ".join(f"{axis} {by:+.2g} ± {std:.2g} m" for axis, by, std in each)
    return about(
        "gps0",
        f"from about {name} on, the fixes lie {size} aside of those before by the pictures ({figures}), and "
        "the map is bent between both",
        "another base station, or a lost solution of RTK, makes such a step: correct the fixes of one side, "
        "remove them, or add control points",
    )
