"""Recordings of one flight on one clock: what is taken from which, what ties them, and what is refused."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries, Gps, Imu, Scalar, Truth, Velocity
from slam.mapping.recording_clocks.join import join_recordings

LASTS_S, AHEAD_S = 150.0, 40.0
"""Duration of the log, and the time after its beginning at which the other recording begins."""


def curve(rng: np.random.Generator, width: int, step_s: float = 0.5) -> CubicSpline:
    """Return a smooth random function of time with values of size 1."""
    at_s = np.arange(-1.0, LASTS_S + 1.0, step_s)
    return CubicSpline(at_s, rng.normal(size=(len(at_s), width)))


def attitude_of(seed: int, size_rad: float = 0.1):
    angles = curve(np.random.default_rng(seed), 3)
    return lambda at_s: Rotation.from_euler("ZYX", size_rad * angles(at_s))


def log(seed: int = 1, size_rad: float = 0.1) -> Flight:
    """Return an autopilot's log with gyro and battery."""
    stamps_s = np.arange(0.0, LASTS_S, 0.01)
    attitude = attitude_of(seed, size_rad)
    rate = (attitude(stamps_s).inv() * attitude(stamps_s + 1e-4)).as_rotvec() / 1e-4
    rate += np.random.default_rng(seed + 100).normal(0.0, 0.01, rate.shape)
    battery = Scalar(stamps_s[::100], np.linspace(12.0, 11.0, len(stamps_s[::100])))
    return Flight("log", epoch_ns=10**9, imu=Imu(stamps_s, rate, np.zeros_like(rate)), battery=battery)


def gimbal(seed: int = 1, size_rad: float = 0.1, lasts_s: float = 60.0) -> Flight:
    """Return a recording of attitudes and a barometer by another clock, for a part of the flight."""
    stamps_s = np.arange(0.0, lasts_s, 0.1)
    angles = attitude_of(seed, size_rad)(stamps_s + AHEAD_S).as_euler("ZYX")[:, ::-1]
    angles = angles + np.random.default_rng(seed + 200).normal(0.0, 1e-3, angles.shape)
    barometer = Scalar(stamps_s, np.sin(stamps_s))
    return Flight(
        "gimbal",
        epoch_ns=1_700_000_000 * 10**9,
        attitude=AttitudeSeries(stamps_s, angles),
        barometer=barometer,
    )


def test_streams_of_both_stand_on_the_clock_of_the_log():
    joined = join_recordings([gimbal(), log()], {})
    assert joined.attitude.stamps_s[0] - joined.imu.stamps_s[0] == pytest.approx(AHEAD_S, abs=0.005)
    assert joined.barometer.stamps_s[0] == joined.attitude.stamps_s[0]
    assert joined.epoch_ns == 10**9
    said = {source.stream: source.reading for source in joined.sources}
    begins = re.search(r"begins \+(\S+) ±\s(\S+) s", said["attitude0"])
    assert abs(float(begins[1]) - AHEAD_S) < 3 * float(begins[2]) < 0.005
    assert "turns of attitude0 and imu0" in said["barometer0"]
    assert "begins" not in said["imu0"]


def test_a_recording_that_begins_first_is_second_zero():
    """An autopilot's clock begins at its start, and has no time before."""
    late = log()
    late = replace(late, epoch_ns=0, imu=replace(late.imu, stamps_s=late.imu.stamps_s[:-6000]))
    part = late.imu.gyro_rad_s[6000:], late.imu.accel_m_s2[6000:]
    late = replace(late, imu=replace(late.imu, gyro_rad_s=part[0], accel_m_s2=part[1]), battery=None)
    joined = join_recordings([gimbal(), late], {})
    assert joined.attitude.stamps_s[0] == 0.0
    assert joined.imu.stamps_s[0] == pytest.approx(60.0 - AHEAD_S, abs=0.005)
    assert joined.epoch_ns == 0


def test_a_stream_of_both_is_taken_from_the_log_and_said():
    both = replace(log(), barometer=Scalar(np.arange(5.0), np.zeros(5)))
    joined = join_recordings([gimbal(), both], {})
    assert len(joined.barometer.stamps_s) == 5
    left = {source.channel: source.reading for source in joined.sources if not source.stream}
    assert left == {"gimbal: barometer0": "that of log taken as barometer0"}


