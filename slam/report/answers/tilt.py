"""The lean of a map whose attitude sensor is doubted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam.core.estimate import Estimate
from slam.report.answers.streams import doubts

if TYPE_CHECKING:
    from slam.core.summary import Summary


def is_tilt_doubted(summary: Summary) -> bool:
    """Return whether a warning doubts how level the map is."""
    return any(doubt.stream == "attitude0" for doubt in doubts(summary.warnings))


def tilt_rad(estimate: Estimate) -> float:
    """Return the tilt of the attitude sensor against the floor; a degree where it is not known."""
    found = estimate.instruments.attitude
    return float(np.linalg.norm(found.offset_rad)) if found is not None else float(np.radians(1.0))
