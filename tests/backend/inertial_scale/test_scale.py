"""Scale, offset and arm put into made flights are found again, with honest deviations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from backend.inertial_scale.scale import InertialScale, NoScale, inertial_scale
from backend.measurements import GRAVITY_M_S2, InertialReadings

SCALE = 1.3
OFFSET_M_S2, ARM_M = np.array([0.1, -0.2, -0.6]), np.array([-0.02, 0.03, 0.06])
STEP_S = 1e-3


@dataclass(frozen=True)
class Made:
    """A flight that sways about a place over the floor."""

    stamps_s: np.ndarray
    w_T_b: np.ndarray
    readings: InertialReadings
    covariance: np.ndarray
    """Of a pose's own error."""

    @cached_property
    def found(self) -> InertialScale | NoScale:
        """What the accelerometer tells of it."""
        return inertial_scale(self.stamps_s, self.w_T_b, self.readings, self.covariance)


def made(
    seed: int,
    lasts_s: float = 50.0,
    sway: float = 1.0,
    arm_m: np.ndarray = ARM_M,
    step: int = 67,
    tilt_std: float = 5e-4,
    height_m: float = 0.0,
    shared: int = 1,
    leans: bool = False,
) -> Made:
    """``sway`` times a decimetre or two and several degrees, at 0.2 to 0.8 Hz, in all six axes; a pose each
    ``step`` ms, whose place errs by a millimetre, and by its tilt's error times a height. So many poses after
    another have the error ``shared``. One that ``leans`` is driven by that, as by rotors.
    """
    rng = np.random.default_rng(seed)
    time_s = np.arange(-1.0, lasts_s + 1.0, STEP_S)

    def swaying(size: np.ndarray) -> np.ndarray:
        waves = 2 * np.pi * (rng.uniform(0.2, 0.8, (4, 3, 1)) * time_s + rng.uniform(size=(4, 3, 1)))
        return sway * size * np.sin(waves).sum(axis=0).T

    place_m = swaying(np.array([0.15, 0.15, 0.08])) + [0, 0, 1.2]
    w_R_b = Rotation.from_euler("ZYX", swaying(np.array([0.2, 0.05, 0.05])))
    if leans:
        push = np.gradient(np.gradient(place_m, STEP_S, axis=0), STEP_S, axis=0) + [0, 0, GRAVITY_M_S2]
        pitch, roll = np.arctan2(push[:, 0], push[:, 2]), -np.arctan2(push[:, 1], np.hypot(*push[:, ::2].T))
        w_R_b = Rotation.from_euler("YX", np.column_stack([pitch, roll]))
    arm_way = place_m + w_R_b.apply(arm_m)
    acceleration = np.gradient(np.gradient(arm_way, STEP_S, axis=0), STEP_S, axis=0)
    force = w_R_b.inv().apply(acceleration + [0, 0, GRAVITY_M_S2]) + OFFSET_M_S2
    gyro = (w_R_b[:-1].inv() * w_R_b[1:]).as_rotvec() / STEP_S
    imu = np.arange(100, len(time_s) - 100, 5)
    readings = InertialReadings(
        time_s[imu],
        gyro[imu] + [0.01, -0.02, 0.01] + rng.normal(0, 0.01, (len(imu), 3)),
        force[imu] + rng.normal(0, 0.2, (len(imu), 3)),
    )
    seen = np.arange(1000, len(time_s) - 1000, step)
    w_T_b = np.tile(np.eye(4), (len(seen), 1, 1))
    tilt, to_place = rng.normal(0, tilt_std, (len(seen), 3)), np.cross(np.eye(3), [0, 0, height_m])
    w_T_b[:, :3, :3] = (w_R_b[seen] * Rotation.from_rotvec(tilt)).as_matrix()
    off_m = w_R_b[seen].apply(tilt @ to_place) + rng.normal(0, 1e-3, (len(seen), 3))
    off_m = off_m[np.arange(len(seen)) // shared * shared]
    w_T_b[:, :3, 3] = (place_m[seen] + off_m) / SCALE
    both = np.hstack([np.eye(3), to_place / SCALE])
    covariance = tilt_std**2 * both.T @ both + np.diag([0.0] * 3 + [(1e-3 / SCALE) ** 2] * 3)
    return Made(time_s[seen], w_T_b, readings, covariance)


@pytest.mark.slow
def test_parameters_are_recovered_within_their_deviations():
    found = [made(seed).found for seed in range(8)]
    off = np.array(
        [
            [
                *(np.array(f.arm_m) - ARM_M) / f.arm_std_m,
                *(np.array(f.offset_m_s2) - OFFSET_M_S2) / f.offset_std_m_s2,
                (f.scale - SCALE) / f.scale_std,
            ]
            for f in found
        ]
    )
    squares = (off**2).sum(axis=0)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], len(found))
    assert (squares > low).all()
    assert (squares < high).all()
    assert max(f.scale_std for f in found) < 0.02
    assert max(max(f.arm_std_m) for f in found) < 0.004
    # Where the vehicle hardly turns, the offset's level axes, tilt errors and a slope of the floor are one.
    assert max(max(f.offset_std_m_s2) for f in found) < 0.03


