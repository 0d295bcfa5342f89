"""Spikes, steps, gaps, missing values and bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from backend import se3
from backend.ekf import records as ekf_records
from backend.ekf.inputs import FilterModel, InitialState, Readings, Series, VisualStep
from backend.ekf.track import track
from backend.errors import BackendError
from tests.backend.made_motion import KNOWN, as_the_flight_moves, fly, read, start_of


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
    assert np.flatnonzero(status == ekf_records.REJECTED).tolist() == spiked.tolist()
    assert found.channels["range"].count(ekf_records.REJECTED) == len(spiked)
    # What was refused says nothing of the noise of the others: the mean stays where the model has it.
    ranges = found.channels["range"]
    assert np.nanmean(ranges.nis) > 10
    assert 0.8 < ranges.mean_nis < 1.25
    assert ranges.accepted.sum() == np.isfinite(ranges.nis).sum() - len(spiked)
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
    start = InitialState(1.0, 0.01, w_R_b, tilt_std_rad=0.01)
    channels = track(readings, np.array([1.0]), start, FilterModel()).channels
    unable = {name: channel.count(ekf_records.UNPREDICTABLE) for name, channel in channels.items()}
    n = len(stamps_s)
    assert unable == {"gyro": 0, "accelerometer": 0, "attitude": 2 * n, "velocity": 2 * n, "range": n}


def test_a_step_becomes_the_instruments_own_error(made):
    """The drone flies over a box: the range is shorter by its height, the drone no lower."""
    flight, model, readings, start = made
    values = readings.range_m.values.copy()
    values[150:] -= 0.4
    found = track(replace(readings, range_m=replace(readings.range_m, values=values)), AT_S, start, model)
    assert found.channels["range"].count(ekf_records.BIAS_STEPPED) == 1
    height = found.smoothed.w_T_b[:, 2, 3]
    np.testing.assert_allclose(height, flight.position.at(AT_S)[:, 2], atol=0.15)
    assert found.smoothed.errors["range_offset"][-1, 0] == pytest.approx(-0.4, abs=0.15)


def test_a_gap_widens_the_uncertainty_and_nothing_breaks(made):
    flight, model, readings, start = made

    def holed(series):
        clone = (series.stamps_s < 5.0) | (series.stamps_s > 7.0)
        return replace(series, stamps_s=series.stamps_s[clone], values=series.values[clone])

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
    found = track(readings, AT_S, start, model, clone="each")
    for states in (found.filtered, found.smoothed):
        P = states.motion_covariances
        np.testing.assert_array_equal(P, P.transpose(0, 2, 1))
        scale = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
        assert np.linalg.eigvalsh(P / scale[:, :, None] / scale[:, None, :]).min() > 1e-9
        assert np.linalg.eigvalsh(states.clone_T_b_covariances[1:]).min() > 0


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
        (Readings(steps=(VisualStep(0, 2, np.eye(4), np.eye(6)),)), np.arange(3.0), "neighbours"),
        (Readings(steps=(VisualStep(0, 1, np.eye(4), -np.eye(6)),)), np.arange(2.0), "positive definite"),
    ],
)
def test_bad_input_is_refused_in_one_line(readings, at_s, said):
    with pytest.raises(BackendError, match=said) as refused:
        track(readings, at_s, InitialState(1.0, 0.1, np.eye(3)))
    assert "\n" not in str(refused.value)
