"""Steps in the floor: found with their height and taken out; spikes, climbs and noise are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.readings import ATTITUDE, SONAR
from slam.criticism.kalman.record import record_of
from slam.criticism.residuals.corrected_readings import range_residuals, without_boxes
from slam.data_quality.boxes import find_boxes
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

PLAN = ["three speeds forward: 0.1, 0.2, 0.4", "brisk climb steps at full stick"]


def slower():
    return at_lower_rates(load_model("nominal"))


@pytest.fixture(
    scope="module",
    params=[pytest.param(False, id="gaussian"), pytest.param(True, id="student", marks=pytest.mark.slow)],
)
def records(request):
    model = slower()
    return [
        record_of(simulate_flight(model, stick_for(PLAN), seed, student=request.param)) for seed in (3, 4)
    ]


def over(record, height, crowded=False):
    """The record with boxes under some segments of it, or under most, and where."""
    rows = np.flatnonzero(record.kinds == SONAR)
    below = np.sin(2 * np.pi * record.times_s[rows] / 4.3) > (-0.4 if crowded else 0.6)
    values = record.values.copy()
    values[rows[below], 0] -= height
    return replace(record, values=values), below


@pytest.mark.parametrize("height", [0.08, 0.3, 0.9])
def test_boxes_are_found_and_taken_out(records, height):
    raised = [over(r, height) for r in records]
    levelled, found = without_boxes([r for r, _ in raised], filter_parameters_of(slower()))
    assert [o.name for o in found] == ["floor_steps"]
    size = found[0].parameters["height"]
    assert size.value == pytest.approx(height, abs=0.01)
    share = np.concatenate([b for _, b in raised]).mean()
    assert found[0].parameters["share"].value == pytest.approx(share, abs=0.05)
    # Each flight's boxes are as high as the other's.
    own = find_boxes([range_residuals(r, filter_parameters_of(slower())) for r, _ in raised])
    assert all(nats > 0.5 * o.gain_nats for o, nats in zip(own, found[0].gain.parts, strict=True))
    for was, now in zip(records, levelled, strict=True):
        rows = was.kinds == SONAR
        off = now.values[rows, 0] - was.values[rows, 0]
        assert np.nanmean(np.abs(off) > 0.5 * height) < 0.03


def test_boxes_of_many_heights_are_one_floor_with_steps(records):
    """Each box has its own height, and a reading now and then is far off."""
    heights = (0.08, 0.33, 0.15, 0.24)
    rng = np.random.default_rng(1)
    raised = []
    for record in records:
        rows = np.flatnonzero(record.kinds == SONAR)
        turn = record.times_s[rows] / 4.3
        over_m = np.where(np.sin(2 * np.pi * turn) > 0.4, np.take(heights, turn.astype(int) % 4), 0.0)
        values = record.values.copy()
        values[rows, 0] -= over_m
        values[rows[rng.random(len(rows)) < 0.01], 0] += 0.4
        raised.append((replace(record, values=values), over_m))
    levelled, found = without_boxes([r for r, _ in raised], filter_parameters_of(slower()))
    assert [o.name for o in found] == ["floor_steps"]
    assert found[0].parameters["height"].value == pytest.approx(np.mean(heights), abs=0.04)
    share = np.mean(np.concatenate([over_m for _, over_m in raised]) > 0.0)
    assert found[0].parameters["share"].value == pytest.approx(share, abs=0.05)
    assert all(reported > 100.0 for reported in found[0].gain.parts)
    for was, now, (_, over_m) in zip(records, levelled, raised, strict=True):
        rows = was.kinds == SONAR
        off = now.values[rows, 0] - was.values[rows, 0]
        assert np.nanmean(np.abs(off[over_m > 0.0]) > 0.05) < 0.06


def levelled_by_m(records, raised):
    """What was made of each flight's ranges, off what they are over a level floor."""
    levelled, found = without_boxes([r for r, _ in raised], filter_parameters_of(slower()))
    assert [o.name for o in found] == ["floor_steps"]
    assert found[0].parameters["share"].value < 0.5
    ranges = [
        (r.values[r.kinds == SONAR, 0], n.values[r.kinds == SONAR, 0])
        for r, n in zip(records, levelled, strict=True)
    ]
    return [now - was for was, now in ranges]


def test_a_flight_that_is_over_boxes_for_most_of_its_time_is_levelled_to_the_same_floor(records):
    off = levelled_by_m(records, [over(r, 0.2, crowded=k == 0) for k, r in enumerate(records)])
    assert all(np.nanmean(np.abs(o) > 0.1) < 0.03 for o in off)


def test_what_lies_below_most_readings_is_a_pit(records):
    off = levelled_by_m(records, [over(r, 0.2, crowded=True) for r in records])
    assert all(np.nanmean(np.abs(o + 0.2) > 0.1) < 0.03 for o in off)


def test_under_tilts_boxes_are_as_high_as_they_are():
    """A range is longer than the height where the vehicle leans; what goes with the motion eats no box."""
    model = slower()
    record = record_of(simulate_flight(model, stick_for(["tilts of 15 deg to all four sides"] * 2), 1))
    roll, pitch = (
        np.interp(record.times_s, record.times_s[at], record.values[at, axis])
        for at in [record.kinds == ATTITUDE] for axis in range(2)
    )  # fmt: skip
    rows = np.flatnonzero(record.kinds == SONAR)
    below = np.sin(2 * np.pi * record.times_s[rows] / 3.1) > 0.4
    values = record.values.copy()
    values[rows[below], 0] -= 0.35 / (np.cos(roll) * np.cos(pitch))[rows[below]]
    levelled, found = without_boxes([replace(record, values=values)], filter_parameters_of(model))
    assert found[0].parameters["height"].value == pytest.approx(0.35, abs=0.012)
    off = levelled[0].values[rows, 0] - record.values[rows, 0]
    assert np.sqrt(np.nanmean(off**2)) < 0.02


@pytest.mark.parametrize("left_out", ["all", "first", "most", "high"])
def test_flights_with_little_sonar_information_are_unchanged(records, left_out):
    def silent(record, k):
        values, sonar = record.values.copy(), record.kinds == SONAR
        rows = np.flatnonzero(sonar)
        if left_out == "high":
            values[sonar, 0] = 0.28
        elif left_out == "most":
            values[rows[np.arange(len(rows)) % 5 > 0], 0] = np.nan
        elif left_out == "all" or k == 0:
            values[sonar, 0] = np.nan
        return replace(record, values=values)

    quiet = [silent(record, k) for k, record in enumerate(records)]
    assert without_boxes(quiet, filter_parameters_of(slower())) == (quiet, [])


def test_a_level_floor_has_none(records):
    same, found = without_boxes(records, filter_parameters_of(slower()))
    assert found == []
    assert same == records


@pytest.mark.parametrize("share", [0.04, 0.1])
def test_second_echoes_are_none(records, share):
    rng = np.random.default_rng(0)
    spiked = []
    for record in records:
        values = record.values.copy()
        rows = np.flatnonzero(record.kinds == SONAR)
        values[rows[rng.random(len(rows)) < share], 0] *= 1.98
        spiked.append(replace(record, values=values))
    assert without_boxes(spiked, filter_parameters_of(slower()))[1] == []
