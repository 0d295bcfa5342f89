"""The filter and its smoother against dense Gaussian conditioning, and their consistency over drawn
flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm

from backend import se3
from backend.ekf import motion as ekf_motion
from backend.ekf import records as ekf_records
from backend.ekf.inputs import FilterModel, PictureStep, Readings, Series, Start
from backend.ekf.track import track
from backend.errors import BackendError
from tests.backend.made_motion import (
    KNOWN,
    MODEL,
    as_the_flight_moves,
    error_of,
    fly,
    read,
    seen_steps,
    start_of,
)

STD, TAU = 1.5, 0.4


def line_model(**changes):
    """A vehicle that only moves: nothing is unknown but position, velocity and acceleration."""
    still = {"rate_rad_s": 1e-9, "tilt_error_rad": 0.0, "yaw_walk_rad": 0.0, "barometer_walk_m": 0.0}
    return FilterModel(accel_m_s2=STD, accel_time_s=TAU, **{**still, **changes})


def dense(stamps_s, readings_at, readings, std, asked):
    """Mean and covariance (3 asked) of position, velocity, acceleration along one axis, of all at once.

    Conditions one Gaussian of all states on all readings; nothing recursive.
    """
    first = np.diag([0.0, 0.5, 2.0]) ** 2
    transitions, noises = [np.eye(3)], [first]
    for dt in np.diff(stamps_s):
        step, q = ekf_motion.correlated(dt, STD, TAU)
        transitions.append(np.array([[1, dt, step[0]], [0, 1, step[1]], [0, 0, step[2]]]))
        noises.append(q)
    n = len(stamps_s)
    prior = np.zeros((3 * n, 3 * n))
    for i in range(n):
        prior[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = noises[i]
        if i:
            before = prior[3 * i - 3 : 3 * i, : 3 * i]
            prior[3 * i : 3 * i + 3, : 3 * i] = transitions[i] @ before
            prior[: 3 * i, 3 * i : 3 * i + 3] = (transitions[i] @ before).T
            prior[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += (
                transitions[i] @ prior[3 * i - 3 : 3 * i, 3 * i - 3 : 3 * i] @ transitions[i].T
            )
    H = np.zeros((len(readings), 3 * n))
    for row, k in enumerate(readings_at):
        H[row, 3 * k] = 1
    S = H @ prior @ H.T + std**2 * np.eye(len(readings))
    K = np.linalg.solve(S, H @ prior).T
    rows = np.concatenate([[3 * k, 3 * k + 1, 3 * k + 2] for k in asked])
    return (K @ readings)[rows], (prior - K @ H @ prior)[np.ix_(rows, rows)]


@pytest.fixture(scope="module")
def straight():
    """Positions read now and then; asked times between and on them."""
    rng = np.random.default_rng(3)
    read_s, asked_s = np.sort(rng.uniform(0, 2, 12)), np.array([0.3, 0.75, 1.4, 1.9])
    read_s[0] = 0.0
    values = rng.normal(0, 1, (12, 3))
    return read_s, asked_s, values


def run_straight(straight, **options):
    read_s, asked_s, values = straight
    start = Start(0.0, 0.0, np.eye(3), tilt_std_rad=1e-9, velocity_std_m_s=0.5, accel_std_m_s2=2.0)
    start = replace(start, rate_std_rad_s=1e-9)
    readings = Readings(w_p_b_m=Series(read_s, values, np.full(3, 0.2)))
    return track(readings, asked_s, start, line_model(gate_probability=1e-300), **options)


@pytest.mark.parametrize("keep", ["none", "first", "each"])
def test_smoother_is_the_gaussian_given_all_readings(straight, keep):
    read_s, asked_s, values = straight
    smoothed = run_straight(straight, keep=keep).smoothed
    stamps_s = np.unique(np.concatenate([read_s, asked_s]))
    at = np.searchsorted(stamps_s, read_s), np.searchsorted(stamps_s, asked_s)
    for axis in range(3):
        mean, covariance = dense(stamps_s, at[0], values[:, axis], 0.2, at[1])
        parts = (smoothed.w_T_b[:, :3, 3], smoothed.w_v_m_s, smoothed.w_a_m_s2)
        got = np.column_stack([part[:, axis] for part in parts])
        np.testing.assert_allclose(got.ravel(), mean, atol=1e-6)
        rows = [axis, 3 + axis, 6 + axis]
        for k in range(4):
            block = covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
            mine = smoothed.motion_covariances[k][np.ix_(rows, rows)]
            np.testing.assert_allclose(mine, block, rtol=1e-5, atol=1e-9)


def test_filter_is_the_gaussian_given_the_readings_until_then(straight):
    read_s, asked_s, values = straight
    filtered = run_straight(straight).filtered
    for k, until_s in enumerate(asked_s):
        early = read_s <= until_s
        stamps_s = np.unique(np.append(read_s[early], until_s))
        at = np.searchsorted(stamps_s, read_s[early]), [len(stamps_s) - 1]
        for axis in range(3):
            mean, covariance = dense(stamps_s, at[0], values[early, axis], 0.2, at[1])
            np.testing.assert_allclose(filtered.w_T_b[k, axis, 3], mean[0], atol=1e-6)
            mine = filtered.motion_covariances[k][axis, axis]
            np.testing.assert_allclose(mine, covariance[0, 0], rtol=1e-5)


def test_way_between_asked_times_has_the_joint_covariance(straight):
    """Not the sum of the two poses' own: their errors are nearly one."""
    read_s, asked_s, values = straight
    smoothed = run_straight(straight, keep="each").smoothed
    stamps_s = np.unique(np.concatenate([read_s, asked_s]))
    at = np.searchsorted(stamps_s, read_s), np.searchsorted(stamps_s, asked_s)
    mean, covariance = dense(stamps_s, at[0], values[:, 0], 0.2, at[1])
    assert np.isnan(smoothed.kept_T_b[0]).all()
    for k in range(1, 4):
        pick = np.zeros(12)
        pick[3 * k], pick[3 * k - 3] = 1, -1
        np.testing.assert_allclose(smoothed.kept_T_b[k, 0, 3], pick @ mean, atol=1e-6)
        np.testing.assert_allclose(smoothed.kept_covariances[k][3, 3], pick @ covariance @ pick, rtol=1e-5)
        apart = covariance[3 * k, 3 * k] + covariance[3 * k - 3, 3 * k - 3]
        assert smoothed.kept_covariances[k][3, 3] < 0.9 * apart


