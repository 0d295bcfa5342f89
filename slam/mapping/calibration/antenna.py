"""The place of the GPS antenna that a map has estimated, beside what was told of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.bundle.refinement import Bundle
from slam.core.instrument_errors import AntennaPlace


def antenna_place(bundle: Bundle | None) -> AntennaPlace | None:
    """Return the place; None without positions, and where it was held."""
    if bundle is None:
        return None
    measured = bundle.optimum.problem.measurements
    if not measured.positions or measured.antenna_std_m == 0:
        return None
    place, std, told = map(_three, (bundle.antenna_m, bundle.antenna_std_m, measured.antenna_m))
    return AntennaPlace(place, std, told, measured.antenna_std_m)


def _three(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
