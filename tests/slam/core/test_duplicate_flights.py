"""A recording that is given twice is used once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.duplicate_flights import same_recording, shared_s, without_duplicates, without_overlaps
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.join_flights import join_flights
from slam.core.messages import warning
from slam.core.streams import Sonar
from slam.criticism import criticise
from slam.simulation import simulate
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model
from tests.slam.small_flight import recipe


@pytest.fixture(scope="module")
def one() -> Flight:
    return simulate(recipe(), seed=1)


def test_a_copy_is_detected_under_another_name_and_without_some_streams(one: Flight):
    copy = replace(one, name="copy", sonar=None, velocity=None)
    assert same_recording(one, copy)
    said = f"copy: the same recording as {one.name}"
    assert without_duplicates([one, copy]) == ([one], [said])
    assert without_overlaps([one, copy]) == ([one], [warning(said, "it was left out")])


def test_different_flights_are_no_copies(one: Flight):
    other = simulate(recipe(), seed=2)
    assert not same_recording(one, other)
    assert without_duplicates([one, other]) == ([one, other], [])


def test_a_flight_with_few_readings_is_no_copy():
    def flight(values: list[float]) -> Flight:
        return Flight("f", sonar=Sonar(np.arange(len(values), dtype=float), np.array(values)))

    assert not same_recording(flight([1.0] * 3), flight([1.0] * 3))
    assert not same_recording(flight([np.nan] * 20), flight([np.nan] * 20))
    assert same_recording(flight([1.0, np.nan] * 10), flight([1.0, np.nan] * 10))


def test_joining_a_recording_with_its_copy_is_refused(one: Flight):
    with pytest.raises(InputError, match=r"the same recording as .*; give it once"):
        join_flights([one, replace(one, name="again")])


def part(flight: Flight, begin_s: float, end_s: float, shift_s: float = 0.0) -> Flight:
    """Return a cut of a flight's imu and sonar, with stamps that are shifted."""
    imu, sonar = flight.imu, flight.sonar
    assert imu is not None
    assert sonar is not None
    kept, ranges = ((s.stamps_s >= begin_s) & (s.stamps_s < end_s) for s in (imu, sonar))
    cut = replace(
        imu,
        stamps_s=imu.stamps_s[kept] - shift_s,
        gyro_rad_s=imu.gyro_rad_s[kept],
        accel_m_s2=imu.accel_m_s2[kept],
    )
    beside = replace(sonar, stamps_s=sonar.stamps_s[ranges] - shift_s, range_m=sonar.range_m[ranges])
    return Flight(f"from {begin_s:g} s", imu=cut, sonar=beside)


@pytest.mark.parametrize("shift_s", [0.0, 3.0])
def test_cuts_that_share_readings_are_no_two_flights(one: Flight, shift_s: float):
    assert one.imu is not None
    begin_s, end_s = one.imu.stamps_s[[0, -1]]
    third_s = (end_s - begin_s) / 3
    first = part(one, begin_s, begin_s + 2 * third_s)
    second, last = (part(one, begin_s + k * third_s, end_s, shift_s) for k in (1, 2))
    assert abs(shared_s(first, second) - third_s) < 0.1
    kept, notes = without_overlaps([first, second, last])
    assert kept == [first, last]
    assert len(notes) == 1
    assert f"of its readings are in {first.name} too; it was left out" in str(notes[0])


@pytest.mark.slow
def test_criticism_uses_a_copied_recording_once():
    flight = simulate_flight(load_model("nominal"), stick_for(["climb and descend by 0.6 m"]), 1)
    verdict = criticise([flight, replace(flight, name="again")])
    assert verdict.flights == (flight.name,)
    assert f"again: the same recording as {flight.name}; it was left out" in verdict.dropped


def test_flights_without_readings_share_none():
    empty = Flight("f", sonar=Sonar(np.zeros(0), np.zeros(0)))
    assert shared_s(empty, empty) == 0.0
