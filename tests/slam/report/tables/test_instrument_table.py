"""The table of a flight's instruments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.core.messages import about, warning
from slam.core.streams import Gps, Scalar
from slam.core.units import error_length, percent
from slam.report.tables.instruments import NOT_USED, instrument_table, unused_instruments
from tests.slam.made_estimate import made_estimate, made_flight, saying

SHARES = {
    "x": {"range": 0.7, "position": 0.3},
    "y": {"range": 0.5, "position": 0.5},
    "scale": {"range": 1.0},
    "ground": {"range": 0.2, "position": 0.8},
}

STATED = "one reading is good to"


def rows_of(estimate, flight):
    (table,) = instrument_table(estimate, flight)
    return {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}


def test_a_source_of_errors_that_is_no_stream_has_shares_alone():
    shares = {**SHARES, "ground": {"flat_floor": 0.7, "position": 0.3}}
    estimate = replace(made_estimate(), information_shares=shares, messages=())
    ground = rows_of(estimate, flown())["how uneven the ground is"]
    assert (ground["place of the ground"], ground["used?"]) == ("70 %", "")


def flown():
    zero = np.zeros(4)
    gps = Gps(np.arange(4.0), zero, zero, zero, noise_std_m=(1.0, 2.0, 4.0))
    return replace(made_flight(), gps=gps, barometer=Scalar(np.arange(3.0), np.zeros(3), 0.5))


def test_each_instrument_states_its_accuracy_its_use_and_its_shares():
    flight = flown()
    estimate = replace(made_estimate(), information_shares=SHARES, messages=())
    found = rows_of(estimate, flight)
    assert found["the GPS"][STATED] == f"{error_length(np.sqrt(2.5))}, height {error_length(4.0)} (stated)"
    sonar = found["the height sensor"][STATED]
    assert sonar.startswith(error_length(flight.sonar.noise_std_m))
    assert f"gain {percent(flight.sonar.scale_std)}" in sonar
    assert found["the GPS"]["used?"] == "yes"
    assert found["the height sensor"]["camera's x and y"] == "60 %"
    assert found["the GPS"]["place of the ground"] == "80 %"
    assert found["the height sensor"]["lengths"] == "100 %"
    assert found["the barometer"]["used?"] == NOT_USED
    assert found["the barometer"]["place of the ground"] == ""


def test_an_assumed_accuracy_is_told_as_assumed():
    flight = flown()
    assumed = replace(flight, gps=replace(flight.gps, assumed=("noise_std",)))
    estimate = replace(made_estimate(), information_shares=SHARES, messages=())
    assert rows_of(estimate, assumed)["the GPS"][STATED].endswith("(assumed)")


def test_an_instrument_that_a_warning_names_is_doubted_and_one_that_a_note_names_is_not():
    messages = (
        about("gps0", "far off: is it held", "compare imu0"),
        warning("barometer0 falls where the camera climbs").concerning("barometer0"),
        about("bare ground", "cam0 sees nothing"),
        about("sonar0", "noted").as_note(),
    )
    shares = {**SHARES, "z": {"pictures": 1.0}}
    estimate = replace(made_estimate(), information_shares=shares, messages=messages)
    found = rows_of(estimate, flown())
    assert found["the GPS"]["doubted?"] == "yes: far off"
    assert found["the barometer"]["doubted?"] == "yes: falls where the camera climbs"
    assert found["the barometer"]["used?"] == "no: it is doubted"
    assert (
        found["the height sensor"]["doubted?"]
        == "no; a note above names an error, which the stated accuracy includes"
    )
    assert found["the pictures themselves"]["doubted?"] == "no", "the ground is at fault"


def test_without_a_refinement_there_is_no_table():
    assert instrument_table(made_estimate(), flown()) == ()
    assert instrument_table(replace(made_estimate(), information_shares=SHARES), None) == ()


def test_readings_that_the_map_does_not_need_count_as_left_out():
    estimate = replace(made_estimate(), information_shares=SHARES, messages=())
    found = {row.what: row for row in unused_instruments(estimate, flown())}
    assert found["Readings of the barometer"].count == 3
    assert found["Readings of the barometer"].no_need_to_act
    assert not any("GPS" in what or "height sensor" in what for what in found), "these are used"
    assert unused_instruments(replace(estimate, information_shares={}), flown()) == ()
    doubted = saying(estimate, "barometer0: climbs 3.28 times as far; check its unit")
    assert unused_instruments(doubted, flown()) == (), "it is left out for another reason"
    assert rows_of(doubted, flown())["the barometer"]["used?"] == "no: it is doubted"