def test_the_first_pose_kept_gives_covariances_relative_to_it(straight):
    read_s, asked_s, values = straight
    smoothed = run_straight(straight, keep="first").smoothed
    stamps_s = np.unique(np.concatenate([read_s, asked_s]))
    at = np.searchsorted(stamps_s, read_s), np.searchsorted(stamps_s, asked_s)
    _, covariance = dense(stamps_s, at[0], values[:, 0], 0.2, at[1])
    for k in range(1, 4):
        pick = np.zeros(12)
        pick[3 * k], pick[0] = 1, -1
        np.testing.assert_allclose(
            smoothed.since_kept_covariances[k][3, 3], pick @ covariance @ pick, rtol=1e-5
        )


def mean_nees(states, flight, at_s):
    """Per degree of freedom: of the poses, and of the velocities."""
    xi = se3.log(se3.inverse(states.w_T_b) @ flight.w_T_b(at_s))
    v = states.w_v_m_s - flight.position.at(at_s, 1)
    P, Pv = states.covariances, states.motion_covariances[:, 3:6, 3:6]
    pose = np.einsum("na,nab,nb->n", xi, np.linalg.inv(P), xi).mean() / 6
    return pose, np.einsum("na,nab,nb->n", v, np.linalg.inv(Pv), v).mean() / 3


def consistency(seeds, model, rounds):
    """Mean NEES per degree of freedom of filter and smoother, and of one late instant, one row a seed.

    Errors within a flight are nearly one error: what is independent is one flight from the next.
    """
    at_s = np.arange(1.0, 20.0, 0.5)
    rows = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        flight = fly(rng)
        fitting = as_the_flight_moves(flight, model)
        readings = read(flight, fitting, rng, seconds=20.0)
        found = track(readings, at_s, start_of(flight, readings, rng), fitting, rounds=rounds)
        chosen = found.smoothed if found.smoothed is not None else found.filtered
        late = error_of(chosen, flight, at_s, 30)
        rows.append((*mean_nees(chosen, flight, at_s), late))
    return np.array(rows)