@pytest.mark.parametrize("leans", [pytest.param(False, marks=pytest.mark.slow), True])
def test_gain_slopes_predict_the_effect_of_a_gain_error(leans: bool):
    """Rotors push along one axis and about as hard: a gain is an offset, and lengths come from the lean."""
    flight = made(0, lasts_s=30.0, arm_m=np.zeros(3), leans=leans)
    found, readings = flight.found, flight.readings
    for axis, slope in enumerate(found.gain_slopes):
        accel = readings.accel_m_s2.copy()
        accel[:, axis] *= 1.03
        other = replace(flight, readings=replace(readings, accel_m_s2=accel)).found
        assert np.log(other.scale / found.scale) / np.log(1.03) == pytest.approx(slope, abs=0.05)
    if leans:
        # What is left is how hard they push to climb.
        assert found.gain_slopes[:2] == pytest.approx((0, 0), abs=0.01)
        assert found.log_std(0.02) < 0.012
    else:
        assert sum(found.gain_slopes) == pytest.approx(1, abs=0.02)
        assert found.log_std(0.02) == pytest.approx(0.02, abs=0.001)


def test_a_long_arm_is_separated_from_the_scale():
    flight = made(0, arm_m=np.array([0.0, 0.0, 0.3]))
    assert flight.found.scale == pytest.approx(SCALE, rel=0.03)
    assert flight.found.arm_m[2] == pytest.approx(0.3, abs=0.02)


def test_the_world_may_be_turned_and_shifted():
    flight = made(1, lasts_s=25.0)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", 1.1).as_matrix()
    turn[:3, 3] = [5.0, -3.0, 0.0]
    turned = replace(flight, w_T_b=turn @ flight.w_T_b).found
    assert turned.scale == pytest.approx(flight.found.scale, rel=1e-3)
    assert turned.arm_m == pytest.approx(flight.found.arm_m, abs=1e-4)


def test_gaps_in_pictures_and_readings_do_no_harm():
    flight = made(2)
    seen = (flight.stamps_s % 17) > 3
    r = flight.readings
    read = (r.stamps_s % 23) > 1.5
    thinned = Made(
        flight.stamps_s[seen],
        flight.w_T_b[seen],
        InertialReadings(r.stamps_s[read], r.gyro_rad_s[read], r.accel_m_s2[read]),
        flight.covariance,
    )
    assert thinned.found.scale == pytest.approx(SCALE, abs=4 * thinned.found.scale_std)
    assert thinned.found.scale_std > flight.found.scale_std


@pytest.mark.parametrize("end", [0, -1])
def test_a_pose_at_the_first_or_last_reading_is_used(end: int):
    flight = made(2, lasts_s=20.0)
    r = flight.readings
    at = int(np.argmin(np.abs(r.stamps_s - flight.stamps_s[end])))
    stamps_s = flight.stamps_s.copy()
    stamps_s[end] = r.stamps_s[at]
    kept = slice(at, None) if end == 0 else slice(None, at + 1)
    within = InertialReadings(r.stamps_s[kept], r.gyro_rad_s[kept], r.accel_m_s2[kept])
    found = replace(flight, stamps_s=stamps_s, readings=within).found
    assert found.scale == pytest.approx(SCALE, abs=4 * found.scale_std)


@pytest.mark.slow
def test_the_scale_of_a_slow_flight_is_unbiased():
    """Where noise is no longer small beside the way, least squares on either side would bend the scale."""
    found = [made(seed, sway=0.03).found for seed in range(6)]
    off = np.array([(f.scale - SCALE) / f.scale_std for f in found])
    assert abs(off.mean()) < 4 / np.sqrt(len(off))
    assert np.mean([f.scale_std for f in found]) > 0.015


