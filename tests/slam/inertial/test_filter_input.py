"""Inputs of the filter from a flight, and errors for insufficient recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries, Gps, Imu, Scalar, Velocity
from slam.inertial.filter_input import Adjustments, filter_input
from slam.inertial.variogram import MARGIN, correlated_process, noise_and_power
from slam.inertial.zero_velocity import RestWindows, zero_velocity_times
from tests.slam.inertial.made_navigation import made_flight, without

NAN = np.nan


def attitude(columns):
    values = np.full((40, 3), NAN)
    values[:, columns] = 0.1
    return AttitudeSeries(np.arange(40) * 0.05, values)


def velocity(columns):
    values = np.full((40, 2), NAN)
    values[:, columns] = 0.5
    return Velocity(np.arange(40) * 0.05, values)


@pytest.mark.parametrize(
    ("flight", "said"),
    [
        (Flight("f"), "no imu0, no attitude0, no velocity0"),
        (Flight("f", attitude=attitude([1]), velocity=velocity([0])), "of attitude0 pitch, of velocity0 v_x"),
        (Flight("f", attitude=attitude([0, 1, 2])), "(no imu0, no velocity0; there is attitude0)"),
        (Flight("f", attitude=attitude([0, 1, 2]), velocity=velocity([])), "of velocity0 nothing"),
        (Flight("f", barometer=Scalar(np.arange(5.0), np.ones(5))), "(no imu0, no attitude0, no velocity0)"),
        (Flight("f", imu=Imu(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)))), "imu0 has 1 row"),
    ],
)
def test_insufficient_recording_raises_one_line_with_available_streams(flight, said):
    with pytest.raises(InputError, match=r"too little to tell how it moved .* give it imu0, or") as refused:
        filter_input(flight)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_attitude_and_velocity_suffice_without_imu():
    inputs = filter_input(without(made_flight(0), "imu"))
    assert inputs.readings.gyro_rad_s is None
    assert inputs.start_s == pytest.approx(0.0, abs=0.05)
    assert inputs.end_s == pytest.approx(20.0, abs=0.05)


def test_readings_before_recorded_motion_are_removed():
    flight = made_flight(0)
    early = Scalar(np.arange(-100.0, 20.0), np.zeros(120), 0.2)
    inputs = filter_input(replace(flight, barometer=early))
    assert inputs.readings.barometer_m is not None
    assert inputs.readings.barometer_m.stamps_s[0] >= inputs.start_s


def test_adjustments_shift_stamps_and_scale_noise():
    flight = made_flight(0)
    plain = filter_input(flight).readings.velocity_m_s
    changed = filter_input(
        flight, adjustments=Adjustments({"velocity": 3.0}, {"velocity": 0.1})
    ).readings.velocity_m_s
    assert plain is not None
    assert changed is not None
    np.testing.assert_allclose(changed.std, 3 * plain.std)
    shared = min(len(plain.stamps_s), len(changed.stamps_s))
    np.testing.assert_allclose(plain.stamps_s[-shared:] - changed.stamps_s[-shared:], 0.1, atol=1e-9)


def test_mounted_imu_is_rotated_to_body_axes():
    flight = made_flight(0)
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    assert flight.imu is not None
    turned = replace(
        flight.imu,
        gyro_rad_s=flight.imu.gyro_rad_s @ mount[:3, :3],
        accel_m_s2=flight.imu.accel_m_s2 @ mount[:3, :3],
        b_T_s=mount,
    )
    for name in ("gyro_rad_s", "accel_m_s2"):
        one, other = (getattr(filter_input(f).readings, name) for f in (flight, replace(flight, imu=turned)))
        np.testing.assert_allclose(one.values, other.values, atol=1e-12)


def test_initial_tilt_comes_from_specific_force_without_attitude():
    """An IMU that lies on its side, as EuRoC's does: its x axis is up."""
    n = 200
    imu = Imu(np.arange(n) / 100, np.zeros((n, 3)), np.tile([9.80665, 0.0, 0.0], (n, 1)))
    start = filter_input(Flight("f", imu=imu)).start
    np.testing.assert_allclose(start.w_R_b @ [1, 0, 0], [0, 0, 1], atol=1e-9)


def test_gps_gives_absolute_positions_and_scales_are_fixed():
    flight = made_flight(0)
    assert flight.velocity is not None
    gps = Gps(np.arange(0.5, 20, 1.0), np.full(20, 47.0), np.full(20, 8.0), np.full(20, NAN))
    rough = replace(flight, velocity=replace(flight.velocity, scale_std=0.1))
    relative, absolute = filter_input(rough), filter_input(replace(rough, gps=gps))
    for inputs in (relative, absolute):
        assert (inputs.velocity_scale_std, inputs.model.velocity_scale) == (0.1, 0.0)
    assert relative.start.place_std_m == relative.start.yaw_std_rad == 0
    assert absolute.start.place_std_m > 0
    assert absolute.start.yaw_std_rad > 0


def test_each_fix_counts_with_its_own_accuracy():
    stds_m = np.repeat([[1.0, 2.0, 3.0], [10.0, 20.0, 30.0]], 10, axis=0)
    zero = np.zeros(20)
    gps = Gps(np.arange(0.5, 20, 1.0), zero + 47.0, zero + 8.0, zero, stds_m=stds_m)
    flight = replace(made_flight(0), gps=gps)
    fixes = filter_input(flight).readings.w_p_antenna_m
    assert fixes.std.shape == fixes.values.shape
    np.testing.assert_allclose(fixes.std[-1], 10 * fixes.std[0])
    np.testing.assert_allclose(fixes.std[0], fixes.std[0, 0] * np.array([1.0, 2.0, 3.0]))
    assert filter_input(flight, from_s=15.0).readings.w_p_antenna_m.std[0, 0] == fixes.std[-1, 0]