def assert_consistent(rows):
    """Two-sided: the late instant's chi-square over seeds in its 99.9 % band, the means near 1."""
    n = len(rows)
    low, high = chi2.ppf([0.0005, 0.9995], 6 * n) / (6 * n)
    assert low < rows[:, 2].mean() / 6 < high, (rows[:, 2].mean() / 6, low, high)
    for column in (0, 1):
        error = rows[:, column].std(ddof=1) / np.sqrt(n)
        assert abs(rows[:, column].mean() - 1) < max(4 * error, 0.15), (column, rows[:, column].mean(), error)


def test_filter_is_consistent():
    assert_consistent(consistency(range(8), KNOWN, rounds=0))


def test_smoother_is_consistent_with_unknown_scales():
    assert_consistent(consistency(range(100, 106), MODEL, rounds=3))


@pytest.mark.slow
@pytest.mark.parametrize(("model", "rounds"), [(KNOWN, 0), (KNOWN, 1), (MODEL, 3)])
def test_consistent_over_fifty_seeds(model, rounds):
    rows = consistency(range(50), model, rounds)
    low, high = chi2.ppf([0.025, 0.975], 6 * 50) / (6 * 50)
    print(f"late NEES {rows[:, 2].mean():.2f} of 6 in [{6 * low:.2f}, {6 * high:.2f}]")
    assert low < rows[:, 2].mean() / 6 < high
    assert_consistent(rows)


