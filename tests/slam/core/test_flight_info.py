"""The description of a flight: streams, missing streams and anomalies."""

import dataclasses
import io
import os
import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from slam.cli.flight_tables import print_info
from slam.core.control_points import SurveyedPoint
from slam.core.flight import Flight
from slam.core.flight_info import describe
from slam.core.instrument_readings import inertial_readings
from slam.core.messages import about
from slam.core.stream_anomalies import camera_anomalies, clipping_anomalies
from slam.core.streams import Gps, Imu, Sonar
from slam.io.flight_folder import read_flight
from tests.slam.io.made_flight import made_flight

DATA = os.environ.get("SLAM_DATA")


def anomalies(flight, *words):
    return [line for line in describe(flight).anomalies if all(w in line for w in words)]


def part(flight, field, **changes):
    return dataclasses.replace(flight, **{field: dataclasses.replace(getattr(flight, field), **changes)})


def sonar(ranges, rate_hz=25.0):
    ranges = np.asarray(ranges, float)
    return Flight("s", sonar=Sonar(np.arange(len(ranges)) / rate_hz, ranges))


def test_a_sound_flight_has_no_anomalies():
    info = describe(made_flight(seconds=20))
    assert info.anomalies == ()
    assert info.missing == ()
    assert info.landmarks == 2
    imu = next(s for s in info.streams if s.name == "imu0")
    assert (imu.count, imu.gaps, imu.missing_values) == (2000, 0, 0)
    assert abs(imu.rate_hz - 100) < 1e-6
    assert abs(imu.duration_s - 19.99) < 1e-9
    assert abs(imu.largest_gap_s - 0.01) < 1e-9
    ranges = next(s for s in info.streams if s.name == "sonar0")
    assert (ranges.start_s, ranges.missing_values) == (0.02, 2)


@pytest.mark.parametrize(("pause_s", "gaps"), [(0.02, 0), (0.09, 0), (0.11, 1), (3.0, 1)])
def test_a_gap_exceeds_both_limits(pause_s, gaps):
    flight = made_flight()
    stamps = flight.imu.stamps_s.copy()
    stamps[300:] += pause_s - 0.01
    flight = part(flight, "imu", stamps_s=stamps)
    imu = describe(flight).streams[1]
    assert imu.gaps == gaps
    assert abs(imu.largest_gap_s - pause_s) < 1e-9
    assert len(anomalies(flight, "imu0", "gap")) == gaps


@pytest.mark.parametrize(
    ("focal_px", "center_px", "expected"),
    [
        ((300.0, 302.0), (325.0, 231.0), []),
        ((300.0, 327.0), (319.5, 239.5), []),  # television's pixels
        ((150.0, 150.0), (159.5, 119.5), ["at 25 % of the width and 25 % of the height"]),
        ((600.0, 600.0), (639.0, 479.0), ["at 100 % of the width"]),
        ((300.0, 300.0), (319.5, 179.5), ["at 50 % of the width and 38 % of the height"]),
        ((400.0, 300.0), (319.5, 239.5), ["pixels that are not square"]),
    ],
)
def test_a_calibration_of_another_resolution_is_reported(focal_px, center_px, expected):
    found = camera_anomalies(Camera(focal_px, center_px, (640, 480)))
    assert len(found) == len(expected)
    for line, words in zip(found, expected, strict=True):
        assert words in line.text
        assert "another resolution or crop than 640 x 480" in line.text


def test_sonar_anomalies_are_reported():
    rng = np.random.default_rng(0)
    live = 1.0 + rng.normal(0, 0.01, 500)
    assert anomalies(sonar(live), "sonar0") == []
    stuck = live.copy()
    stuck[100:300] = 1.5
    assert anomalies(sonar(stuck), "exactly 1.5 m for 8.0 s from 4.0 s")
    assert not anomalies(sonar(np.where(np.arange(500) % 40 < 39, 1.5, 1.6)), "exactly")
    assert anomalies(sonar(np.r_[live, np.full(60, 6.0)]), "saturated")
    assert anomalies(sonar(np.r_[live, -1.0, 0.0]), "2 ranges are zero or negative")
    assert anomalies(sonar(np.full(50, np.nan)), "no range at all")
    assert anomalies(sonar(np.r_[live, np.full(60, 0.1)]), "below its 0.25 m")


def test_a_height_that_is_held_is_not_taken_as_a_range_without_echo():
    rng = np.random.default_rng(0)
    unlimited = {"max_range_m": np.inf}
    climb = np.r_[np.linspace(0.3, 2.3, 80), np.full(520, 2.3)]
    for range_m in (1.5 + 0.01 * rng.integers(0, 2, 600), 1.5 + rng.normal(0, 0.004, 600), climb):
        for step_m in (0.01, 0.001):
            quantised = part(sonar(np.round(range_m / step_m) * step_m), "sonar", **unlimited)
            assert not anomalies(quantised, "saturated")
    coarse = np.where(rng.random(600) < 0.5, 0.35, 0.4)
    assert not anomalies(part(sonar(coarse), "sonar", **unlimited), "saturated")
    without_echo = np.r_[1.5 + rng.normal(0, 0.004, 540), np.full(60, 6.0)]
    assert anomalies(part(sonar(without_echo), "sonar", **unlimited), "10 % of the ranges are saturated")