@pytest.mark.parametrize("step", [67, pytest.param(17, marks=pytest.mark.slow)])
def test_pictures_whose_tilt_errs_move_no_length(step: int):
    """A tilt that is off moves the place by the height times that: an arm as long would explain both away."""
    flights = [made(seed, 25.0, 0.3, step=step, tilt_std=2e-3, height_m=0.8) for seed in range(3)]
    found = [flight.found for flight in flights]
    off = np.array([(f.scale - SCALE) / f.scale_std for f in found])
    assert (off**2).sum() < chi2.ppf(1 - 1e-4, len(off))
    assert np.mean([f.scale_std for f in found]) < 0.05
    assert np.abs([f.arm_m[2] - ARM_M[2] for f in found]).max() < 0.1


@pytest.mark.slow
def test_errors_that_neighbours_share_move_no_length():
    """Frames that hang on one keyframe err together: taken for the accelerometer's noise, lengths shrink."""
    flights = [made(seed, 25.0, 0.1, tilt_std=2e-3, height_m=0.8, shared=6) for seed in range(8)]
    off = np.array([(f.found.scale - SCALE) / f.found.scale_std for f in flights])
    assert abs(off.mean()) < 4 / np.sqrt(len(off))


def test_the_size_of_the_stated_pose_covariance_does_not_matter():
    flight = made(7, 25.0, 0.3, tilt_std=2e-3, height_m=0.8)
    quarter = replace(flight, covariance=flight.covariance / 16)
    assert quarter.found.scale == pytest.approx(flight.found.scale, rel=1e-3)


@pytest.mark.parametrize(
    ("flight", "why"),
    [(made(3, sway=1e-3), "hardly accelerates"), (made(3, lasts_s=4.0), "fly longer")],
    ids=["hovers", "too short"],
)
def test_an_uninformative_flight_gives_no_scale(flight: Made, why: str):
    assert isinstance(flight.found, NoScale)
    assert why in flight.found.reason


@pytest.mark.parametrize("turn", ["x", "y"])
def test_a_floor_that_slopes_moves_no_length(turn: str):
    """Its normal is not up: 3 degrees had moved the lengths by several standard deviations."""
    flight, lean = made(1, lasts_s=25.0), np.eye(4)
    lean[:3, :3] = Rotation.from_euler(turn, 3.0, degrees=True).as_matrix()
    leaning = replace(flight, w_T_b=lean @ flight.w_T_b).found
    assert leaning.scale == pytest.approx(flight.found.scale, rel=3e-3)
    assert leaning.scale_std == pytest.approx(flight.found.scale_std, rel=0.1)
    against_floor = np.linalg.norm((np.array(leaning.level_floor_offset_m_s2) - OFFSET_M_S2)[:2])
    assert against_floor == pytest.approx(GRAVITY_M_S2 * np.sin(np.radians(3.0)), rel=0.05)
    assert max(leaning.level_floor_offset_std_m_s2) < 0.3 * max(leaning.offset_std_m_s2)
    assert leaning.slope_without_offset.std_rad < 0.3 * leaning.slope.std_rad
    offset_rad = np.linalg.norm(OFFSET_M_S2[:2]) / GRAVITY_M_S2
    assert np.linalg.norm(leaning.slope_without_offset.rad - lean[:2, 2]) < 1.1 * offset_rad


def slow(flight: Made, count: int) -> Made:
    """The flight with one reading in so many."""
    r = flight.readings
    kept = InertialReadings(r.stamps_s[::count], r.gyro_rad_s[::count], r.accel_m_s2[::count])
    return replace(flight, readings=kept)


def test_readings_that_are_too_slow_give_no_scale_and_the_reason():
    found = slow(made(1, lasts_s=25.0), 20).found
    assert isinstance(found, NoScale)
    assert found.reason == "it has 10 readings a second, and 20 are needed"


def test_the_deviation_counts_motion_that_the_readings_are_too_slow_for():
    fast = made(1, lasts_s=25.0)
    sparse = slow(fast, 10).found
    assert fast.found.sampling_std < 1e-3 < sparse.sampling_std
    assert sparse.log_std(0.0) == pytest.approx(
        np.hypot(sparse.scale_std / sparse.scale, sparse.sampling_std)
    )
    assert sparse.scale == pytest.approx(SCALE, rel=3 * sparse.log_std(0.0))


def test_readings_from_another_time_give_no_scale():
    flight = made(4, lasts_s=15.0)
    late = replace(flight.readings, stamps_s=flight.readings.stamps_s + 1000)
    assert isinstance(inertial_scale(flight.stamps_s, flight.w_T_b, late, flight.covariance), NoScale)