def test_innovations_are_white_and_of_unit_variance():
    rng = np.random.default_rng(5)
    flight = fly(rng)
    model = as_the_flight_moves(flight, KNOWN)
    readings = read(flight, model, rng, seconds=40.0)
    found = track(readings, np.array([39.0]), start_of(flight, readings, rng), model, rounds=0)
    for name in ("attitude", "range", "velocity"):
        channel = found.channels[name]
        z = (channel.innovation / channel.std)[len(channel.stamps_s) // 10 :]
        for axis in np.flatnonzero(np.isfinite(z).any(axis=0)):
            n = len(z)
            low, high = chi2.ppf([0.0005, 0.9995], n) / n
            # A margin on the low side: the motion is taken for four times as lively as it is.
            assert low - 0.06 < np.mean(z[:, axis] ** 2) < high, (name, axis, np.mean(z[:, axis] ** 2))
            for lag in (1, 2, 5):
                assert abs(np.mean(z[lag:, axis] * z[:-lag, axis])) < norm.ppf(0.9995) / np.sqrt(n) + 0.02


@pytest.fixture(scope="module")
def made():
    rng = np.random.default_rng(11)
    flight = fly(rng)
    model = as_the_flight_moves(flight, KNOWN)
    readings = read(flight, model, rng, seconds=12.0)
    return flight, model, readings, start_of(flight, readings, rng)


AT_S = np.arange(0.5, 12.0, 0.25)


def test_spikes_are_refused_and_counted(made):
    _, model, readings, start = made
    values = readings.range_m.values.copy()
    spiked = np.arange(40, 240, 25)
    values[spiked] += 1.5
    clean = track(readings, AT_S, start, model)
    found = track(replace(readings, range_m=replace(readings.range_m, values=values)), AT_S, start, model)
    status = found.channels["range"].status[:, 0]
    assert np.flatnonzero(status == ekf_records.REFUSED).tolist() == spiked.tolist()
    assert found.channels["range"].count(ekf_records.REFUSED) == len(spiked)
    np.testing.assert_allclose(found.smoothed.w_T_b[:, :3, 3], clean.smoothed.w_T_b[:, :3, 3], atol=0.005)


def test_what_an_instrument_cannot_read_in_that_attitude_is_counted():
    """With the nose 85 degrees down there is no yaw to speak of, no level velocity, and no floor below."""
    pitched = np.array([0.0, np.radians(85), 0.0])
    w_R_b = Rotation.from_euler("ZYX", pitched[::-1]).as_matrix()
    stamps_s = np.arange(0.0, 2.0, 0.02)

    def always(values, std):
        return Series(stamps_s, np.tile(values, (len(stamps_s), 1)), np.full(len(values), std))

    readings = Readings(
        gyro_rad_s=always(np.zeros(3), 0.01),
        accel_m_s2=always(w_R_b.T @ [0.0, 0.0, 9.80665], 0.1),
        roll_pitch_yaw_rad=always(np.array([0.0, pitched[1], np.nan]), 0.01),
        velocity_m_s=always(np.zeros(2), 0.05),
        range_m=always(np.ones(1), 0.02),
    )
    start = Start(1.0, 0.01, w_R_b, tilt_std_rad=0.01)
    channels = track(readings, np.array([1.0]), start, FilterModel()).channels
    unable = {name: channel.count(ekf_records.UNABLE) for name, channel in channels.items()}
    n = len(stamps_s)
    assert unable == {"gyro": 0, "accelerometer": 0, "attitude": 2 * n, "velocity": 2 * n, "range": n}


def test_a_step_becomes_the_instruments_own_error(made):
    """The drone flies over a box: the range is shorter by its height, the drone no lower."""
    flight, model, readings, start = made
    values = readings.range_m.values.copy()
    values[150:] -= 0.4
    found = track(replace(readings, range_m=replace(readings.range_m, values=values)), AT_S, start, model)
    assert found.channels["range"].count(ekf_records.STEPPED) == 1
    height = found.smoothed.w_T_b[:, 2, 3]
    np.testing.assert_allclose(height, flight.position.at(AT_S)[:, 2], atol=0.15)
    assert found.smoothed.errors["range_offset"][-1, 0] == pytest.approx(-0.4, abs=0.15)


def test_a_gap_widens_the_uncertainty_and_nothing_breaks(made):
    flight, model, readings, start = made

    def holed(series):
        kept = (series.stamps_s < 5.0) | (series.stamps_s > 7.0)
        return replace(series, stamps_s=series.stamps_s[kept], values=series.values[kept])

    streams = ("gyro_rad_s", "accel_m_s2", "roll_pitch_yaw_rad", "range_m", "velocity_m_s")
    gone = Readings(**{name: holed(getattr(readings, name)) for name in streams})
    found = track(gone, AT_S, start, model)
    std = np.sqrt(np.trace(found.filtered.covariances[:, 3:, 3:], axis1=1, axis2=2))
    before, inside = np.searchsorted(AT_S, [5.0, 6.9])
    assert std[inside] > 3 * std[before - 1]
    xi = se3.log(se3.inverse(found.smoothed.w_T_b) @ flight.w_T_b(AT_S))
    score = np.einsum("na,nab,nb->n", xi, np.linalg.inv(found.smoothed.covariances), xi)
    assert score.max() < chi2.isf(1e-6, 6)


def test_missing_values_and_absent_streams(made):
    flight, model, readings, start = made
    angles = readings.roll_pitch_yaw_rad.values.copy()
    angles[::3, 2] = np.nan
    angles[1::7] = np.nan
    angles[5, 0] = np.inf
    some = Readings(
        roll_pitch_yaw_rad=replace(readings.roll_pitch_yaw_rad, values=angles),
        velocity_m_s=readings.velocity_m_s,
        range_m=readings.range_m,
    )
    loose = replace(model, accel_m_s2=2.0, rate_rad_s=1.0)
    found = track(some, AT_S, start, loose)
    error = found.smoothed.w_T_b[:, :3, 3] - flight.position.at(AT_S)
    assert np.linalg.norm(error, axis=1).max() < 0.3
    assert set(found.channels) == {"attitude", "velocity", "range"}


def test_covariances_stay_symmetric_and_definite(made):
    _, model, readings, start = made
    found = track(readings, AT_S, start, model, keep="each")
    for states in (found.filtered, found.smoothed):
        P = states.motion_covariances
        np.testing.assert_array_equal(P, P.transpose(0, 2, 1))
        scale = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
        assert np.linalg.eigvalsh(P / scale[:, :, None] / scale[:, None, :]).min() > 1e-9
        assert np.linalg.eigvalsh(states.kept_covariances[1:]).min() > 0


def test_what_is_not_finite_is_told_by_time(made):
    _, model, readings, start = made
    with pytest.raises(BackendError, match=r"not finite at \d+\.\d{3} s.*check that stream"):
        track(readings, AT_S, start, replace(model, accel_m_s2=1e200))


@pytest.mark.parametrize(
    ("readings", "at_s", "said"),
    [
        (Readings(), np.array([1.0, 1.0]), "do not increase"),
        (Readings(), np.array([1.0, np.nan]), "do not increase"),
        (
            Readings(barometer_m=Series(np.zeros(1), np.ones((1, 1)), np.zeros(1))),
            np.ones(1),
            "not above zero",
        ),
        (Readings(steps=(PictureStep(0, 2, np.eye(4), np.eye(6)),)), np.arange(3.0), "neighbours"),
        (Readings(steps=(PictureStep(0, 1, np.eye(4), -np.eye(6)),)), np.arange(2.0), "positive definite"),
    ],
)
def test_bad_input_is_refused_in_one_line(readings, at_s, said):
    with pytest.raises(BackendError, match=said) as refused:
        track(readings, at_s, Start(1.0, 0.1, np.eye(3)))
    assert "\n" not in str(refused.value)


def test_steps_of_pictures_hold_the_position():
    """Without any measure of speed the position runs away; steps between pictures hold it."""
    off = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        flight = fly(rng)
        model = as_the_flight_moves(flight, KNOWN)
        readings = replace(read(flight, model, rng, seconds=12.0), velocity_m_s=None)
        start = start_of(flight, readings, rng)
        seen = replace(readings, steps=seen_steps(flight, AT_S, rng))
        with_, without = (track(r, AT_S, start, model).smoothed for r in (seen, readings))
        xi = se3.log(se3.inverse(with_.w_T_b) @ flight.w_T_b(AT_S))
        off.append(np.einsum("na,nab,nb->n", xi, np.linalg.inv(with_.covariances), xi)[-1])
        assert np.trace(with_.covariances[-1, 3:, 3:]) < 0.1 * np.trace(without.covariances[-1, 3:, 3:])
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(off))
    assert low < sum(off) < high