def test_attitude_anomalies_are_reported():
    flight = made_flight()
    angles = flight.attitude.roll_pitch_yaw_rad.copy()
    angles[:, 2] += 4
    assert anomalies(part(flight, "attitude", roll_pitch_yaw_rad=angles), "yaw is unwrapped")
    angles[:, 0] = np.nan
    assert anomalies(part(flight, "attitude", roll_pitch_yaw_rad=angles), "roll was not recorded")


def test_imu_anomalies_at_rest_are_reported():
    flight = made_flight()
    n = len(flight.imu.stamps_s)
    rng = np.random.default_rng(0)
    still = part(flight, "imu", gyro_rad_s=rng.normal(0, 1e-3, (n, 3)))
    assert anomalies(still, "imu0") == []
    low = part(still, "imu", accel_m_s2=still.imu.accel_m_s2 * 0.92)
    assert anomalies(low, "accelerometer reads 9.0", "m/s^2 at rest")
    assert anomalies(
        part(still, "imu", gyro_rad_s=still.imu.gyro_rad_s + 0.1), "gyro reads 0.173 rad/s at rest"
    )
    without = part(flight, "imu", accel_m_s2=rng.normal(0, 0.05, (n, 3)))
    (line,) = anomalies(without, "imu0")
    assert "gravity was taken out of the readings (linear acceleration), or the vehicle fell freely" in line
    moving = part(flight, "imu", accel_m_s2=flight.imu.accel_m_s2 * 0.9)
    assert anomalies(moving, "on average")


def test_readings_at_the_end_of_the_range_are_reported():
    flight = made_flight()
    rng = np.random.default_rng(0)
    force = np.array([0, 0, 9.81]) + rng.normal(0, 1.0, (len(flight.imu.stamps_s), 3))
    assert not anomalies(part(flight, "imu", accel_m_s2=force), "end of its range")
    rounded = np.round(force, 1)
    assert not anomalies(part(flight, "imu", accel_m_s2=rounded), "end of its range")
    for read in (force, rounded):
        clipped = part(flight, "imu", accel_m_s2=np.clip(read, -1.0, 10.8))
        assert anomalies(clipped, "imu0", "% of the readings of the accelerometer are at the end")


def test_a_few_readings_at_the_end_of_the_range_are_reported_and_rounded_ones_are_not():
    rng, t = np.random.default_rng(0), np.arange(0.0, 30.0, 0.005)
    force = rng.normal([0, 0, 9.81], 0.1, (len(t), 3))
    turning = 6.0 * np.exp(-(((t - 15.0) / 0.1) ** 2))[:, None] * [0, 0, 1]
    gyro = turning + rng.normal(0, 0.02, (len(t), 3))
    (line,) = clipping_anomalies(Imu(t, np.clip(gyro, -4.363, 4.363), force))
    assert "imu0: 23 of the readings of the gyro are at the end of its range" in line.text
    assert clipping_anomalies(Imu(t, gyro, force)) == []
    for seed in range(20):
        rounded = np.random.default_rng(seed).normal(0, 1.0, (len(t), 3)).round(1) / 50
        assert clipping_anomalies(Imu(t, rounded, force)) == []


def test_the_clipped_share_is_that_of_the_sensor_however_it_is_mounted():
    flight = made_flight()
    force = np.random.default_rng(0).normal([0, 0, 9.81], 1.0, (len(flight.imu.stamps_s), 3))
    clipped = dataclasses.replace(flight.imu, accel_m_s2=np.clip(force, -1.0, 10.8))
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler("xy", [10, 20], degrees=True).as_matrix()
    shares = [
        inertial_readings(dataclasses.replace(clipped, b_T_s=b_T_s)).accel_clipped
        for b_T_s in (np.eye(4), mount)
    ]
    assert shares[0] == shares[1] > 0.1
    assert inertial_readings(dataclasses.replace(clipped, accel_m_s2=force)).accel_clipped == 0.0


def test_streams_that_do_not_overlap_are_reported():
    flight = made_flight()
    late = part(flight, "sonar", stamps_s=flight.sonar.stamps_s + 100)
    assert anomalies(late, "sonar0", "does not overlap in time with cam0")
    half = part(flight, "sonar", stamps_s=flight.sonar.stamps_s + 4)
    assert anomalies(half, "sonar0", "covers only", "% of the time of cam0")


