"""Content of a model file: the reported causes, and noise on the base of the flights' own figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.extended import extended_model
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.readings import by_channel
from slam.criticism.kalman.record import record_of
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

NOMINAL = load_model("nominal")


@pytest.fixture(scope="module")
def record():
    """A vehicle whose attitude and IMU are stated to be half as noisy as the model's."""
    quieter = replace(
        NOMINAL,
        attitude=replace(NOMINAL.attitude, noise_std_deg=0.5 * NOMINAL.attitude.noise_std_deg),
        imu=replace(NOMINAL.imu, gyro_noise_density=0.5 * NOMINAL.imu.gyro_noise_density),
    )
    return record_of(simulate_flight(quieter, stick_for(["climb and descend by 0.6 m"]), 1, maker=quieter))


def test_noise_is_the_flights_figure_times_the_fitted_factor(record):
    parameters = replace(filter_parameters_of(NOMINAL), noise_factor=by_channel(1.1, 1.0, 1.2, 1.0, 0.9))
    made = extended_model(NOMINAL, parameters, (), [record])
    assert made.attitude.noise_std_deg == pytest.approx(1.2 * 0.5 * NOMINAL.attitude.noise_std_deg)
    assert made.imu.gyro_noise_density == pytest.approx(1.1 * 0.5 * NOMINAL.imu.gyro_noise_density, rel=1e-3)
    assert made.sonar.noise_std_m == pytest.approx(0.9 * NOMINAL.sonar.noise_std_m)


def test_an_out_of_model_vehicle_and_a_missing_instrument_keep_the_models_noise(record):
    factors = by_channel(3.0, 3.0, 3.0, 3.0, 3.0)
    out_of_model = replace(filter_parameters_of(NOMINAL), noise_factor=factors, out_of_model=True)
    assert extended_model(NOMINAL, out_of_model, (), [record]).attitude == NOMINAL.attitude
    deaf = replace(record, values=np.where(record.kinds[:, None] == 3, np.nan, record.values))
    parameters = replace(filter_parameters_of(NOMINAL), noise_factor=factors)
    assert extended_model(NOMINAL, parameters, (), [deaf]).sonar.noise_std_m == NOMINAL.sonar.noise_std_m


def test_a_count_beyond_what_the_equation_bears_is_no_error():
    assert NOMINAL.with_sizes("moving_objects", {"count": 60.0}).value("moving_objects", "count") == 50.0
