"""Lines in the spectrum of the innovations: found where there are, not where there are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.kalman.filter import USED
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.readings import IMU
from slam.criticism.kalman.record import record_of
from slam.criticism.verdict.commanded_flights import vibration_of
from slam.data_quality.oscillation import log_tail, over_neighbours
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model


@pytest.fixture(scope="module")
def hover():
    model = load_model("nominal")
    slower = replace(model, imu=replace(model.imu, rate_hz=100.0))
    record = record_of(simulate_flight(slower, stick_for(["hover for 8 s", "hover for 8 s"]), 5))
    return record, whole(record, filter_parameters_of(slower))


def drawn(run, seed, student=False):
    """The run with white innovations instead of its own."""
    rng = np.random.default_rng(seed)
    white = (
        rng.standard_t(4, run.white.shape) / np.sqrt(2) if student else rng.standard_normal(run.white.shape)
    )
    return replace(run, white=white)


@pytest.mark.parametrize("student", [False, True])
def test_white_noise_has_no_line(hover, student):
    _, run = hover
    assert not any(vibration_of([drawn(run, s + k, student) for k in range(3)]) for s in range(20))


@pytest.mark.slow
def test_spectral_lines_of_noise_have_the_stated_probability():
    rng, flights, samples, rare = np.random.default_rng(1), 4, 4000, -12.0
    least = []
    for _ in range(1500):
        shares = [
            over_neighbours(np.abs(np.fft.rfft(rng.standard_normal(samples))) ** 2) for _ in range(flights)
        ]
        least.append(log_tail(np.sum(shares, axis=0), flights).min())
    expected = samples / 2 * np.exp(rare)
    assert 0.5 * expected < np.mean(np.array(least) < rare) < 3.0 * expected


@pytest.mark.parametrize("hz", [7.0, 31.0])
def test_a_line_is_found_at_its_frequency(hover, hz):
    record, run = hover
    shaken = []
    for k in range(3):
        white = drawn(run, k).white
        rows = record.kinds == IMU
        white[rows, 5] += 0.35 * np.sin(2 * np.pi * hz * record.times_s[rows] + k)
        shaken.append(replace(run, white=white))
    (found,) = vibration_of(shaken)
    assert found.channel == "accel_z"
    assert found.frequency_hz == pytest.approx(hz, abs=0.1)


def test_a_faint_line_is_found_in_flights_that_sample_at_rates_of_their_own(hover):
    record, run = hover
    rows = record.kinds == IMU
    paces = (1.0, 1.004, 0.996, 1.002)
    records = [replace(record, times_s=record.times_s * pace) for pace in paces]
    shaken = []
    for k, paced in enumerate(records):
        white = drawn(run, k).white
        white[rows, 5] += 0.14 * np.sin(2 * np.pi * 17.0 * paced.times_s[rows] + k)
        shaken.append(replace(run, record=paced, white=white))
    (found,) = vibration_of(shaken)
    assert found.frequency_hz == pytest.approx(17.0, abs=0.1)


def test_a_slow_wave_is_none(hover):
    record, run = hover
    white = drawn(run, 1).white + np.where(run.status == USED, np.sin(record.times_s)[:, None], 0.0)
    assert not vibration_of([replace(run, white=white)])
