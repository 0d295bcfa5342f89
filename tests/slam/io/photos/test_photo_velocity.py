"""Velocity of the vehicle at photographs, by DJI's tags."""

import numpy as np
import pytest

from slam.io.flight_folder import read_flight
from slam.io.flight_writer import write_flight
from slam.io.photos.import_photos import import_photos
from tests.slam.io.photos.photo_files import fill, strip, warned

NORTH_M_S = 5.57
"""Speed of `strip`."""


def tags(north: float, east: float = 0.0, down: float = 0.0) -> dict[str, str]:
    values = zip("XYZ", (north, east, down), strict=True)
    return {f"Flight{axis}Speed": f"{value:+.2f}" for axis, value in values}


def test_north_east_and_down_become_east_north_and_up(tmp_path):
    flight = import_photos(fill(tmp_path / "p", strip(5, drone=tags(5.6, 0.3, -0.2))))
    np.testing.assert_allclose(flight.frames.w_v_m_s, [[0.3, 5.6, 0.2]] * 5)
    write_flight(flight, tmp_path / "f")
    back = read_flight(tmp_path / "f")
    np.testing.assert_array_equal(back.frames.w_v_m_s, flight.frames.w_v_m_s)


@pytest.mark.parametrize("wrong", [tags(0.0, NORTH_M_S), tags(-NORTH_M_S), tags(0.0)])
def test_tags_that_the_positions_contradict_are_left_out(tmp_path, wrong):
    """A DJI FC6360 writes the speed north under the name of that east, and 0 under its own."""
    flight = import_photos(fill(tmp_path, strip(5, drone=wrong)))
    assert flight.frames.w_v_m_s is None
    assert warned(flight, "contradict the positions", "m/s")


def test_a_photograph_without_the_tags_has_no_velocity(tmp_path):
    files = strip(5, drone=tags(NORTH_M_S)) | {"P2.jpg": strip(5)["P2.jpg"]}
    velocity = import_photos(fill(tmp_path, files)).frames.w_v_m_s
    assert np.isnan(velocity).all(axis=1).tolist() == [False, False, True, False, False]


def test_without_tags_there_is_none(tmp_path):
    flight = import_photos(fill(tmp_path / "p", strip(5)))
    assert flight.frames.w_v_m_s is None
    write_flight(flight, tmp_path / "f")
    assert read_flight(tmp_path / "f").frames.w_v_m_s is None