@pytest.mark.parametrize(("located", "is_told"), [(0.8, False), (0.3, True)])
def test_photographs_of_another_day_make_no_stream_incomplete(located: float, is_told: bool) -> None:
    """The last of them has no position; most of the time lies before it."""
    flight = made_flight()
    day_s = 86400.0
    stamps_s = np.append(flight.frames.stamps_s[:-1], day_s)
    gps_s = stamps_s[: round(located * len(stamps_s))]
    zeros = np.zeros(len(gps_s))
    photos = dataclasses.replace(
        flight,
        frames=dataclasses.replace(flight.frames, stamps_s=stamps_s),
        gps=Gps(gps_s, zeros, zeros, zeros),
        all_keyframes=True,
    )
    assert bool(anomalies(photos, "gps0", "covers only 30 % of the photographs")) == is_told
    assert bool(anomalies(photos, "gps0", "covers only")) == is_told


def test_a_noise_of_zero_is_reported():
    flight = part(made_flight(), "sonar", noise_std_m=0.0)
    assert anomalies(flight, "sonar0", "noise is given as zero")


def test_missing_streams_are_reported_with_their_consequence():
    def missing(**changes):
        return " | ".join(describe(dataclasses.replace(made_flight(), **changes)).missing)

    bare = {"sonar": None, "gps": None, "imu": None}
    assert "no metric scale;" in missing(**bare, velocity=None, barometer=None)
    assert "no metric scale but that of the vehicle's own velocity" in missing(**bare, barometer=None)
    assert "no metric scale but that of the barometer's changes of height" in missing(**bare)
    assert "lengths come from the accelerometer" in missing(sonar=None, gps=None)
    without = missing(camera=None, frames=None, sonar=None, gps=None, imu=None)
    assert not re.search("scale|pictures|Earth", without), "there is no map to speak of"
    assert "scale comes from GPS" in missing(sonar=None)
    assert "flights without a camera are for `slam estimate`" in missing(camera=None, frames=None)
    assert "tilt is not measured" in missing(imu=None, attitude=None)
    assert "cannot be evaluated" in missing(truth=None, gps=None)
    assert "cannot be replayed" in missing(command=None)
    assert "not placed on Earth" in missing(gps=None)


def test_an_empty_flight_is_described():
    info = describe(Flight("nothing"))
    assert info.streams == ()
    assert info.duration_s == 0
    print_info(info, Console(file=io.StringIO()))


def test_describe_reads_no_picture():
    def load(k):
        raise AssertionError

    flight = part(made_flight(), "frames", load=load)
    assert describe(flight).streams[0].count == 30


def test_texts_are_printed_without_markup():
    screen = io.StringIO()
    flight = dataclasses.replace(
        made_flight(),
        name="[bold]not markup[/]\x1b[31m\nline",
        notes={"place": "[red]hall[/red]" + "x" * 2000},
        messages=(about("imu0", "[link=http://a]3 rows[/link] dropped\n"),),
        sonar=None,
        gps=None,
    )
    print_info(describe(flight), Console(file=screen, width=120))
    shown = screen.getvalue()
    assert "\x1b" not in shown
    for text in (
        "[bold]not markup[/]",
        "[red]hall[/red]",
        "[link=http://a]3 rows[/link] dropped",
        "no sonar and no GPS",
    ):
        assert text in shown
    assert "imu0" in shown
    assert len(shown) < 4000


def test_control_points_place_a_flight_without_gps():
    point = SurveyedPoint("north", 47.4, 8.5, 402.5, ())
    blind = dataclasses.replace(made_flight(), sonar=None, gps=None, surveyed=(point,))
    assert [line for line in describe(blind).missing if "GPS" in line] == [
        "no GPS: the control points place the map and tell its lengths, if it shows three or more"
    ]
    flat = dataclasses.replace(blind, surveyed=(dataclasses.replace(point, altitude_m=np.nan),))
    assert "no GPS: the map is not placed on Earth" in describe(flat).missing


@pytest.mark.skipif(not DATA, reason="SLAM_DATA is not set")
def test_measured_flights():
    info = describe(read_flight(Path(DATA, "flights/ardrone2-hybrid")))
    assert any("accelerometer reads 9.04 m/s^2 at rest" in line for line in info.anomalies)
    assert [s.gaps for s in info.streams] == [0] * 7
    info = describe(read_flight(Path(DATA, "flights/px4flow-quad")))
    assert any("yaw is unwrapped" in line for line in info.anomalies)
    assert all(s.gaps == 3 for s in info.streams)


def test_every_column_names_its_unit():
    out = io.StringIO()
    print_info(describe(made_flight(seconds=20)), Console(file=out, width=200))
    heading = next(line for line in out.getvalue().splitlines() if "stream" in line)
    for title in ("rate [Hz]", "starts [s]", "lasts [s]", "largest gap [s]"):
        assert title in heading
