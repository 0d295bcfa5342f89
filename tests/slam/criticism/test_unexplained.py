"""Errors that no term describes, in simulated flights: told with their channel."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slam.criticism import criticise, run
from slam.criticism.finding import Onset
from slam.criticism.verdict.over_time import CERTAIN_Z, commanded_onset
from slam.criticism.without_commands.explanation import ComparedFlights
from slam.data_quality.axes import IN_WORLD, wrong_axes
from slam.data_quality.break_in_time import likeliest_break
from slam.data_quality.inertial_comparison import Averages, into_world
from slam.data_quality.jumps import Jump
from slam.data_quality.whitened_rows import WhitenedRows
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from tests.benchmarks.injected_errors import KINDS
from tests.slam.criticism.judged_flights import NOMINAL, SLOWER, judged

SHOWN = 400


def segments(rng: np.random.Generator, jump: float, count: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Scores and information of segments whose size jumps in the middle."""
    information = rng.uniform(0.5, 2.0, count)
    size = jump * (np.arange(count) >= count // 2)
    return information * size + np.sqrt(information) * rng.normal(size=count), information


def test_chance_hardly_makes_an_onset_and_a_jump_does():
    rng = np.random.default_rng(1)
    z = np.array([likeliest_break(*segments(rng, 0.0), 0.0)[2] for _ in range(SHOWN)])
    # Andrews (1993), table I: 8.85 is the 5 % point of the square for one parameter.
    assert np.mean(z > np.sqrt(8.85)) < 0.05
    assert np.median(z) > 0.5
    assert np.mean(z > 5.0) == 0.0
    place, change, z_jump = likeliest_break(*segments(rng, 8.0), 0.0)
    assert abs(place - 12) <= 1
    assert change == pytest.approx(8.0, abs=1.5)
    assert z_jump > 5.0


@pytest.mark.parametrize("jump", [0.0, 4.0])
def test_an_onset_is_told_though_the_noise_of_the_rows_has_it_in_it(jump):
    """A bias that begins half-way makes the rows of a minute scatter, from which they take their noise."""
    times_s, rng = 0.5 * np.arange(120), np.random.default_rng(3)
    off = rng.normal(size=120) + jump * (times_s >= 30.0)
    off, bias = (x / off.std() for x in (off, np.ones(120)))
    kept = np.ones(120, bool)
    averages = Averages("yaw from the gyro", "rad", 1, times_s, kept, 0 * kept, [], off[:, None])
    rows = WhitenedRows("attitude", times_s, off, {"gyro_bias.z": bias}, 1.0, averages)
    parts = ComparedFlights._parts(SimpleNamespace(rows=[[rows]], flights=[SimpleNamespace(name="a")]), 5.0)
    own = parts.fisher.columns.index("gyro_bias.z")
    score, information = parts.fisher.score[:, own], parts.fisher.information[:, own, own]
    place, change, z = likeliest_break(score, information, 1e-3)
    assert (z > CERTAIN_Z) == (jump > 0.0)
    if jump:
        assert place == 6
        assert change == pytest.approx(jump, rel=0.1)


def test_a_tolerance_hides_a_jump_below_it():
    assert likeliest_break(*segments(np.random.default_rng(2), 8.0), 8.0)[2] < 1.5


def turning_flight():
    """A flight that turns, and then speeds up either way."""
    return simulate_flight(SLOWER, stick_for(["yaw steps at 0.3, 0.6 and 1", "reversing forward at 0.2"]), 3)


def with_turned_pitch_and_yaw(flight):
    """With an attitude in another convention than that of the format."""
    turned = flight.attitude.roll_pitch_yaw_rad * [1.0, -1.0, -1.0]
    return replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=turned))


def test_flights_of_wrong_axes_are_not_searched(monkeypatch):
    reasons = []
    monkeypatch.setattr(run, "explain_comparisons", lambda *known: reasons.append(known[3]))
    criticise([with_turned_pitch_and_yaw(turning_flight())])
    assert reasons == [run.WRONG_AXES]


@pytest.mark.slow
def test_wrong_axes_of_flights_with_commands_are_told():
    found = criticise([with_turned_pitch_and_yaw(turning_flight())])
    assert found.verdict == "unknown"
    assert "pitch disagrees with the gyro, but agrees with its sign turned over" in found.remainder
    assert "motion is not judged" in found.limits
    assert "no command log" not in " ".join(found.dropped)


def test_a_velocity_in_axes_of_the_world_is_told():
    flight = turning_flight()
    stamps_s, angles = flight.attitude.stamps_s, flight.attitude.roll_pitch_yaw_rad
    yaw = np.interp(flight.velocity.stamps_s, stamps_s, np.unwrap(angles[:, 2]))
    in_world = into_world(yaw, flight.velocity.v_m_s)
    found, _ = wrong_axes(replace(flight, velocity=replace(flight.velocity, v_m_s=in_world)))
    assert [str(told) for told in found] == [IN_WORLD]
    assert wrong_axes(flight)[0] == []


@pytest.mark.slow
def test_wrong_axes_are_told_and_right_ones_are_not():
    from tests.slam.criticism.without_commands.unsteered import flights

    for flight in flights():
        assert wrong_axes(flight)[0] == []
    flight = flights()[2]
    swapped = replace(flight, velocity=replace(flight.velocity, v_m_s=flight.velocity.v_m_s[:, ::-1]))
    turned = replace(flight, velocity=replace(flight.velocity, v_m_s=-flight.velocity.v_m_s))
    assert any(
        "velocity ahead reads the velocity to the left" in found.text for found in wrong_axes(swapped)[0]
    )
    assert any("its sign turned over" in found.text for found in wrong_axes(turned)[0])


