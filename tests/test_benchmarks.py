"""How figures are judged and shown; the benchmarks themselves are opt-in (``make bench``)."""

import math
import subprocess
import sys

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, RotationSpline
from scipy.stats import norm

from backend.measurements import GRAVITY_M_S2
from slam.core.flight import Flight
from slam.core.streams import Imu, Sonar, Truth
from tests.benchmarks import (
    apart,
    blind_dev,
    by_pycolmap,
    commands,
    growth,
    hour,
    inertial_alone,
    inertial_bound,
    instruments,
)
from tests.benchmarks.figures import BEGIN, END, Section, markdown, measured, verdict, with_block
from tests.benchmarks.instrument_flights import KINDS, SEEDS, _strata
from tests.benchmarks.instrument_maps import ALL, NO_CAMERA, NO_IMU, NO_SONAR, Flown, Gap, Mapped
from tests.benchmarks.metric import at_least, at_most, reported, within


@pytest.mark.parametrize(
    ("metric", "met"),
    [
        (at_most("", 1.0, "x", 1.0), True),
        (at_most("", 1.01, "x", 1.0), False),
        (at_least("", 74, "", 74), True),
        (at_least("", 73, "", 74), False),
        (within("", 5.0, "", (4.0, 6.0)), True),
        (within("", 3.9, "", (4.0, 6.0)), False),
        (within("", 6.1, "", (4.0, 6.0)), False),
        (at_most("", math.nan, "x", 1.0), False),
        (at_least("", math.inf, "x", 1.0), False),
        (reported("", 1.0, "x"), None),
    ],
)
def test_a_limit_is_kept_or_not(metric, met):
    assert metric.met is met


def test_measured_and_asked_for_stand_in_one_unit():
    m = at_most("gap", 0.0012, "m", 0.010)
    assert (measured(m), verdict(m)) == ("1.20 mm", ("at most 10 mm", "met"))
    m = at_most("gap", 0.186, "m", 0.010)
    assert (measured(m), verdict(m)) == ("0.186 m", ("at most 0.0100 m", "missed"))


def test_only_the_block_changes():
    text = f"before\n\n{BEGIN}\nold\n{END}\n\nafter\n"
    once = with_block(text, "new")
    assert once == f"before\n\n{BEGIN}\nnew\n{END}\n\nafter\n"
    assert with_block(once, "new") == once


def test_a_readme_without_markers_gets_them_at_its_end():
    made = with_block("# Title\n", "new")
    assert made.startswith("# Title\n")
    assert with_block(made, "newer") == made.replace("new", "newer")


def test_an_open_block_is_refused():
    with pytest.raises(ValueError, match="never closed"):
        with_block(f"{BEGIN}\nold\n", "new")


def test_a_miss_and_a_skip_are_told():
    block = markdown(
        [
            Section("Part", [at_most("speed", 2.0, "x", 1.0, "how")], commit="abc"),
            Section("Other", [], "no data"),
        ]
    )
    assert "| speed <br><sub>how</sub> | 2 x | at most 1 x | **missed** |" in block
    assert "| **Part** | at abc | | |" in block
    assert "| **Other** | skipped: no data | | |" in block


def test_blind_cases_are_held_to_what_is_asked_of_them():
    def scored(nulls: int, singles: int, pairs: int, misnamed: int) -> dict:
        gate = {"nulls": 5, "nulls_right": nulls, "singles": 9, "singles_right": singles, "unknowns": 1}
        card = {"pairs: both found": {"hits": pairs, "of": 1}, "parameter error, median": {"rate": 0.3}}
        return {"gate": {**gate, "unknowns_misnamed": misnamed}, "card": card, "missing": []}

    good = blind_dev.figures(scored(5, 8, 1, 0), [121.0, 20.0, 30.0])
    assert [m.met for m in good] == [True, True, False, True, True, None, None]
    assert [measured(m) for m in good][:2] == ["5 of 5", "8 of 9"]
    assert (good[-1].value, good[-1].source[:11]) == (30.0, "case 2 of 3")
    bad = blind_dev.figures(scored(4, 7, 0, 1), [119.0, 20.0])
    assert [m.met for m in bad] == [False, False, False, False, False, None, None]


