"""Conversion of ranges to a sonar at the body's origin along -z, as the simulator has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.rotations import up_at

Array = NDArray[np.float64]


def ranges_at_body(flight: Flight) -> Flight:
    """Return the flight with its ranges converted to a sonar at the body's origin, over a level floor.

    The lever arm is rotated by the measured attitude; where that is missing, the body is assumed level.
    """
    sonar = flight.sonar
    if sonar is None or np.array_equal(sonar.b_T_s, np.eye(4)):
        return flight
    up = up_at(flight.attitude, sonar.stamps_s)
    beam, lever_m = sonar.b_T_s[:3, 2], sonar.b_T_s[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        range_m = (sonar.range_m * (up @ beam) - up @ lever_m) / up[:, 2]
    in_range = (sonar.range_m >= sonar.min_range_m) & (sonar.range_m <= sonar.max_range_m)
    above_m = float(lever_m[2])
    moved = replace(
        sonar,
        range_m=np.where(in_range & (up[:, 2] > 0), range_m, np.nan),
        min_range_m=max(0.0, sonar.min_range_m - above_m),
        max_range_m=sonar.max_range_m - above_m,
        b_T_s=np.eye(4),
    )
    return replace(flight, sonar=moved)
