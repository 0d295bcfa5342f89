"""Data that cannot be judged are reported in one line, and never called a cause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.flight import Flight
from slam.criticism import criticise
from slam.criticism.kalman.record import record_of
from slam.criticism.prepare import is_out_of_model, usable_records
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import REST, stick_for
from slam.simulation.model import load_model

STREAMS = ("imu", "attitude", "velocity", "sonar")


@pytest.fixture(scope="module")
def flight():
    return simulate_flight(load_model("nominal"), stick_for(["climb and descend by 0.6 m"]), 1)


def unusable(flight):
    found = criticise([flight])
    assert found.verdict == "unusable"
    assert found.causes == ()
    assert "\n" not in found.sentence
    return " ".join([found.sentence, *found.details])


def test_a_flight_that_never_moves(flight):
    still = replace(flight, command=replace(flight.command, stick=0.0 * flight.command.stick))
    assert "never moved" in unusable(still)


def test_sticks_that_move_while_the_vehicle_stands(flight):
    angles, stick = 0.03 * flight.attitude.roll_pitch_yaw_rad, flight.command.stick.copy()
    stick[:, 1] = np.where(np.arange(len(stick)) % 2 == 1, 0.8, 0.0)
    standing = replace(
        flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles),
        command=replace(flight.command, stick=stick),
    )  # fmt: skip
    assert "the vehicle stands: the sticks move by 0.80, and its tilt by 0.0" in unusable(standing)


def test_a_hover_is_judged_beside_flights_that_move(flight):
    hover = simulate_flight(load_model("nominal"), stick_for(["hover for 8 s"]), 2)
    records, dropped = usable_records([flight, hover])
    assert len(records) == 2
    assert not dropped
    # A stick at rest under a vehicle that tilts is a log that was lost.
    lost = replace(flight, command=replace(flight.command, stick=0.0 * flight.command.stick))
    tilting = replace(
        lost, attitude=replace(lost.attitude, roll_pitch_yaw_rad=3.0 * lost.attitude.roll_pitch_yaw_rad)
    )
    records, dropped = usable_records([flight, tilting])
    assert len(records) == 1
    assert "never moved" in dropped[0]


def test_what_follows_a_pause_is_reported_as_not_judged():
    flight = simulate_flight(
        load_model("nominal"), stick_for(["climb and descend by 0.6 m", "hover for 8 s"]), 1
    )

    def without(stream, begin_s, end_s):
        kept = (stream.stamps_s < begin_s) | (stream.stamps_s > end_s)
        values = {
            name: value[kept] for name, value in vars(stream).items() if np.shape(value)[:1] == kept.shape
        }
        return replace(stream, **values)

    for begin_s, judged in ((5.0, 1), (0.5, 0)):
        streams = {n: without(getattr(flight, n), begin_s, begin_s + 6.0) for n in STREAMS}
        records, dropped = usable_records([replace(flight, **streams)])
        assert len(records) == judged
        assert "no readings for 5 s or more" in dropped[0]
    records, dropped = usable_records([flight])
    assert (len(records), dropped) == (1, [])


def test_a_hover_alone_shows_lasting_effects_if_a_sonar_shows_that_it_flies():
    hover = simulate_flight(load_model("nominal"), stick_for(["hover for 8 s"]), 2)
    assert len(usable_records([hover])[0]) == 1
    # On the floor the sonar is too near to see.
    standing = replace(hover.sonar, range_m=np.full_like(hover.sonar.range_m, np.nan))
    for sonar in (standing, None):
        assert not usable_records([replace(hover, sonar=sonar)])[0]
    slow = replace(hover, attitude=None)
    assert len(usable_records([slow])[0]) == 1
    fast = replace(slow, velocity=replace(slow.velocity, v_m_s=20.0 * slow.velocity.v_m_s))
    assert not usable_records([fast])[0]


def test_a_log_on_another_clock(flight):
    late = replace(flight, command=replace(flight.command, stamps_s=flight.command.stamps_s + 4000))
    assert "another clock" in unusable(late)


def test_no_command_and_no_readings(flight):
    assert "no command log" in unusable(replace(flight, command=None))
    assert "no usable imu" in unusable(replace(flight, imu=None, attitude=None, velocity=None, sonar=None))


def test_a_stick_motion_that_no_instrument_shows_is_reported_and_not_called_healthy(flight):
    few = slice(None, None, 30)
    attitude = replace(
        flight.attitude,
        stamps_s=flight.attitude.stamps_s[few],
        roll_pitch_yaw_rad=flight.attitude.roll_pitch_yaw_rad[few],
    )
    reported = unusable(replace(flight, attitude=attitude, imu=None, velocity=None, sonar=None))
    assert "the up stick was moved, and no sonar or accelerometer was recorded" in reported
    assert "forward" not in reported
    assert "the attitude was read" in reported


def test_a_dead_stream_is_left_out_and_reported(flight):
    stuck = replace(flight, sonar=replace(flight.sonar, range_m=np.full_like(flight.sonar.range_m, 1.0)))
    records, dropped = usable_records([stuck])
    assert not records[0].has(11)
    assert "sonar never changes" in dropped[0]
    nothing = replace(flight.velocity, v_m_s=np.full_like(flight.velocity.v_m_s, np.nan))
    records, dropped = usable_records([replace(flight, velocity=nothing)])
    assert not records[0].has(9)
    assert "velocity has too few readings (0 of at least 20)" in dropped[0]


def test_an_attitude_that_lies_on_its_side_is_left_out_and_reported(flight):
    angles = flight.attitude.roll_pitch_yaw_rad.copy()
    angles[:, 1] = np.pi / 2
    lying = replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles))
    records, dropped = usable_records([lying])
    assert not records[0].has(6)
    assert records[0].has(11)
    assert "attitude tilts by 90 deg half the time" in dropped[0]


def test_values_that_are_not_finite_are_missing(flight):
    rates = flight.imu.gyro_rad_s.copy()
    rates[100:110] = np.inf
    records, dropped = usable_records([replace(flight, imu=replace(flight.imu, gyro_rad_s=rates))])
    assert not np.isinf(records[0].values).any()
    assert dropped == []


def test_rest_is_rest():
    assert REST[1:] == (0.0, 0.0, 0.0, 0.0)


def test_flights_of_one_name_are_distinguished(flight):
    nothing = Flight("pulses", command=flight.command)
    dropped = criticise([nothing, nothing]).dropped
    assert [line.partition(":")[0] for line in dropped] == ["pulses.1", "pulses.2"]


@pytest.mark.parametrize("stream", ["velocity", "attitude", "sonar"])
def test_a_vehicle_is_of_another_make_by_its_own_figures_and_not_by_what_it_lacks(flight, stream):
    model = load_model("nominal")
    assert not is_out_of_model([record_of(replace(flight, **{stream: None}))], model)
    coarse = {
        "velocity": replace(flight.velocity, noise_std_m_s=(0.2, 0.2)),
        "attitude": replace(flight.attitude, noise_std_rad=(0.1, 0.1, 0.1)),
        "sonar": replace(flight.sonar, noise_std_m=0.1),
    }
    assert is_out_of_model([record_of(replace(flight, **{stream: coarse[stream]}))], model)
