"""A stated accuracy of the recorded heading that the map contradicts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam.core.estimate import Estimate
from slam.core.units import SPACE

if TYPE_CHECKING:
    from slam.core.flight import Flight


def heading_doubt(estimate: Estimate, flight: Flight | None) -> str:
    """Return by how much the recorded heading drifts against what is stated, as the end of a sentence; empty
    where both agree.

    The range of n independent errors is twice the root of 2 log n standard deviations at most (Cramér 1946,
    section 28.6). The heading of the map has an error too.
    """
    found = estimate.instruments.attitude
    if flight is None or flight.attitude is None or found is None or found.heading_wander_rad is None:
        return ""
    stated_rad = float(flight.attitude.noise_std_rad[2])
    of_map = np.sqrt(np.nanmedian(estimate.covariances[:, 2, 2])) if len(estimate.covariances) else 0.0
    count = max(int(estimate.placed.sum()), 2)
    chance_rad = 2 * np.sqrt(2 * np.log(count)) * np.hypot(stated_rad, np.nan_to_num(of_map))
    if not found.heading_wander_rad > chance_rad:
        return ""
    how = "assumed" if flight.attitude.noise_assumed else "stated"
    return (
        f"its heading drifts by {np.degrees(found.heading_wander_rad):.1f}° over the flight, and is {how} to "
        f"be good to ±{SPACE}{np.degrees(stated_rad):.2g}°, which cannot be believed"
    )