def test_an_accelerometer_with_wrong_signs_or_unit_gives_no_scale():
    flight = made(5, lasts_s=15.0)
    for factor in (-1.0, 1 / GRAVITY_M_S2):
        wrong = replace(flight.readings, accel_m_s2=factor * flight.readings.accel_m_s2)
        assert isinstance(inertial_scale(flight.stamps_s, flight.w_T_b, wrong, flight.covariance), NoScale)


def test_a_static_path_with_a_moving_accelerometer_gives_no_scale():
    flight = made(6, lasts_s=15.0)
    standing = np.tile(flight.w_T_b[:1], (len(flight.w_T_b), 1, 1))
    assert isinstance(inertial_scale(flight.stamps_s, standing, flight.readings, flight.covariance), NoScale)


def test_segments_that_disagree_widen_the_scale():
    """The force varies 15 % too little in one half and too much in the other."""
    flight = made(0)
    readings = flight.readings
    mean, late = readings.accel_m_s2.mean(axis=0), readings.stamps_s > np.median(readings.stamps_s)
    accel = mean + (readings.accel_m_s2 - mean) * np.where(late, 1.15, 0.85)[:, None]
    found = replace(flight, readings=replace(readings, accel_m_s2=accel)).found
    assert 0.02 < found.scale_std / found.scale < 0.15


def test_gain_errors_add_to_the_deviation_of_the_scale():
    found = replace(made(0).found, scale=2.0, scale_std=0.06, gain_slopes=(0.5, -1.0, 0.5))
    assert found.log_std(0.0) == pytest.approx(0.03)
    assert found.log_std(0.02) == pytest.approx(np.hypot(0.03, 0.04))


def lagging(flight: Made, lag_s: float) -> Made:
    """The flight with an accelerometer whose readings are late."""
    readings = flight.readings
    then_s = readings.stamps_s - lag_s
    force = np.column_stack([np.interp(then_s, readings.stamps_s, axis) for axis in readings.accel_m_s2.T])
    return replace(flight, readings=replace(readings, accel_m_s2=force))


@pytest.mark.parametrize("lag_s", [pytest.param(-0.008, marks=pytest.mark.slow), 0.012])
def test_a_lag_of_the_accelerometer_is_found_and_moves_no_length(lag_s: float):
    flight = made(0, 25.0, 0.3)
    found = lagging(flight, lag_s).found
    assert found.lag is not None
    assert found.lag.believed
    assert found.lag.lag_s == pytest.approx(lag_s, abs=3 * found.lag.std_s)
    assert found.lag.std_s < 0.002
    assert found.scale == pytest.approx(flight.found.scale, abs=flight.found.scale_std)


@pytest.mark.slow
@pytest.mark.parametrize(
    "motion",
    [
        {"sway": 0.03},
        {"sway": 0.1, "tilt_std": 2e-3, "height_m": 0.8, "shared": 6, "lasts_s": 25.0},
        {"sway": 0.05, "lasts_s": 20.0, "tilt_std": 2e-3, "height_m": 0.8},
        {"leans": True},
    ],
    ids=["slow", "shared errors", "weak", "leans"],
)
def test_no_lag_is_believed_where_there_is_none(motion: dict[str, float]):
    found = [made(seed, **motion).found for seed in range(8)]
    lags = [f.lag for f in found if isinstance(f, InertialScale) and f.lag is not None]
    assert not any(lag.believed for lag in lags)
    assert sum((lag.lag_s / lag.std_s) ** 2 for lag in lags) < chi2.ppf(1 - 1e-4, len(lags))


@pytest.mark.slow
def test_the_scale_does_not_act_on_a_place_told_in_metres():
    """A path in heights of twelve metres, of a camera half a metre ahead of the IMU."""
    height_m, b_p_c_m = 12.0, np.array([0.5, 0.1, -0.2])
    off = []
    for seed in range(6):
        flight = made(seed)
        w_T_c, unit = flight.w_T_b.copy(), SCALE / height_m
        w_T_c[:, :3, 3] = unit * w_T_c[:, :3, 3] + w_T_c[:, :3, :3] @ b_p_c_m / height_m
        to_unit = np.diag([1.0] * 3 + [unit] * 3)
        covariance = to_unit @ flight.covariance @ to_unit
        found = inertial_scale(flight.stamps_s, w_T_c, flight.readings, covariance, b_p_c_m)
        plain = flight.found
        assert found.scale == pytest.approx(plain.scale / unit, rel=0.5 * plain.scale_std / plain.scale)
        assert found.scale_std == pytest.approx(plain.scale_std / unit, rel=0.1)
        off.append((np.array(found.arm_m) - ARM_M) / found.arm_std_m)
    assert np.sqrt(np.mean(np.square(off))) < 2
