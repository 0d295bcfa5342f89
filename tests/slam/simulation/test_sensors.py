import numpy as np
import pytest

from slam.simulation import sensors
from slam.simulation.maneuver import Maneuver, plan
from slam.simulation.sensors import AttitudeModel, ImuModel, SonarModel
from slam.simulation.vehicle import Vehicle, fly

EXTENT = (-5.0, -5.0, 5.0, 5.0)


@pytest.fixture(scope="module")
def motion():
    path = plan(Maneuver(((-4.0, 0.0), (4.0, 0.0), (4.0, 3.0, 1.5))), {}, EXTENT)
    return fly(path, Vehicle(), sensors.generator(0, "motion"))


@pytest.mark.parametrize("rate_hz", [0.01, 4.0, 15.0, 100.0])
@pytest.mark.parametrize("seed", range(5))
def test_stamps_are_regular_within_the_flight_and_whole_nanoseconds(rate_hz, seed):
    t = sensors.stamps(rate_hz, 12.3, np.random.default_rng(seed))
    assert 0 <= t[0] < sensors.LATEST_START_S
    assert 12.3 - 1 / rate_hz < t[-1] <= 12.3 + 1e-9
    assert np.allclose(np.diff(t), 1 / rate_hz, atol=2e-9)
    assert np.array_equal(t, np.round(t * 1e9) / 1e9)


def test_streams_start_at_phases_of_their_own(motion):
    first = [
        sensors.read_imu(motion, ImuModel(), sensors.generator(3, "imu")).stamps_s[0],
        sensors.read_attitude(motion, AttitudeModel(), sensors.generator(3, "attitude")).stamps_s[0],
        sensors.read_sonar(motion, SonarModel(), sensors.generator(3, "sonar")).stamps_s[0],
    ]
    assert len(set(first)) == 3


def test_without_noise_the_imu_reads_the_motion(motion):
    imu = sensors.read_imu(motion, ImuModel(100, 0, 0), sensors.generator(0, "imu"))
    state = motion.at(imu.stamps_s)
    assert np.array_equal(imu.gyro_rad_s, state.b_rate_rad_s)
    assert np.array_equal(imu.accel_m_s2, state.b_specific_force_m_s2)


@pytest.mark.parametrize("rate_hz", [50.0, 200.0])
def test_imu_noise_has_its_density_at_any_rate(motion, rate_hz):
    imu = sensors.read_imu(motion, ImuModel(rate_hz), sensors.generator(1, "imu"))
    state = motion.at(imu.stamps_s)
    band = 4 / np.sqrt(2 * imu.gyro_rad_s.size)
    gyro_std = np.std(imu.gyro_rad_s - state.b_rate_rad_s)
    accel_std = np.std(imu.accel_m_s2 - state.b_specific_force_m_s2)
    assert gyro_std == pytest.approx(1.5e-3 * np.sqrt(rate_hz), rel=band)
    assert accel_std == pytest.approx(5e-2 * np.sqrt(rate_hz), rel=band)


def test_attitude_noise_has_its_size_and_no_mean(motion):
    attitude = sensors.read_attitude(motion, AttitudeModel(200, 0.5), sensors.generator(2, "attitude"))
    noise = np.degrees(attitude.roll_pitch_yaw_rad - motion.at(attitude.stamps_s).roll_pitch_yaw_rad)
    n = len(noise)
    assert noise.std(0) == pytest.approx(0.5, rel=4 / np.sqrt(2 * n))
    assert np.abs(noise.mean(0)).max() < 4 * 0.5 / np.sqrt(n)
    assert np.degrees(attitude.noise_std_rad) == pytest.approx(0.5)


def test_the_sonar_reads_the_slant_to_the_floor_and_its_datum(motion):
    sonar = sensors.read_sonar(motion, SonarModel(noise_std_m=0, datum_m=0.05), sensors.generator(4, "sonar"))
    pose = motion.at(sonar.stamps_s).w_T_b
    echo = pose[:, :3, 3] - (sonar.range_m - 0.05)[:, None] * pose[:, :3, 2]
    assert np.abs(echo[:, 2]).max() < 1e-12


def test_sonar_noise_has_its_size(motion):
    sonar = sensors.read_sonar(motion, SonarModel(rate_hz=200), sensors.generator(5, "sonar"))
    clean = sensors.read_sonar(motion, SonarModel(rate_hz=200, noise_std_m=0), sensors.generator(5, "sonar"))
    noise = sonar.range_m - clean.range_m
    assert np.std(noise) == pytest.approx(0.01, rel=4 / np.sqrt(2 * len(noise)))


def test_out_of_range_is_missing(motion):
    sonar = sensors.read_sonar(motion, SonarModel(max_range_m=1.2), sensors.generator(4, "sonar"))
    missing = np.isnan(sonar.range_m)
    assert 0 < missing.mean() < 0.9
    high = motion.at(sonar.stamps_s).w_p_m[:, 2] > 1.25
    assert missing[high].all()


def test_a_stream_draws_from_its_own_generator():
    a = sensors.generator(0, "imu").standard_normal(1000)
    b = sensors.generator(0, "sonar").standard_normal(1000)
    c = sensors.generator(1, "imu").standard_normal(1000)
    assert np.array_equal(a, sensors.generator(0, "imu").standard_normal(1000))
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.15
    assert abs(np.corrcoef(a, c)[0, 1]) < 0.15