def test_a_given_offset_is_taken_as_it_is():
    joined = join_recordings([log(), gimbal(seed=5)], {"attitude0": -12.5})
    assert joined.imu.stamps_s[0] - joined.attitude.stamps_s[0] == pytest.approx(12.5, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("other", "why"),
    [
        (gimbal(seed=2), "nothing ties its clock to that of log"),
        (gimbal(size_rad=0.0), "nothing ties its clock to that of log"),
        (gimbal(lasts_s=2.0), "nothing ties its clock to that of log"),
        (replace(gimbal(), attitude=None), "one has neither pictures, gyro, attitude, velocity nor GPS"),
    ],
    ids=["another flight", "hovering", "too short", "no motion"],
)
def test_what_nothing_ties_is_refused_with_the_way_out(other, why):
    with pytest.raises(InputError, match=why) as refused:
        join_recordings([other, log()], {})
    assert "give --offset " in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_recording_in_other_body_axes_keeps_its_truth_and_loses_its_attitude():
    """The recorder is mounted a quarter turn to the left: its truth becomes that of the log's axes."""
    upright, mount = gimbal(), Rotation.from_euler("z", 90, degrees=True)
    attitude = Rotation.from_euler("ZYX", upright.attitude.roll_pitch_yaw_rad[:, ::-1])
    stamps_s = upright.attitude.stamps_s
    expected = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    expected[:, :3, :3], expected[:, :3, 3] = attitude.as_matrix(), [1.0, 2.0, 3.0]
    recorded = expected.copy()
    recorded[:, :3, :3] = (attitude * mount).as_matrix()
    angles = (attitude * mount).as_euler("ZYX")[:, ::-1]
    sideways = replace(
        upright, attitude=AttitudeSeries(stamps_s, angles), truth=Truth(stamps_s, w_T_b=recorded)
    )
    joined = join_recordings([sideways, log()], {})
    assert joined.attitude is None
    error = Rotation.from_matrix(np.swapaxes(joined.truth.w_T_b, 1, 2)[:, :3, :3] @ expected[:, :3, :3])
    assert error.magnitude().max() < np.radians(2.0), "the error of the mount that the turns show"
    assert np.array_equal(joined.truth.w_T_b[:, :3, 3], expected[:, :3, 3])
    assert any("attitude0 of it, in its own axes, left out" in line for line in joined.warnings)
    assert "attitude0" not in {source.stream for source in joined.sources}
    assert "gimbal: attitude0" in {source.channel for source in joined.sources if not source.stream}


@pytest.mark.parametrize(
    ("offsets_s", "why"),
    [
        ({"cam0": 1.0}, "--offset cam0=1: no recording has this stream"),
        ({"imu0": 1.0}, "--offset imu0=1: imu0 is taken from log, whose clock is the reference"),
        (
            {"attitude0": 1.0, "barometer0": 2.0},
            "--offset barometer0=2: attitude0, of the same source gimbal, has another offset",
        ),
    ],
)
def test_an_offset_that_cannot_be_used_is_refused(offsets_s, why):
    with pytest.raises(InputError, match=why):
        join_recordings([gimbal(), log()], offsets_s)


def by_speed(seed: int, repeats_s: float = 0.0) -> tuple[Flight, Flight, float]:
    """Return GPS at 5 Hz and a velocity of one flight, and when the second begins after the first."""
    rng = np.random.default_rng(seed)
    speed = curve(rng, 1, step_s=3.0)

    def at(t_s: np.ndarray) -> np.ndarray:
        return 2.0 + speed(t_s % repeats_s if repeats_s else t_s)[:, 0]

    gps_s, flow_s = np.arange(0.0, LASTS_S, 0.2), np.arange(50.0, 140.0, 0.05)
    way_m = np.concatenate([[0.0], np.cumsum(0.5 * (at(gps_s)[1:] + at(gps_s)[:-1]) * 0.2)])
    north_deg = 50.0 + (way_m + rng.normal(0.0, 0.02, len(way_m))) / 111_320.0
    gps = Gps(gps_s, north_deg, np.full(len(gps_s), 4.0), np.full(len(gps_s), 100.0))
    flow = np.column_stack([0.9 * at(flow_s) + rng.normal(0.0, 0.1, len(flow_s)), np.zeros(len(flow_s))])
    return Flight("track", gps=gps), Flight("flow", velocity=Velocity(flow_s - 50.0, flow)), 50.0


def test_speeds_tie_the_clocks_without_a_gyro_with_an_honest_deviation():
    off = []
    for seed in range(6):
        first, second, begins_s = by_speed(seed)
        joined = join_recordings([first, second], {})
        found_s = joined.velocity.stamps_s[0] - joined.gps.stamps_s[0]
        (reading,) = (s.reading for s in joined.sources if s.stream == "velocity0")
        off.append((found_s - begins_s) / float(reading.partition("±")[2].split()[0]))
    assert 0.05 < np.mean(np.square(off)) < 3.0, "NEES"


def test_a_speed_that_repeats_is_refused():
    first, second, _ = by_speed(3, repeats_s=35.0)
    with pytest.raises(InputError, match="fits that of track equally well at"):
        join_recordings([first, second], {})


def test_a_source_of_which_nothing_is_used_is_named():
    joined = join_recordings([replace(gimbal(), name="first"), replace(gimbal(), name="second")], {})
    assert any("nothing of second is used" in line for line in joined.warnings)
    assert not any("nothing of first" in line for line in joined.warnings)
