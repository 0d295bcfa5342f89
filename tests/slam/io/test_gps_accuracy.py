"""The accuracy of fixes in degrees, as the format has it, and in metres, as people write it."""

import math

import pytest

from slam.io.gps_accuracy import accuracy_in_metres

DEGREE_M = math.pi / 180 * 6378137.0


@pytest.mark.parametrize(
    "metres", [(0.01, 0.01, 0.02), (0.02, 0.02, 0.03), (0.09, 0.09, 0.15), (1.5, 1.5, 3.0)]
)
def test_both_units_give_the_same_accuracy(metres):
    north, east, up = metres
    notes = []
    in_degrees = accuracy_in_metres((north / DEGREE_M, east / DEGREE_M, up), 0.0, notes)
    assert notes == []
    assert in_degrees == pytest.approx((east, north, up), rel=1e-9)
    assert accuracy_in_metres(metres, 0.0, notes) == (east, north, up)
    assert len(notes) == 1
    assert "taken as metres" in str(notes[0])


@pytest.mark.parametrize("metres", [150.0, 900.0, 4000.0])
def test_a_bad_fix_in_degrees_is_not_taken_for_a_good_one_in_metres(metres):
    notes = []
    found = accuracy_in_metres((metres / DEGREE_M, metres / DEGREE_M, 2 * metres), 0.0, notes)
    assert found == pytest.approx((metres, metres, 2 * metres), rel=1e-9)
    assert "taken as degrees" in str(notes[0])
