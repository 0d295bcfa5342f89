"""A delay of the pictures that is well known is taken out, any other is held and told."""

from __future__ import annotations

import numpy as np
import pytest

from backend.bundle.graph import ScalePrior
from backend.inertial_scale.scale import InertialScale
from slam.core.flight import Flight
from slam.mapping.clock_offset import correctable_delay, delay_warning, shift_instrument_stamps
from slam.mapping.inertial_scale import AccelerometerScale
from tests.slam.io.made_flight import made_flight

NONE = (0.0, 0.0, 0.0)


def shown(delay_s: float, std_s: float) -> AccelerometerScale:
    found = InertialScale(1.0, 0.01, NONE, NONE, NONE, NONE, delay_s, std_s, NONE)
    return AccelerometerScale(found, ScalePrior(1.0, 0.02), 0.05)


@pytest.mark.parametrize(
    ("delay_s", "std_s", "taken_out_s"),
    [
        (0.04, 0.002, 0.04),
        (-0.06, 0.002, -0.06),
        (0.02, 0.001, 0.0),  # a cheap camera's stamps
        (0.04, 0.01, 0.0),  # chance
        (0.0999, 0.001, 0.0),  # as far as was looked: it may be more
        (0.04, np.inf, 0.0),
    ],
)
def test_a_delay_is_taken_out_where_it_is_sure(delay_s, std_s, taken_out_s):
    assert correctable_delay(shown(delay_s, std_s)) == taken_out_s
    assert correctable_delay(None) == 0.0


def test_what_is_told_names_what_was_done():
    assert "40 ± 2 ms after" in delay_warning(shown(0.001, 0.002), 0.039)
    assert "corrected in the map" in delay_warning(shown(0.001, 0.002), 0.039)
    assert "or more" in delay_warning(shown(-0.0999, 0.001), 0.0)
    assert "cannot be determined" in delay_warning(shown(0.04, np.inf), 0.0)
    assert delay_warning(shown(0.01, 0.001), 0.0) == ""
    assert delay_warning(None, 0.0) == ""


def test_only_the_instruments_stamps_move():
    flight = made_flight()
    later = shift_instrument_stamps(flight, 0.03)
    for name in ("imu", "sonar", "attitude", "velocity", "battery", "motor", "gps", "barometer"):
        moved = getattr(later, name).stamps_s - getattr(flight, name).stamps_s
        np.testing.assert_allclose(moved, 0.03, atol=1e-12)
    assert later.truth is flight.truth
    assert later.command is flight.command
    assert later.frames is flight.frames


def test_a_stream_that_was_not_recorded_has_no_stamps_to_move():
    assert shift_instrument_stamps(Flight("nothing"), 0.03) == Flight("nothing")