@pytest.mark.parametrize("gap_s", [0.5, 2.0, 5.0])
def test_the_bound_of_a_gap_is_the_covariance_of_gtsams_preintegration(gap_s):
    gyro, accel, step_s = 1.5e-3, 5e-2, 1e-3
    params = gtsam.PreintegrationParams.MakeSharedU(inertial_bound.GRAVITY_M_S2)
    params.setGyroscopeCovariance(gyro**2 * np.eye(3))
    params.setAccelerometerCovariance(accel**2 * np.eye(3))
    params.setIntegrationCovariance(np.zeros((3, 3)))
    hover = gtsam.PreintegratedImuMeasurements(params)
    for _ in range(round(gap_s / step_s)):
        hover.integrateMeasurement(np.array([0, 0, inertial_bound.GRAVITY_M_S2]), np.zeros(3), step_s)
    covariance = hover.preintMeasCov()  # rotation, position, velocity
    rows = [1, 6, 3]  # turning about y accelerates along x
    ours = inertial_bound.gap_covariance(gap_s, gyro, accel)
    assert ours == pytest.approx(covariance[np.ix_(rows, rows)], rel=5e-3)
    horizontal = np.sqrt(covariance[3, 3] + covariance[4, 4])
    assert inertial_bound.navigation_bound_m(gap_s, gyro, accel) == pytest.approx(horizontal, rel=5e-3)


def test_pictures_behind_a_gap_halve_the_error_of_the_accelerometer():
    # Known velocities at both ends leave t³/12 of t³/3, as in a Brownian bridge.
    alone, seen = (f(3.0, 0.0, 0.05) for f in (inertial_bound.navigation_bound_m, _smoothed_without_tilt))
    assert seen / alone == pytest.approx(0.5)
    with_tilt = inertial_bound.smoothing_bound_m(3.0, 1e-4, 0.05)
    assert with_tilt == pytest.approx(seen, rel=1e-3)


def _smoothed_without_tilt(gap_s, gyro, accel):
    P = inertial_bound.gap_covariance(gap_s, gyro, accel)[1:, 1:]
    return np.sqrt(2 * (P[1, 1] - P[0, 1] ** 2 / P[0, 0]))


def _map(error_m, **changes):
    return Mapped("ok", placed=1.0, path_m=10.0, error_m=error_m, mean_error_m=error_m, **changes)


def test_instruments_are_compared_over_flights_that_all_sets_map():
    whole = {ALL: _map(0.01), NO_IMU: _map(0.05), NO_SONAR: _map(0.02), NO_CAMERA: _map(5.0)}
    parts = {**whole, ALL: _map(0.03), NO_SONAR: Mapped("in parts", placed=0.5, path_m=5.0, error_m=0.001)}
    flights = [Flown("rich floor", 0, whole), Flown("wind", 0, parts)]
    by_key = {metric.key.split(",")[0]: metric for metric in instruments.figures(flights)}
    ratio = by_key["position error with all instruments over the best two of them"]
    # Camera and IMU over the first flight alone.
    assert ratio.value == pytest.approx(0.5)
    both = np.hypot(0.01, 0.03) / np.hypot(0.05, 0.05)
    assert ratio.source.startswith(f"{both:.3g} x over camera and sonar, 0.5 x over camera and IMU")
    sonar = by_key["position error without sonar over that with all"]
    assert (sonar.value, sonar.met) == (pytest.approx(2.0), True)


def test_a_gap_is_judged_by_the_bound_and_by_its_covariance():
    gaps = [Gap(2.0, e, 0.1, (e / 0.1) ** 2 * 2, 0.2, 0.1) for e in (0.1, 0.3)]
    flights = [Flown("gap of 2 s", seed, {ALL: _map(0.1)}, gap) for seed, gap in enumerate(gaps)]
    found = {metric.key: metric for metric in instruments.figures(flights)}
    error = np.sqrt((0.1**2 + 0.3**2) / 2)
    over = found["gap of 2 s: error at its end over that of navigation by the IMU alone"]
    assert (over.value, over.met) == (pytest.approx(error / 0.2), True)
    assert found["gap of 2 s, position at its end: mean NEES of 2 flights"].value == pytest.approx(10.0)


def test_there_are_24_flights_of_instruments_or_more():
    assert len(KINDS) * len(SEEDS) >= 24


@pytest.mark.parametrize("turn", [0, 1])
def test_errors_of_instruments_have_one_flight_in_each_stratum_of_two_seeds(turn):
    flights = len(KINDS) * len(SEEDS)
    numbers = range(turn * flights, (turn + 1) * flights)
    drawn = norm.cdf([_strata(number, np.random.default_rng(0)) for number in numbers])
    np.testing.assert_array_equal(np.sort(np.floor(flights * drawn), axis=0).T, [np.arange(flights)] * 3)


def test_further_seeds_have_other_errors_of_instruments():
    flights = len(KINDS) * len(SEEDS)
    first, later = (
        np.array([_strata(turn * flights + k, np.random.default_rng(0)) for k in range(flights)])
        for turn in (0, 1)
    )
    assert abs(np.corrcoef(first.ravel(), later.ravel())[0, 1]) < 0.5