@pytest.mark.slow
@pytest.mark.parametrize("stream", ["sonar", "velocity"])
def test_a_frozen_stream_is_told_on_flights_with_commands(stream):
    # The range of a climb, and the speed of runs: what stands still is not frozen.
    frozen = KINDS[f"{stream} frozen"]
    plan = ["three speeds forward: 0.1, 0.2, 0.4", "brisk climb steps at full stick"]
    made = [simulate_flight(SLOWER, stick_for(plan), seed) for seed in (1, 2)]
    found = criticise([frozen.inject(flight, frozen.sizes[2]) for flight in made], SLOWER)
    assert found.causes == ()
    assert f"the {stream} repeats its reading" in found.remainder
    assert found.verdict == "unknown"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "size", "told"),
    [
        ("gyro bias half-way", 0.02, ("gyro_bias", "x", "")),
        ("velocity bias half-way", 0.1, ("", "", "velocity_x")),
    ],
)
def test_what_begins_within_a_flight_with_commands_is_told_with_its_moment(name, size, told):
    plan = ["three speeds forward: 0.1, 0.2, 0.4", "tilts of 15 deg to all four sides"]
    healthy, other = (simulate_flight(SLOWER, stick_for(plan), seed) for seed in (1, 2))
    found = criticise([healthy, KINDS[name].inject(other, size)], SLOWER)
    change = next(finding for finding in found.findings if isinstance(finding, Onset))
    assert (change.effect, change.parameter, change.channel) == told
    assert change.flight == other.name
    assert change.time_s == pytest.approx(other.imu.stamps_s[[0, -1]].mean(), abs=1.5)
    assert change.change == pytest.approx(size, rel=0.25)


@pytest.mark.slow
def test_a_sonar_whose_zero_jumps_within_a_flight_with_commands_is_told():
    flight = simulate_flight(SLOWER, stick_for(["three speeds forward: 0.1, 0.2, 0.4"]), 1)
    middle_s = flight.sonar.stamps_s[[0, -1]].mean()
    range_m = flight.sonar.range_m + 0.1 * (flight.sonar.stamps_s > middle_s)
    found = criticise([replace(flight, sonar=replace(flight.sonar, range_m=range_m))], SLOWER)
    (jump,) = (finding for finding in found.findings if isinstance(finding, Jump))
    assert (jump.channel, jump.count) == ("range", 1)
    assert jump.size == pytest.approx(0.1, rel=0.2)
    assert jump.time_s == pytest.approx(middle_s, abs=0.2)


@pytest.mark.slow
def test_a_range_that_jumps_there_and_back_twice_is_told_without_commands():
    flight = simulate_flight(SLOWER, stick_for(["three speeds forward: 0.1, 0.2, 0.4", "hover for 8 s"]), 1)
    since_s = flight.sonar.stamps_s - flight.imu.stamps_s[0]
    off = ((since_s > 6.0) & (since_s < 9.0)) | ((since_s > 13.0) & (since_s < 16.0))
    moved = replace(
        flight, command=None, sonar=replace(flight.sonar, range_m=flight.sonar.range_m + 0.1 * off)
    )
    found = criticise([moved], SLOWER)
    (jump,) = (finding for finding in found.findings if isinstance(finding, Jump))
    assert (jump.channel, jump.count) == ("range", 4)
    assert str(jump).endswith("it does so 4 times, as over steps of the floor")
    assert found.verdict == "unknown"
    assert not any(isinstance(f, Jump) for f in criticise([replace(flight, command=None)], SLOWER).findings)


def test_jumps_are_told_of_judged_flights_alone(monkeypatch):
    flights = [SimpleNamespace(name=name) for name in ("judged", "left out")]
    prepared = SimpleNamespace(records=[SimpleNamespace(name="judged")], nominal=None, limits=None)
    monkeypatch.setattr(run, "without_frozen", lambda flights: (flights, []))
    monkeypatch.setattr(run, "prepare", lambda *known: prepared)
    monkeypatch.setattr(run, "search", lambda *known: None)
    monkeypatch.setattr(run, "jumps_of_all", lambda flights, lags: [flight.name for flight in flights])
    monkeypatch.setattr(run, "explain", lambda prepared, found, readings, *known: readings)
    monkeypatch.setattr(run, "judge", lambda readings: readings)
    assert run._with_commands(flights, None, None) == ["judged"]


def test_flights_without_usable_readings_have_no_onset():
    (record,) = judged([simulate_flight(SLOWER, stick_for(["hover for 8 s"]), 1)])
    blind = replace(record, values=np.full_like(record.values, np.nan))
    expansion = SimpleNamespace(effects=(), patterns=())
    found = SimpleNamespace(last=expansion, chosen=(), records=(blind,))
    assert commanded_onset(found, NOMINAL, CERTAIN_Z) is None


def test_a_change_stands_out_more_where_rows_are_known_to_be_white():
    score, information = segments(np.random.default_rng(4), 8.0, 10)
    (_, change, z), (_, same, white_z) = (likeliest_break(score, information, 0.0, w) for w in (False, True))
    assert change == same
    assert white_z > 1.3 * z
