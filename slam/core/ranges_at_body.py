"""Ranges as the simulator's sonar would give them: it hears from the body's origin along -z."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.rotations import up_at

Array = NDArray[np.float64]


def ranges_at_body(flight: Flight) -> Flight:
    """The flight with its sonar at the body's origin, over a level floor.

    What lies between is taken from the measured attitude; where that is missing the body is taken as level.
    """
    sonar = flight.sonar
    if sonar is None or np.array_equal(sonar.b_T_s, np.eye(4)):
        return flight
    up = up_at(flight.attitude, sonar.stamps_s)
    beam, place_m = sonar.b_T_s[:3, 2], sonar.b_T_s[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        range_m = (sonar.range_m * (up @ beam) - up @ place_m) / up[:, 2]
    heard = (sonar.range_m >= sonar.min_range_m) & (sonar.range_m <= sonar.max_range_m)
    above_m = float(place_m[2])
    moved = replace(
        sonar,
        range_m=np.where(heard & (up[:, 2] > 0), range_m, np.nan),
        min_range_m=max(0.0, sonar.min_range_m - above_m),
        max_range_m=sonar.max_range_m - above_m,
        b_T_s=np.eye(4),
    )
    return replace(flight, sonar=moved)
