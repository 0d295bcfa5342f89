"""Jumps of readings that the imu does not show."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from slam.data_quality.anomalies import readings_in_words, without_frozen
from slam.data_quality.frozen import Frozen
from slam.data_quality.jumps import _peaks, jumps
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model


@cache
def flown():
    model = load_model("nominal")
    plan = stick_for(
        ["brisk climb steps at full stick", "three speeds to the side: 0.1, 0.2, 0.4", "hover for 8 s"]
    )
    return simulate_flight(model, plan, 3)


def moved(stream, field, column, size, where):
    """Return the flight with a column of a stream shifted where it holds."""
    series = getattr(flown(), stream)
    values = getattr(series, field).copy()
    values[where(series.stamps_s), *(() if column is ... else (column,))] += size
    return replace(flown(), **{stream: replace(series, **{field: values})})


def test_a_flight_that_moves_and_turns_has_no_jump():
    assert jumps(flown()) == []


@pytest.mark.parametrize(
    ("stream", "field", "column", "size", "channel", "told"),
    [
        ("velocity", "v_m_s", 0, 1.0, "velocity", 1.0),
        ("velocity", "v_m_s", 1, -1.0, "velocity", 1.0),
        ("attitude", "roll_pitch_yaw_rad", 2, 0.5, "yaw", np.degrees(0.5)),
        ("attitude", "roll_pitch_yaw_rad", 0, -0.2, "roll", np.degrees(0.2)),
        ("sonar", "range_m", ..., 0.1, "range", 0.1),
    ],
)
def test_a_reset_is_told_with_its_size_and_its_moment(stream, field, column, size, channel, told):
    at_s = flown().imu.stamps_s[0] + 15.0
    (jump,) = jumps(moved(stream, field, column, size, lambda t: t > at_s))
    assert (jump.channel, jump.count) == (channel, 1)
    assert jump.size == pytest.approx(told, rel=0.2)
    assert jump.time_s == pytest.approx(at_s, abs=0.2)


def test_no_jump_is_told_where_the_attitude_is_frozen():
    attitude = flown().attitude
    angles, begin_s = attitude.roll_pitch_yaw_rad.copy(), attitude.stamps_s[0] + 14.0
    stuck = (attitude.stamps_s >= begin_s) & (attitude.stamps_s < begin_s + 4.0)
    angles[stuck] = angles[stuck][0]
    flight = replace(flown(), attitude=replace(attitude, roll_pitch_yaw_rad=angles))
    assert jumps(flight) != []
    (clean,), (found,) = without_frozen([flight])
    assert isinstance(found, Frozen)
    assert jumps(clean) == []
    assert not any("jumps" in line for line in readings_in_words(flight))


def test_single_wrong_readings_are_no_jump():
    assert jumps(moved("velocity", "v_m_s", 0, 3.0, lambda t: np.arange(len(t)) % 200 == 50)) == []


@pytest.mark.parametrize("begin_s", [3.0, 14.0])
@pytest.mark.parametrize("lasts_s", [0.5, 1.0, 4.0])
def test_a_gap_of_the_imu_is_no_jump_of_a_reading(begin_s, lasts_s):
    imu = flown().imu
    since_s = imu.stamps_s - imu.stamps_s[0] - begin_s
    kept = (since_s < 0.0) | (since_s > lasts_s)
    cut = {k: v[kept] for k, v in vars(imu).items() if np.shape(v)[:1] == kept.shape}
    assert jumps(replace(flown(), imu=replace(imu, **cut))) == []


def test_the_imu_may_end_before_the_other_readings():
    imu = flown().imu
    kept = imu.stamps_s < imu.stamps_s[0] + 14.0
    cut = {k: v[kept] for k, v in vars(imu).items() if np.shape(v)[:1] == kept.shape}
    assert jumps(replace(flown(), imu=replace(imu, **cut))) == []


@pytest.mark.parametrize("share", [0.05, 1.0])
def test_lost_echoes_hide_no_jump(share):
    flight = moved("velocity", "v_m_s", 0, 1.0, lambda t: t > flown().imu.stamps_s[0] + 15.0)
    lost = np.random.default_rng(1).uniform(size=len(flight.sonar.stamps_s)) < share
    sonar = replace(flight.sonar, range_m=np.where(lost, np.nan, flight.sonar.range_m))
    assert [jump.channel for jump in jumps(replace(flight, sonar=sonar))] == ["velocity"]


@pytest.mark.parametrize(("column", "size", "channel"), [(2, 1.0, "yaw"), (0, 0.3, "roll")])
@pytest.mark.parametrize("after_s", [9.0, 12.0])
def test_a_reset_of_the_attitude_is_none_of_the_velocity(column, size, channel, after_s):
    at_s = flown().imu.stamps_s[0] + after_s
    found = jumps(moved("attitude", "roll_pitch_yaw_rad", column, size, lambda t: t > at_s))
    assert [jump.channel for jump in found] == [channel]


def test_two_jumps_are_counted():
    begin_s = flown().imu.stamps_s[0]
    (jump,) = jumps(moved("velocity", "v_m_s", 0, 1.0, lambda t: (t > begin_s + 8.0) & (t < begin_s + 16.0)))
    assert jump.count == 2


def test_a_flight_that_is_too_short_has_none():
    flight = flown()
    begin_s = flight.imu.stamps_s[0]
    velocity = flight.velocity
    kept = velocity.stamps_s < begin_s + 1.2
    short = replace(velocity, stamps_s=velocity.stamps_s[kept], v_m_s=velocity.v_m_s[kept])
    assert jumps(replace(flight, velocity=short)) == []


@pytest.mark.parametrize("late_s", [0.1, 0.2])
def test_a_sonar_that_lags_does_not_jump_with_each_climb(late_s: float):
    sonar = flown().sonar
    lagging = np.interp(sonar.stamps_s - late_s, sonar.stamps_s, sonar.range_m)
    assert jumps(replace(flown(), sonar=replace(sonar, range_m=lagging))) == []


def test_a_rate_that_jumps_between_two_samples_of_the_gyro_is_no_jump_of_the_attitude():
    model = load_model("nominal")
    slow = replace(model, imu=replace(model.imu, rate_hz=60.0))
    plan = stick_for(["hover for 8 s", "0.6 and 0.9 of the stick forward for 0.6 s", "hover for 8 s"])
    assert all(jumps(simulate_flight(slow, plan, seed)) == [] for seed in range(2))


def test_a_range_over_a_box_is_a_step_of_the_floor_where_commands_show_it():
    begin_s = flown().imu.stamps_s[0]
    (box,) = jumps(moved("sonar", "range_m", ..., -0.3, lambda t: (t > begin_s + 8.0) & (t < begin_s + 16.0)))
    assert (box.channel, box.count, box.is_shown_otherwise) == ("range", 2, True)
    (zero,) = jumps(moved("sonar", "range_m", ..., 0.3, lambda t: t > begin_s + 15.0))
    assert (zero.count, zero.is_shown_otherwise) == (1, False)


def test_a_channel_without_any_difference_has_no_jump():
    assert len(_peaks(np.arange(5.0), np.zeros(5), 1.0)) == 0