def test_an_accelerometer_on_an_arm_feels_how_the_arms_end_accelerates():
    t, arm_m = np.arange(0, 4, 0.01), np.array([0.1, 0.2, -0.3])
    angles = np.column_stack([np.sin(t), 0.4 * np.sin(2 * t + 1), 0.3 * np.cos(3 * t)])
    w_T_b = np.tile(np.eye(4), (len(t), 1, 1))
    w_T_b[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
    end_m = w_T_b[:, :3, :3] @ arm_m
    accel = np.gradient(np.gradient(end_m, t, axis=0), t, axis=0)
    expected = np.einsum("nba,nb->na", w_T_b[:, :3, :3], accel)
    turn = RotationSpline(t, Rotation.from_matrix(w_T_b[:, :3, :3]))
    found = inertial_bound.lever_force(turn, t, arm_m)
    assert np.abs(found - expected)[10:-10].max() < 0.01 * np.abs(expected).max()


def test_the_bound_of_the_scale_adds_noise_and_gain():
    """A vehicle that sways without a tilt: gravity shows the gain as well as the offset along it is known."""
    t, noise_std, gain_std, offset_m_s2 = np.arange(0, 20 * np.pi, 0.01), 0.7, 0.02, 0.2
    w_v_m_s = np.column_stack([np.sin(t), 0 * t, 0 * t])
    truth = Truth(t, np.tile(np.eye(4), (len(t), 1, 1)), w_v_m_s)
    by_gravity = (offset_m_s2**2 + noise_std**2 / len(t)) / GRAVITY_M_S2**2
    expected = noise_std**2 / np.sum(np.cos(t) ** 2) + 1 / (gain_std**-2 + 1 / by_gravity)
    path = inertial_bound.known_path(truth, t, noise_std, gain_std, offset_m_s2, 0.05)
    assert path.scale_std == pytest.approx(np.sqrt(expected), rel=1e-3)


def test_ranges_and_an_accelerometer_add_their_information_of_the_scale():
    """At constant height the gain and the zero of a sonar act alike, and no range tells them apart."""
    t, height_m, gain_std, zero_std_m, noise_std_m = np.arange(0, 20 * np.pi, 0.01), 2.0, 0.05, 0.02, 0.01
    w_T_b = np.tile(np.eye(4), (len(t), 1, 1))
    w_T_b[:, 2, 3] = height_m
    w_v_m_s = np.column_stack([np.sin(t), 0 * t, 0 * t])
    truth, blank = Truth(t, w_T_b, w_v_m_s), np.zeros((len(t), 3))
    sonar = Sonar(t, np.full(len(t), height_m), noise_std_m, scale_std=gain_std, datum_std_m=zero_std_m)
    flight = Flight("sways", truth=truth, imu=Imu(t, blank, blank), sonar=sonar)
    path = inertial_bound.known_path(truth, t, Imu.accel_noise_density / np.sqrt(0.01), 0.02, 0.3, 0.0)
    by_ranges = gain_std**2 + (zero_std_m**2 + noise_std_m**2 / len(t)) / height_m**2
    expected = (path.scale_std**-2 + 1 / by_ranges) ** -0.5
    assert inertial_bound.scale_bound(flight, 0.02, 0.3) == pytest.approx(expected, rel=1e-6)


def test_an_estimate_that_knows_the_path_scatters_by_the_bound():
    t, noise_std = np.arange(0, 20 * np.pi, 0.01), 0.7
    w_v_m_s = np.column_stack([np.sin(t), 0 * t, 0 * t])
    truth, rng = Truth(t, np.tile(np.eye(4), (len(t), 1, 1)), w_v_m_s), np.random.default_rng(0)
    path = inertial_bound.known_path(truth, t, noise_std, 0.02, 0.2, 0.05)
    errors = [
        path.scale_error(
            (1 + 0.02 * rng.normal()) * path.force_m_s2
            + rng.normal(0, 0.2, 3)
            + rng.normal(0, noise_std, (len(t), 3))
        )
        for _ in range(200)
    ]
    # Two-sided, four standard deviations of a standard deviation of 200 draws.
    assert np.std(errors) == pytest.approx(path.scale_std, rel=4 / np.sqrt(2 * len(errors)))


def test_recovered_errors_are_judged_by_their_reported_deviations():
    good = inertial_alone.Recovered(0, "ok", 0.6, 0.2, 0.4, 1.0, (0.5, -1.0, 1.9), (0.1, 0.1, 0.1), (1.0,))
    bad = inertial_alone.Recovered(1, "ok", 0.8, 0.4, 0.8, 9.0, (5.0, -6.0, 7.0), (0.1, 0.1, 0.1), ())
    none = inertial_alone.Recovered(2, "no map", 1.0)
    found = {m.key.split(":")[0].split(",")[0]: m for m in inertial_alone.figures([good, bad, none])}
    assert (found["lively flights of 3 with a metric scale"].value, found["error of the scale"].value) == (
        2, pytest.approx(0.6),
    )  # fmt: skip
    offset, arm = found["offset of the accelerometer"], found["lever arm of the accelerometer"]
    assert (offset.value, offset.met, arm.value, arm.met) == (50.0, False, 100.0, True)
    assert found["delay of the pictures"].value == 100.0
    allowed = found["least median error of the scale that the noise of the accelerometer allows"]
    assert allowed.value == pytest.approx(0.6745 * 0.8, rel=1e-4)
    ratio = found["error of the scale over that of an estimate that knows the path up to its scale"]
    assert ratio.value == pytest.approx(2.0)


def test_the_growth_of_a_stage_is_its_largest_exponent_between_two_sizes():
    surveys = [
        growth.Survey(n, n, 5 * n, 0.1, {"track": 1e-2 * n, "refine": refine_s}, 400.0 + n / 100, 500.0, 1.0)
        for n, refine_s in ((400, 1.0), (1600, 4.0), (6400, 32.0))
    ]
    found = {metric.key.split(":")[0]: metric for metric in growth.figures(surveys)}
    assert (found["track"].value, found["track"].met) == (pytest.approx(1.0), True)
    assert (found["refine"].value, found["refine"].met) == (pytest.approx(1.5), False)
    memory = found["peak memory, without mosaic, 6400 over 400 photographs"]
    assert (memory.value, memory.met) == (pytest.approx(464 / 404), True)


def test_overlapping_photographs_of_a_made_survey_show_one_ground():
    here, aside = np.diag([1.0, -1.0, -1.0, 1.0]), np.diag([1.0, -1.0, -1.0, 1.0])
    # So far from the origin that most octaves have repeated there.
    here[:3, 3], aside[:3, 3] = (1e3, 1e3, 30.0), (1e3 + 30.0 * 100 / growth.FOCAL_PX, 1e3, 30.0)
    rng = np.random.default_rng(0)
    octaves = [
        np.pad(rng.normal(0, 1, (growth.BLOTS,) * 2), growth.PADDED, mode="wrap").astype(np.float32)
        for _ in growth.OCTAVES_M
    ]
    first, second = (growth.ground_in(pose, octaves) for pose in (here, aside))
    np.testing.assert_allclose(second[:, :-100], first[:, 100:], atol=0.2)


def test_the_time_of_a_command_has_that_of_its_children(monkeypatch):
    """The busy grandchild stands for a command that runs in a child of its own."""
    monkeypatch.setattr(commands, "REPEATS", 1)
    busy = "import time\nwhile time.process_time() < 0.2: pass"
    outer = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {busy!r}])"
    assert 0.2 <= commands.cpu_s("-c", outer) < 1.0


