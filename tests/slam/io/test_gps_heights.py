"""The vertical datum of a GPS in a flight folder, and the place of its antenna."""

import dataclasses

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.io.flight_folder import read_flight, write_flight
from tests.slam.io.made_flight import made_flight


def test_the_antenna_s_place_survives(tmp_path):
    flight = made_flight()
    mount = np.eye(4)
    mount[:3, 3] = [0.1, -0.2, 0.3]
    gps = dataclasses.replace(flight.gps, b_T_s=mount, antenna_std_m=0.05)
    write_flight(dataclasses.replace(flight, gps=gps), tmp_path / "flight")
    back = read_flight(tmp_path / "flight").gps
    np.testing.assert_array_equal(back.b_T_s, mount)
    assert back.antenna_std_m == 0.05


@pytest.mark.parametrize("system", ["EPSG:4979", "EPSG:5773", "EPSG:5783", ""])
def test_the_level_of_altitudes_survives(tmp_path, system):
    flight = made_flight()
    gps = dataclasses.replace(flight.gps, height_system=system)
    write_flight(dataclasses.replace(flight, gps=gps), tmp_path / "flight")
    back = read_flight(tmp_path / "flight")
    assert back.gps.height_system == back.geo_origin().height_system == system


@pytest.mark.parametrize(
    ("written", "system"),
    [("sea level", "EPSG:5773"), ("Ellipsoid", "EPSG:4979"), ("epsg:5783", "EPSG:5783")],
)
def test_the_level_of_altitudes_has_words(tmp_path, written, system):
    write_flight(made_flight(), tmp_path / "flight")
    with (tmp_path / "flight/mav0/gps0/sensor.yaml").open("a") as file:
        file.write(f"height_system: {written}\n")
    assert read_flight(tmp_path / "flight").gps.height_system == system


@pytest.mark.parametrize("written", ["geoid", "EPSG:99999", "EPSG:32632", "EPSG:5715"])
def test_a_level_that_is_not_known_is_refused(tmp_path, written):
    """The last one has depths, positive downwards."""
    write_flight(made_flight(), tmp_path / "flight")
    with (tmp_path / "flight/mav0/gps0/sensor.yaml").open("a") as file:
        file.write(f"height_system: {written}\n")
    with pytest.raises(InputError, match=r"height_system is .*write ellipsoid, sea level"):
        read_flight(tmp_path / "flight")
