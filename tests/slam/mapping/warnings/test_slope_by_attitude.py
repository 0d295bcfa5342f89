"""A slope that the attitude alone tells is named with its other possible causes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam import optimize
from tests.slam.mapping.calibration.test_attitude_floor_tilt import askew
from tests.slam.small_flight import flown, gps_of


@pytest.mark.slow
@pytest.mark.parametrize(("std_m", "named"), [(0.02, True), (0.001, False)])
def test_a_mount_that_looks_like_a_slope_is_named_where_positions_do_not_tell(std_m: float, named: bool):
    """The flight is 1.2 m long and 0.4 m wide."""
    flight = flown(3)
    flight = askew(replace(flight, gps=gps_of(flight, std_m)), np.radians([3.0, 0.0]))
    estimate = optimize(flight)
    assert ("the ground of the map slopes by 3.0°" in estimate.status) == named


@pytest.mark.slow
def test_a_mount_that_is_right_makes_no_slope():
    flight = flown(3)
    assert optimize(replace(flight, gps=gps_of(flight, 0.02))).status == "ok"
