"""Decimal marks, cells that are no numbers, and coordinates in other units."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.errors import InputError
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.tables.made_table import lines_with, table


@pytest.mark.parametrize(
    ("header", "rows"),
    [
        ("time [s];range [m]", ("0,5;1,25", "1,5;1,75")),
        ("time [s]\trange [m]", ("0,5\t1,25", "1,5\t1,75")),
        ("time [s],range [m]", ('"0,5","1,25"', '"1,5","1,75"')),
        ("time [s];range [m]", ("0.5;1.25", "1.5;1.75")),
        ("time [s];range [m]", ("5,000e-01;1,2500e+00", "1,500e+00;1,7500e+00")),
    ],
)
def test_decimal_commas_are_those_of_the_whole_table(tmp_path, header, rows):
    flight = read(table(tmp_path / "a.csv", header, *rows))
    assert flight.sonar.range_m.tolist() == [1.25, 1.75]
    assert flight.sonar.stamps_s.tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("header", "cell"),
    [
        ("time [s];latitude;longitude;altitude [ft]", "1,602"),
        ("time [s],latitude,longitude,altitude [m]", "1,488.20"),
        ("time [s],latitude,longitude,altitude [m]", "4880,00"),
        ("time [s],latitude,longitude,altitude [m]", "488 m"),
    ],
)
def test_cells_that_are_no_numbers_are_counted_and_shown(tmp_path, header, cell):
    mark = ";" if ";" in header else ","
    rows = [mark.join((f"{k}.5", f"51.{k}", "8.25", f'"{cell}"')) for k in range(3)]
    flight = read(table(tmp_path / "a.csv", header, *rows))
    assert np.isnan(flight.gps.altitude_m).all()
    assert lines_with(flight, ["altitude", f"3 of 3 cells are no numbers, first '{cell}' in line 2"])


def test_cells_without_a_reading_are_no_fault(tmp_path):
    rows = (f"{k},{cell}" for k, cell in enumerate(("1.5", "", "NaN", "null", "-", "1.6")))
    flight = read(table(tmp_path / "a.csv", "time [s],range [m]", *rows))
    assert np.isfinite(flight.sonar.range_m).sum() == 2
    assert not lines_with(flight, ["no number"])


def test_commas_that_may_separate_thousands_are_refused(tmp_path):
    path = table(tmp_path / "a.csv", "time [s],altitude [ft]", '0,"1,602"', '1,"1,603"')
    with pytest.raises(InputError, match=r"line 2: has '1,602': its comma is a decimal mark, or separates"):
        read(path)


def test_letters_of_coordinates_give_the_hemisphere(tmp_path):
    rows = (f"{k},51.{k}S,0.25° W" for k in range(3))
    flight = read(table(tmp_path / "a.csv", "time [s],latitude,longitude", *rows))
    assert flight.gps.latitude_deg.tolist() == [-51.0, -51.1, -51.2]
    assert flight.gps.longitude_deg[0] == -0.25


@pytest.mark.parametrize(
    ("place", "why"),
    [
        ("473977418,85455939", "latitude 4.73977e+08 degrees is beyond 90; in 1e-7 degrees?"),
        ("4723.86451,832.73563", "latitude 4723.86 degrees is beyond 90; degrees and minutes as in NMEA?"),
    ],
)
def test_positions_beyond_the_earth_are_told_with_a_guess(tmp_path, place, why):
    path = table(tmp_path / "a.csv", "time [s],lat,lon,voltage [V]", *(f"{k},{place},12" for k in range(3)))
    flight = read(path)
    assert flight.gps is None
    assert lines_with(flight, ["gps0: 3 of 3 positions are none and left out", why])


def test_coordinates_in_units_of_receivers(tmp_path):
    path = table(tmp_path / "a.csv", "time [s],lat [degE7],lon [rad]", "0,473977418,0.1", "1,473977419,0.1")
    flight = read(path)
    assert flight.gps.latitude_deg[0] == pytest.approx(47.3977418)
    assert flight.gps.longitude_deg[0] == pytest.approx(np.degrees(0.1))