def test_told_places_of_imu_and_antenna_are_used():
    flight, mount, antenna = made_flight(0), np.eye(4), np.eye(4)
    mount[:3, 3], antenna[:3, 3] = [0.3, 0.0, 0.1], [3.0, 0.0, 0.0]
    gps = Gps(np.arange(0.5, 20, 1.0), np.full(20, 47.0), np.full(20, 8.0), np.full(20, NAN), b_T_s=antenna)
    inputs = filter_input(replace(flight, imu=replace(flight.imu, b_T_s=mount), gps=gps))
    assert inputs.model.b_p_imu_m == (0.3, 0.0, 0.1)
    assert inputs.model.b_p_position_m == (3.0, 0.0, 0.0)
    placed = np.array(inputs.start.place_m) + (inputs.start.w_R_b @ antenna[:3, 3])[:2]
    np.testing.assert_allclose(placed, inputs.readings.w_p_antenna_m.values[0, :2])
    assert inputs.start.place_std_m > 3.0, "the antenna may be on any side"


def test_zero_velocity_times_end_at_take_off():
    rng = np.random.default_rng(0)
    t = np.arange(600) / 200
    gyro, accel = rng.normal(0, 1e-3, (600, 3)), rng.normal(0, 0.01, (600, 3)) + [0, 0, 9.8]
    gyro[300:] += rng.normal(0, 0.1, (300, 3))
    accel[300:] += rng.normal(0, 0.5, (300, 3))
    times = zero_velocity_times(Flight("f", imu=Imu(t, gyro, accel)))
    assert times[-1] == pytest.approx(1.5, abs=0.3)
    assert len(zero_velocity_times(Flight("f", imu=Imu(t[:300], gyro[300:], accel[300:])))) == 0
    moving = Velocity(t, np.full((600, 2), 0.4))
    assert len(zero_velocity_times(Flight("f", imu=Imu(t, gyro, accel), velocity=moving))) == 0


@pytest.mark.parametrize("seed", range(3))
def test_variogram_separates_noise_and_random_walk(seed):
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0, np.sqrt(0.5 * 0.01), (20_000, 3)), axis=0)
    white, power = noise_and_power(walk + rng.normal(0, 0.2, walk.shape), 0.01, 0.01)
    assert white == pytest.approx(0.2, rel=0.1)
    assert power == pytest.approx(0.5, rel=0.25)
    trusted, _ = noise_and_power(walk + rng.normal(0, 0.2, walk.shape), 0.01, 0.19)
    assert trusted == 0.19


def test_constant_signal_keeps_least_power():
    white, power = noise_and_power(np.zeros((500, 3)), 0.01, 0.1)
    assert white == 0.1
    assert power > 0
    held = correlated_process(np.zeros((500, 3)), power)
    assert held.std**2 * 2 / held.time_s == pytest.approx(MARGIN * power)


def after_rest(flight, rest_s):
    """A flight whose IMU stands before it, with its nominal noise."""
    rng, imu = np.random.default_rng(0), flight.imu
    count, root_hz = int(rest_s * 100), 1 / np.sqrt(0.01)
    gyro, accel = (
        rng.normal(0, density * root_hz, (count, 3))
        for density in (imu.gyro_noise_density, imu.accel_noise_density)
    )
    standing = Imu(
        np.concatenate([imu.stamps_s[0] - 0.01 * np.arange(count, 0, -1), imu.stamps_s]),
        np.concatenate([gyro, imu.gyro_rad_s]),
        np.concatenate([accel + [0, 0, 9.80665], imu.accel_m_s2]),
        imu.gyro_noise_density,
        imu.accel_noise_density,
    )
    return replace(flight, imu=standing)


def test_rest_counts_neither_as_motion_nor_in_the_process_noise():
    flight = made_flight(0)
    standing = after_rest(flight, 40.0)
    rest = RestWindows.of(standing)
    assert not RestWindows.of(flight).rests.any()
    assert rest.moves_at(np.array([-30.0, -10.0, 5.0, 15.0])).tolist() == [False, False, True, True]
    assert rest.first_motion_s(-40.0) == pytest.approx(0.0, abs=0.6)
    assert rest.liveliest_start_s(-40.0, 15.0) == pytest.approx(-2.0, abs=0.6)
    assert RestWindows.of(flight).liveliest_start_s(0.0, 15.0) == 0.0
    alone, after = (filter_input(f).model for f in (flight, standing))
    assert after.accel_m_s2 == pytest.approx(alone.accel_m_s2, rel=0.1)
    assert after.rate_rad_s == pytest.approx(alone.rate_rad_s, rel=0.1)


def test_an_imu_without_a_reading_of_one_kind_is_named_and_rows_may_come_twice():
    flight = made_flight(0)
    imu = flight.imu
    with pytest.raises(InputError, match="the accelerometer of imu0 has no readings"):
        filter_input(replace(flight, imu=replace(imu, accel_m_s2=NAN * imu.accel_m_s2)))
    with pytest.raises(InputError, match="the gyro of imu0 has no readings"):
        filter_input(replace(flight, imu=replace(imu, gyro_rad_s=NAN * imu.gyro_rad_s)))
    twice = np.repeat(np.arange(len(imu.stamps_s)), 2)
    rows = {name: getattr(imu, name)[twice] for name in ("stamps_s", "gyro_rad_s", "accel_m_s2")}
    assert np.isfinite(filter_input(replace(flight, imu=replace(imu, **rows))).model.accel_m_s2)