def test_steps_of_pictures_are_foreseen_as_well_as_told_and_a_wrong_one_counts():
    rng = np.random.default_rng(5)
    flight = fly(rng)
    model = as_the_flight_moves(flight, KNOWN)
    readings = read(flight, model, rng, seconds=12.0)
    start = start_of(flight, readings, rng)
    steps = list(seen_steps(flight, AT_S, rng))
    found = track(replace(readings, steps=tuple(steps)), AT_S, start, model).channels["pictures"]
    assert found.nis.shape == (len(steps), 6)
    low, high = chi2.ppf([0.0005, 0.9995], found.nis.size)
    assert low < found.nis.sum() < high
    off = np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0])
    steps[9] = replace(steps[9], i_T_j=steps[9].i_T_j @ se3.exp(off[None])[0])
    wrong = track(replace(readings, steps=tuple(steps)), AT_S, start, model).channels["pictures"]
    assert (wrong.status[9] == ekf_records.REFUSED).all()
    assert wrong.count(ekf_records.REFUSED) == 6
    assert wrong.log_likelihood < found.log_likelihood - 5.0


def test_the_way_across_a_stretch_without_pictures_is_as_uncertain_as_told():
    """Steps before and after tell the speed; between them the accelerometer carries on for two seconds."""
    scores, std_m = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        flight = fly(rng)
        model = as_the_flight_moves(flight, KNOWN)
        readings = replace(read(flight, model, rng, seconds=12.0), velocity_m_s=None)
        asked_s = np.concatenate([np.arange(0.5, 5.0, 0.25), np.arange(7.0, 12.0, 0.25)])
        j = int(np.searchsorted(asked_s, 7.0))
        steps = tuple(step for step in seen_steps(flight, asked_s, rng) if step.j != j)
        found = track(
            replace(readings, steps=steps), asked_s, start_of(flight, readings, rng), model
        ).smoothed
        ends = flight.w_T_b(asked_s[j - 1 : j + 1])
        i_T_j = se3.inverse(ends[:1]) @ ends[1:]
        xi = se3.log(se3.inverse(found.kept_T_b[j : j + 1]) @ i_T_j)[0]
        scores.append(xi @ np.linalg.solve(found.kept_covariances[j], xi))
        std_m.append(np.sqrt(found.kept_covariances[j][3, 3]))
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(scores))
    assert low < sum(scores) < high
    assert 0.005 < np.mean(std_m) < 0.1