def test_memory_is_compared_with_that_of_the_peers_process():
    best = by_pycolmap.Mapped(10.0, 20.0, {}, 1, peak_mb=400.0)
    found = by_pycolmap.against_best(apart.Took(4.0, 8.0, peak_mb=500.0), best, 3)
    assert [(metric.value, metric.met) for metric in found] == [(0.4, True), (0.4, True), (1.25, False)]


def test_the_peer_is_alone_in_its_process():
    """What this program imports would count as the peer's memory."""
    loaded = "import sys, tests.benchmarks.by_pycolmap; print([*sys.modules])"
    names = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True).stdout
    assert "'frontend" not in names
    assert "'slam" not in names


def test_a_piece_of_the_hour_stands_for_it_in_proportion():
    def piece(minutes: float) -> hour.Piece:
        stages = {"track": 10 * minutes}
        return hour.Piece(minutes, 9, 9, 9, 0.1, stages, 12 * minutes, 1.0, 400.0 + minutes, 500.0, 1.0)

    found = {metric.key: metric for metric in hour.figures([piece(1), piece(6)])}
    whole = found["processor time of the map of an hour"]
    assert (whole.value, whole.met) == (pytest.approx(12.0), True)
    assert whole.source.startswith("6 minutes, in proportion")
    assert found["exponent of its processor time from 1 minutes"].value == pytest.approx(1.0)


def test_the_lines_of_the_hour_fill_a_square_at_one_speed():
    w_T_b = hour.poses(2.0)
    steps_m = np.linalg.norm(np.diff(w_T_b[:, :2, 3], axis=0), axis=1) * hour.RATE_HZ
    assert np.median(steps_m) == pytest.approx(hour.CRUISE_M_S, rel=1e-6)
    assert steps_m.max() < 1.01 * hour.CRUISE_M_S
    assert np.ptp(w_T_b[:, :2, 3], axis=0) == pytest.approx([hour.side_m(2.0)] * 2, rel=0.15)
