"""``slam estimate``: motion of synthetic flights, noise identification and reported warnings."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
from scipy.stats import chi2
from typer.testing import CliRunner

from backend import se3
from backend.ekf import records as status
from slam.cli import app
from slam.cli.estimate import figures
from slam.core.errors import InputError
from slam.core.messages import joined, warning
from slam.core.progress import COMPILING
from slam.core.units import length
from slam.evaluation import evaluate
from slam.evaluation.trajectory import gauge
from slam.inertial.accuracy_basis import track_accuracy_basis
from slam.inertial.instruments import InertialTrust
from slam.inertial.navigate import _implausible_offsets, dead_reckoning, navigate
from slam.inertial.noise_identification import identify_noise
from slam.inertial.summary import summary_record
from slam.io.estimate import read_estimate
from slam.io.flight_folder import write_flight
from slam.simulation import simulate
from tests.slam.inertial.made_navigation import made_flight, without


@pytest.fixture(scope="module")
def flight():
    return made_flight(1)


@pytest.fixture(scope="module")
def navigation(flight):
    return navigate(flight)


def test_an_attitude_in_degrees_changes_nothing_but_a_warning(flight, navigation):
    angles = np.degrees(flight.attitude.roll_pitch_yaw_rad)
    found = navigate(replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles)))
    assert found.estimate.w_T_b == pytest.approx(navigation.estimate.w_T_b, abs=1e-9)
    assert "taken as degrees" in found.estimate.warnings[0]


@pytest.mark.slow
def test_compilation_of_the_filter_is_shown_as_progress(flight, monkeypatch):
    def compiles(*_: object):
        numba.njit(lambda x: x + 1)(1)
        raise InputError("far enough")

    shown: list[tuple[str, int, int]] = []
    monkeypatch.setattr("slam.inertial.navigate.identify_noise", compiles)
    with pytest.raises(InputError, match="far enough"):
        navigate(flight, progress=lambda *report: shown.append(report))
    # Checks before the filter may compile a kernel of their own in a fresh cache.
    assert shown[-2:] == [(COMPILING, 0, 1), (COMPILING, 1, 1)]
    assert {report[0] for report in shown} == {COMPILING}


def truth_at(flight, at_s):
    """Poses of the truth, whose stamps are a grid of 10 ms, at times on that grid."""
    return flight.truth.w_T_b[np.round(at_s * 100).astype(int)]


def test_synthetic_flight_is_estimated(flight, navigation):
    evaluation = evaluate(navigation.estimate, flight)
    assert evaluation.ate_m.rmse < 0.06
    assert navigation.estimate.status == "ok"
    assert evaluation.loops is None
    assert (
        evaluation.trajectory_names
        == navigation.estimate.trajectory_names
        == ("dead reckoning on board", "filter", "smoothed")
    )


@pytest.mark.slow
def test_smoothed_beats_filtered_beats_dead_reckoning():
    off = []
    for seed in range(3):
        flight = made_flight(seed)
        evaluation = evaluate(navigate(flight).estimate, flight)
        tracks = evaluation.tracks
        off.append(
            [np.sqrt(np.mean(np.sum((m - tracks.reference_m)[:, :2] ** 2, axis=1)))
             for m in (tracks.loops_m, tracks.odometry_m, tracks.chain_m)]
        )  # fmt: skip
    smoothed, _, reckoned = np.mean(off, axis=0)
    assert smoothed < reckoned


@pytest.mark.slow
def test_covariances_are_consistent_over_flights():
    """The last pose against the first, one flight one sample, on instruments as made."""
    scores = []
    for seed in range(20, 24):
        flight = made_flight(seed)
        estimate = navigate(flight, rate_hz=1.0).estimate
        k = len(estimate.stamps_s) - 2
        true = np.array([interpolated(flight, t) for t in estimate.stamps_s[[0, k]]])
        placed = gauge(estimate.w_T_b[0], true[0]) @ estimate.w_T_b[k]
        xi = se3.log(np.linalg.inv(placed)[None] @ true[1:])[0]
        scores.append(xi @ np.linalg.solve(estimate.covariances[k], xi))
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(scores))
    assert low < sum(scores) < high


def interpolated(flight, t):
    before = int(t * 100)
    step = se3.log(np.linalg.inv(flight.truth.w_T_b[before])[None] @ flight.truth.w_T_b[before + 1][None])
    return flight.truth.w_T_b[before] @ se3.exp(step * (t * 100 - before))[0]


def test_delay_is_identified(navigation):
    late = identify_noise(made_flight(2, late_s=0.1)).adjustments.delay_s
    assert late["velocity"] == pytest.approx(0.1, abs=0.031)
    assert set(navigation.inputs.adjustments.delay_s) == set()


def test_readings_that_a_delay_takes_out_do_not_count(flight):
    """Each exact attitude that it took out had cost more than the delay was worth: half of it was found."""
    late = replace(flight.attitude, stamps_s=flight.attitude.stamps_s + 0.04)
    found = identify_noise(replace(flight, attitude=late)).adjustments.delay_s
    assert found == {"attitude": pytest.approx(0.04)}


def test_instruments_without_correlated_errors_are_modelled_ideal(flight, navigation):
    model = navigation.inputs.model
    assert model.tilt_error_rad == 0
    assert model.velocity_error_m_s == 0
    wandering = replace(flight.attitude, noise_std_rad=(1e-5,) * 3)
    assert identify_noise(replace(flight, attitude=wandering)).model.tilt_error_rad > 0, "no credible noise"


def test_noise_above_nominal_is_identified(flight):
    optimistic = replace(flight.sonar, noise_std_m=0.001)
    factor = identify_noise(replace(flight, sonar=optimistic)).adjustments.noise_factor["range"]
    assert factor * 0.005 == pytest.approx(0.01, rel=0.3), "the floor, widened to the true noise"


def test_velocity_in_another_unit_is_reported_in_the_status(flight):
    velocity = replace(flight.velocity, v_m_s=100.0 * flight.velocity.v_m_s)
    estimate = navigate(replace(flight, velocity=velocity)).estimate
    assert "velocity and the other instruments contradict each other" in estimate.status
    assert not any("lags by" in line for line in estimate.warnings)


def test_fixed_scale_enters_the_covariances(flight, navigation):
    rough = navigate(replace(flight, velocity=replace(flight.velocity, scale_std=0.1))).estimate
    np.testing.assert_allclose(rough.w_T_b, navigation.estimate.w_T_b, atol=1e-9)
    away = np.linalg.norm(rough.w_T_b[:, :2, 3] - rough.w_T_b[0, :2, 3], axis=1)
    k = int(np.argmax(away))
    added = np.trace((rough.covariances - navigation.estimate.covariances)[k, 3:, 3:])
    assert np.sqrt(added) == pytest.approx(0.1 * away[k], rel=0.35)
    assert any("scale of velocities cannot be determined" in warning for warning in rough.warnings)


def test_unmeasured_quantities_are_reported(flight):
    alone = navigate(without(flight, "velocity", "sonar")).estimate
    assert "neither velocity nor position was measured" in alone.status
    assert "heights are relative to the start" in alone.status
    assert np.isnan(alone.chain_w_T_b).all()
    assert np.isfinite(alone.w_T_b).all()


def test_dead_reckoning_integrates_velocity_along_yaw(flight, navigation):
    t = navigation.estimate.stamps_s
    reckoned = dead_reckoning(flight, navigation.estimate.w_T_b, t)
    true = np.column_stack([np.interp(t, flight.truth.stamps_s, flight.truth.w_T_b[:, k, 3]) for k in (0, 1)])
    off = reckoned[:, :2, 3] - reckoned[0, :2, 3] - true + true[0]
    assert np.linalg.norm(off, axis=1).max() < 0.2


def test_too_many_poses_are_refused(flight):
    with pytest.raises(InputError, match="lower --rate"):
        navigate(flight, rate_hz=1e5)


def test_command_writes_all_and_evaluate_reads_it(flight, tmp_path):
    write_flight(flight, tmp_path / "flight")
    done = CliRunner().invoke(app, ["estimate", str(tmp_path / "flight"), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {".slam-output", "trajectory.tum", "estimate.npz", "estimate.png", "summary.json"}
    assert read_estimate(tmp_path / "out").trajectory_names[2] == "smoothed"
    compared = CliRunner().invoke(
        app, ["evaluate", str(tmp_path / "out"), "--truth", str(tmp_path / "flight")]
    )
    assert compared.exit_code == 0, compared.output


@pytest.mark.slow
def test_command_replaces_an_earlier_output(flight, tmp_path):
    write_flight(flight, tmp_path / "flight")
    for rate_hz in ("2", "1"):
        done = CliRunner().invoke(
            app,
            ["estimate", str(tmp_path / "flight"), "--out", str(tmp_path / "out"), "--rate", rate_hz],
        )
        assert done.exit_code == 0, done.output
    assert np.diff(read_estimate(tmp_path / "out").stamps_s) == pytest.approx(1.0)


def test_downweighted_readings_are_not_reported_as_rejected(flight, navigation):
    ranges = navigation.track.channels["range"]
    marked = ranges.status.copy()
    marked[:5, 0], marked[5:7, 0] = status.INFLATED, status.REJECTED
    channels = {**navigation.track.channels, "range": replace(ranges, status=marked)}
    rows = dict(figures(replace(navigation, track=replace(navigation.track, channels=channels))).rows)
    assert "5 x range: off, taken with less weight" in rows["weighed less"]
    assert "2 x range: far from what was foreseen" in rows["left out"]
    assert "weight" not in rows["left out"]


def test_long_list_of_warnings_is_truncated_with_a_count(navigation):
    many = replace(navigation.estimate, messages=joined(*(warning(f"w{k}") for k in range(12))))
    rows = figures(replace(navigation, estimate=many)).rows
    assert [text for name, text in rows if name == "warning"] == [f"w{k}" for k in range(8)]
    assert rows[-1] == ("", "and 4 more messages in summary.json")


def test_command_reports_errors_in_one_line(flight, tmp_path):
    write_flight(without(flight, "imu", "velocity"), tmp_path / "flight")
    for more, said in (([], "too little to tell"), (["--without", "sonar7"], "no such stream")):
        done = CliRunner().invoke(
            app, ["estimate", str(tmp_path / "flight"), "--out", str(tmp_path / "out"), *more]
        )
        assert done.exit_code == 1
        assert said in done.output
        assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_estimates_are_consistent_over_fifty_simulated_flights():
    """The vehicle and the instruments of another hand, whose makers tell their noise right."""
    middle, means = [], []
    for seed in range(50):
        flown = simulate("square", seed)
        assert flown.velocity is not None
        blind = replace(flown, camera=None, frames=None, velocity=replace(flown.velocity, scale_std=0.0))
        found = evaluate(navigate(blind, rate_hz=4.0).estimate, blind)
        assert found.nees is not None
        means.append(found.nees.pose.mean)
        middle.append(found.tracks.nees[len(found.tracks.nees) // 2])
    low, high = chi2.ppf([0.025, 0.975], 6 * 50) / 50
    print(
        f"NEES {np.mean(middle):.2f} in mid-flight, {np.mean(means):.2f} all along: {low:.2f} to {high:.2f}"
    )
    assert low < np.mean(middle) < high
    assert low < np.mean(means) < high


def test_correlated_error_is_identified_from_summed_innovations(flight, navigation):
    assert navigation.inputs.adjustments.noise_factor.get("range", 1.0) < 1.5
    rng = np.random.default_rng(0)
    sonar = flight.sonar
    # Half a second long the same few centimetres, in steps of less than the noise of one reading.
    steps = int(0.5 / np.median(np.diff(sonar.stamps_s)))
    lasting = np.convolve(
        rng.normal(size=len(sonar.stamps_s) + steps - 1), np.ones(steps) / np.sqrt(steps), "valid"
    )
    off = replace(sonar, range_m=sonar.range_m + 2 * sonar.noise_std_m * lasting)
    assert identify_noise(replace(flight, sonar=off)).adjustments.noise_factor["range"] > 3


def test_the_accuracy_of_the_track_names_the_one_instrument_that_it_rests_on(flight, navigation):
    """In axes at constant velocity all but the drag reads the same: a small error is not found."""
    lasts_s = navigation.inputs.end_s - navigation.inputs.start_s
    assert navigation.estimate.accuracy_basis == (
        "The track over ground and its accuracy rest on velocity0 alone. At a fixed heading no other "
        "instrument tells a constant error of it from wind; turns in flight do. The accuracy counts no "
        "such error: "
        f"0.06 m/s would move the end of the track by {length(0.06 * lasts_s, True)}."
    )
    assert summary_record(navigation)["accuracy_basis"] == navigation.estimate.accuracy_basis
    fixes = replace(navigation.inputs.readings, w_p_antenna_m=navigation.inputs.readings.velocity_m_s)
    assert track_accuracy_basis(fixes, InertialTrust(), 1.0) == ""
    assert "GPS receiver alone" in track_accuracy_basis(
        replace(fixes, velocity_m_s=None), InertialTrust(), 1.0
    )


def test_offset_that_no_imu_has_is_in_the_status(navigation):
    """A gyro that is off by 0.175 rad/s stands for another error: axes, a unit, a velocity in other axes."""
    states, trust = navigation.track.smoothed, InertialTrust()
    assert _implausible_offsets(states, trust) == []
    off = {**states.errors, "gyro_offset": states.errors["gyro_offset"] + [0.0, 0.0, 0.175]}
    (line,) = _implausible_offsets(replace(states, errors=off), trust)
    assert str(line).startswith(
        "the gyro and the other instruments contradict each other (it would be off by 0.1"
    )
