"""The whole job on flights that lack an instrument, or have one that is off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.measurements import GRAVITY_M_S2
from slam.core.flight import Flight
from slam.core.geodesy import geodetic_from_enu
from slam.core.streams import Scalar, Sonar, Truth
from slam.evaluation import evaluate
from slam.mapping.pipeline import optimize
from slam.report.facts import gather
from tests.slam.small_flight import ORIGIN, flown, gps_of
from tests.slam.whole_job import assert_whole, normal


@pytest.mark.slow
def test_without_sonar_the_shape_is_right_and_the_missing_scale_is_reported():
    flight = replace(flown(0), sonar=None, imu=None, velocity=None)
    estimate = optimize(flight)
    assert_whole(estimate)
    assert "no metric scale" in estimate.status
    assert estimate.status in estimate.warnings
    assert not estimate.metric
    assert gather(estimate, flight).scale_source == "none"
    assert np.median(estimate.w_T_b[:, 2, 3]) == pytest.approx(1.0, abs=0.05)
    found = evaluate(estimate, flight)
    assert found.ate_sim3_m.rmse < 1.5e-3
    assert found.scale == pytest.approx(0.8, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("gain", [1.0, 1.1])
def test_without_sonar_and_imu_the_velocity_tells_how_long_a_metre_is(gain):
    flight = replace(flown(0), sonar=None, imu=None)
    assert flight.velocity is not None
    velocity = replace(flight.velocity, v_m_s=gain * flight.velocity.v_m_s, scale_std=0.1)
    flight = replace(flight, velocity=velocity)
    estimate = optimize(flight)
    assert_whole(estimate)
    assert "no metric scale but that of the vehicle's own velocity" in estimate.status
    assert estimate.metric
    assert estimate.accuracy_basis.startswith("Lengths and their accuracy rest on the vehicle's own velocity")
    assert gather(estimate, flight).scale_source == "vehicle's own velocity"
    assert estimate.information_shares["scale"]["velocity"] > 0.9
    scale = evaluate(estimate, flight).scale
    assert abs(np.log(scale)) < 3 * estimate.scale_std
    assert estimate.scale_std < 0.12
    assert evaluate(estimate, flight).ate_sim3_m.rmse < 1.5e-3


def climbing() -> Flight:
    """The small flight between 0.7 and 1.3 m, with pictures, attitude and truth."""
    way_points = ["A", "B", [1.5, 0.7, 1.3], [0.3, 0.7, 0.7], "A", [1.5, 0.3, 1.2]]
    flight = flown(0, maneuver={"way_points": way_points})
    return replace(flight, sonar=None, imu=None, velocity=None)


def barometer_of(flight: Flight, noise_m: float) -> Scalar:
    """20 readings a second over a level 512 m below."""
    stamps_s = np.arange(0.0, flight.frames.stamps_s[-1], 0.05)
    height_m = np.interp(stamps_s, flight.truth.stamps_s, flight.truth.w_T_b[:, 2, 3])
    noise = np.random.default_rng(0).normal(0, noise_m, len(stamps_s))
    return Scalar(stamps_s, 512.0 + height_m + noise, noise_m)


@pytest.mark.slow
def test_without_any_other_lengths_the_barometer_tells_them():
    flight = climbing()
    flight = replace(flight, barometer=barometer_of(flight, 0.02))
    estimate = optimize(flight)
    assert_whole(estimate)
    assert "no metric scale but that of the barometer's changes of height" in estimate.status
    assert estimate.accuracy_basis.startswith("Lengths and their accuracy rest on one barometer alone")
    assert gather(estimate, flight).scale_source == "barometer"
    assert estimate.instruments.barometer.gain == pytest.approx(1.0, abs=0.1)
    assert abs(np.log(evaluate(estimate, flight).scale)) < 3 * estimate.scale_std
    assert 0.03 < estimate.scale_std < 0.15


@pytest.mark.slow
def test_the_barometer_tells_the_climb_where_the_ranges_end_at_take_off():
    """The same pictures from thirty times the height. The first second has ranges, 4 % short as cheap sonars
    read; their uncertainty is 5 %."""
    flight, times = climbing(), 30.0
    sonar, w_T_b = flown(0).sonar, flight.truth.w_T_b.copy()
    w_T_b[:, :3, 3] *= times
    flight = replace(flight, truth=Truth(flight.truth.stamps_s, w_T_b), landmarks={}, landmark_pairs=())
    height_m = np.interp(sonar.stamps_s, flight.truth.stamps_s, w_T_b[:, 2, 3])
    range_m = np.where(sonar.stamps_s < sonar.stamps_s[0] + 1.0, 0.96 * height_m, np.nan)
    sonar = Sonar(sonar.stamps_s, range_m, scale_std=0.05)
    estimate = optimize(replace(flight, sonar=sonar, barometer=barometer_of(flight, 0.2)))
    assert_whole(estimate)
    assert abs(np.log(evaluate(estimate, flight).scale)) < 0.02
    assert estimate.scale_std < 0.04


@pytest.mark.slow
def test_a_barometer_whose_noise_hides_the_climb_tells_no_lengths():
    flight = climbing()
    flight = replace(flight, barometer=barometer_of(flight, 1.0))
    estimate = optimize(flight)
    assert not estimate.metric
    assert any("barometer0 could not determine the metric scale" in line for line in estimate.warnings)
    assert evaluate(estimate, flight).ate_sim3_m.rmse < 2e-3


@pytest.mark.slow
def test_a_velocity_of_the_wrong_sign_tells_no_lengths():
    flight = replace(flown(0), sonar=None, imu=None)
    assert flight.velocity is not None
    velocity = replace(flight.velocity, v_m_s=-flight.velocity.v_m_s)
    estimate = optimize(replace(flight, velocity=velocity))
    assert not estimate.metric
    assert any("velocity0 could not determine the metric scale" in line for line in estimate.warnings)


@pytest.mark.slow
def test_without_sonar_and_velocity_the_accelerometer_tells_how_long_a_metre_is():
    flight = replace(flown(0), sonar=None, velocity=None)
    estimate = optimize(flight)
    assert_whole(estimate)
    assert "lengths come from the accelerometer" in estimate.status
    assert estimate.instruments.accelerometer.used
    assert estimate.metric
    assert gather(estimate, flight).scale_source == "accelerometer"
    scale = evaluate(estimate, flight).to_json()["ate_sim3_m"]["scale"]
    assert abs(scale - 1) < 3 * estimate.scale_std
    assert estimate.scale_std < 0.06


@pytest.mark.slow
def test_lengths_by_a_clipped_accelerometer_are_as_uncertain_as_the_clipped_share_makes_them():
    flight = replace(flown(0), sonar=None, velocity=None)
    assert flight.imu is not None
    at_rest = np.array([0, 0, GRAVITY_M_S2])
    most = np.quantile(np.abs(flight.imu.accel_m_s2 - at_rest), 0.7, axis=0)
    clipped = at_rest + np.clip(flight.imu.accel_m_s2 - at_rest, -most, most)
    flight = replace(flight, imu=replace(flight.imu, accel_m_s2=clipped))
    estimate = optimize(flight)
    assert any("at the end of its range" in line for line in estimate.warnings)
    scale = evaluate(estimate, flight).to_json()["ate_sim3_m"]["scale"]
    assert abs(np.log(scale)) < 3 * estimate.scale_std


@pytest.mark.slow
def test_a_sonar_on_another_clock_and_an_accelerometer_that_tells_no_lengths_are_reported():
    flight = flown(0)
    sonar = replace(flight.sonar, stamps_s=flight.sonar.stamps_s + 1e6)
    imu = replace(flight.imu, accel_m_s2=-flight.imu.accel_m_s2)
    estimate = optimize(replace(flight, sonar=sonar, imu=imu, velocity=None))
    assert not estimate.metric
    assert gather(estimate, flight).scale_source == "none"
    assert any("sonar0: does not overlap" in line and "clock" in line for line in estimate.warnings)
    assert any("imu0 could not determine the metric scale" in line for line in estimate.warnings)


@pytest.mark.slow
def test_an_accelerometer_that_contradicts_the_ranges_is_not_believed():
    flight = flown(0)
    sonar = replace(flight.sonar, scale_std=0.0)
    estimate = optimize(replace(flight, sonar=replace(sonar, range_m=sonar.range_m / 2)))
    assert any("one of the instruments has a wrong scale" in line for line in estimate.warnings)
    assert not estimate.instruments.accelerometer.used
    assert estimate.instruments.accelerometer.scale == pytest.approx(2, rel=0.15)


@pytest.mark.slow
def test_without_attitude_the_pictures_alone_tell_the_tilt():
    flight = replace(flown(0), attitude=None)
    estimate = optimize(flight)
    assert estimate.status == "ok"
    found = evaluate(estimate, flight)
    assert 3e-4 < found.ate_m.rmse < 3e-3
    # Wide for one flight: what all its poses share (height, scale) is one draw. The next test is sharp.
    assert 0.5 * found.nees.pose.lower95 < found.nees.pose.mean < 2 * found.nees.pose.upper95


@pytest.mark.slow
def test_missing_values_in_sonar_and_attitude_are_no_harm():
    flight = flown(0)
    angles, range_m = flight.attitude.roll_pitch_yaw_rad.copy(), flight.sonar.range_m.copy()
    angles[200:260] = np.nan
    angles[300:, 2] = np.nan
    range_m[::3] = np.nan
    range_m[100:140] = np.nan
    broken = replace(
        flight,
        attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles),
        sonar=replace(flight.sonar, range_m=range_m),
    )
    estimate = optimize(broken)
    assert estimate.status == "ok"
    assert evaluate(estimate, broken).ate_m.rmse < 3e-3


@pytest.mark.slow
def test_a_sonar_that_reads_one_figure_only_is_reported():
    flight = flown(0)
    stuck = replace(flight.sonar, range_m=np.full(len(flight.sonar.stamps_s), 0.8))
    estimate = optimize(replace(flight, sonar=stuck))
    assert any("reads exactly 0.8 m" in warning for warning in estimate.warnings)


@pytest.mark.slow
def test_streams_without_one_value_are_like_none():
    flight = flown(0)
    empty = replace(
        flight,
        attitude=replace(
            flight.attitude, roll_pitch_yaw_rad=np.full((len(flight.attitude.stamps_s), 3), np.nan)
        ),
        sonar=replace(flight.sonar, range_m=np.full(len(flight.sonar.stamps_s), np.nan)),
        gps=replace(
            gps_of(flight, 0.1),
            **dict.fromkeys(("latitude_deg", "longitude_deg", "altitude_m"), np.full(63, np.nan)),
        ),
    )
    none = replace(flight, attitude=None, sonar=None)
    one, other = (optimize(replace(f, imu=None)) for f in (empty, none))
    assert one.w_T_b.tobytes() == other.w_T_b.tobytes()
    assert one.status == other.status
    assert "no metric scale" in one.status


@pytest.mark.slow
def test_pictures_stamped_late_do_not_shift_the_poses():
    """The flight's own clock is the instruments': the poses stand where the vehicle was by that."""
    flight = flown(0)
    late = replace(flight, frames=replace(flight.frames, stamps_s=flight.frames.stamps_s + 0.05))
    estimate = optimize(late)
    assert any("corrected in the map" in line for line in estimate.warnings)
    np.testing.assert_allclose(
        estimate.stamps_s, flight.frames.stamps_s[estimate.frame_index], rtol=0, atol=0.005
    )
    assert evaluate(estimate, late).ate_m.rmse < 4e-3


@pytest.mark.slow
def test_gps_gives_place_heading_and_scale():
    """Absolute errors of the size that the fixes' own noise leaves, inside the covariance."""
    flight = replace(flown(0), sonar=None, attitude=None)
    flight = replace(flight, gps=gps_of(flight, 0.05))
    estimate = optimize(flight)
    assert_whole(estimate)
    assert estimate.status == "ok"
    assert estimate.origin is not None
    origin = flight.geo_origin()
    east_north_up = np.array(geodetic_from_enu(np.zeros((1, 3)), origin)).ravel() - [
        ORIGIN.latitude_deg,
        ORIGIN.longitude_deg,
        ORIGIN.altitude_m,
    ]
    assert np.abs(east_north_up[:2]).max() < 1e-4
    truth = np.column_stack(
        [np.interp(estimate.stamps_s, flight.truth.stamps_s, flight.truth.w_T_b[:, a, 3]) for a in range(3)]
    )
    first_fix = flight.truth.w_T_b[0, :3, 3]
    off = estimate.w_T_b[:, :3, 3] - (truth - first_fix)
    # The origin is the first fix, noise and all: what is left beside it is the map's own error.
    within = np.linalg.norm(off - off.mean(axis=0), axis=1)
    assert 1e-3 < np.sqrt(np.mean(within**2)) < 0.06
    assert np.linalg.norm(off.mean(axis=0)) < 4 * 0.05


@pytest.mark.slow
def test_a_gps_that_stands_still_is_left_alone():
    """A receiver that repeats one fix: told, and the map is what it is without."""
    flight, without = normal()
    stuck = gps_of(flight, 0.0)
    n = len(stuck.stamps_s)
    stuck = replace(
        stuck, latitude_deg=np.full(n, 47.0), longitude_deg=np.full(n, 8.0), altitude_m=np.full(n, 400.0)
    )
    estimate = optimize(replace(flight, gps=stuck))
    assert "no usable GPS position (all fixes repeat one place to the last digit)" in estimate.status
    assert estimate.origin is None
    assert estimate.w_T_b.tobytes() == without.w_T_b.tobytes()
    no_scale = optimize(replace(flight, gps=stuck, sonar=None))
    assert np.isfinite(no_scale.covariances).all()
    assert evaluate(no_scale, flight).ate_sim3_m.rmse < 1.5e-3
