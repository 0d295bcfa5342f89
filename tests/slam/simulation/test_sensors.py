from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend.measurements import GRAVITY_M_S2
from slam.simulation import sensors
from slam.simulation.battery import open_circuit_v, read_battery
from slam.simulation.chance import generator
from slam.simulation.hold_noise import HoldNoise
from slam.simulation.instruments import (
    AttitudeModel,
    BatteryModel,
    CommandModel,
    ImuModel,
    SonarModel,
    VelocityModel,
)
from slam.simulation.model import Model
from slam.simulation.motion import at_rest, draw_model_noise, simulate_motion, step_count
from slam.simulation.place.obstacles import Box
from slam.simulation.place.world import World
from slam.simulation.stick import Stick
from slam.simulation.terms import CATALOGUE

WORLD = World(extent_m=(-50, -50, 50, 50))
CLEAN = Model(
    imu=ImuModel(gyro_noise_density=0, accel_noise_density=0),
    attitude=AttitudeModel(noise_std_deg=0),
    velocity=VelocityModel(noise_std_m_s=0),
    sonar=SonarModel(noise_std_m=0),
    battery=BatteryModel(noise_std_v=0),
)


@pytest.fixture(scope="module")
def motion():
    stamps = np.arange(0, 20, 1.7)
    stick = Stick(
        stamps, np.random.default_rng(0).uniform(-0.3, 0.3, (len(stamps), 4)) * [1, 1, 0.4, 1], 20.0
    )
    rngs = np.random.default_rng(1), np.random.default_rng(2)
    return simulate_motion(
        stick, Model(), at_rest(0, 0, 1.2, 0.3), draw_model_noise(Model(), step_count(20.0), rngs)
    )


def clean(kind, motion, model=CLEAN, seed=0, world=WORLD):
    if kind in ("velocity", "sonar"):
        return getattr(sensors, f"read_{kind}")(motion, model, world, seed)
    return getattr(sensors, f"read_{kind}")(motion, model, seed)


@pytest.mark.parametrize("rate_hz", [0.01, 4.0, 15.0, 100.0])
@pytest.mark.parametrize("seed", range(5))
def test_stamps_are_regular_within_the_flight_and_whole_nanoseconds(rate_hz, seed):
    t = sensors.stamps(rate_hz, 12.3, np.random.default_rng(seed))
    assert 0 <= t[0] < sensors.LATEST_START_S
    assert 12.3 - 1 / rate_hz < t[-1] <= 12.3 + 1e-9
    assert np.allclose(np.diff(t), 1 / rate_hz, atol=2e-9)
    assert np.array_equal(t, np.round(t * 1e9) / 1e9)


def test_streams_start_at_phases_of_their_own(motion):
    first = [clean(kind, motion, seed=3).stamps_s[0] for kind in ("imu", "attitude", "velocity", "sonar")]
    assert len(set(first)) == 4


def test_without_noise_each_instrument_reads_the_motion(motion):
    imu, attitude = clean("imu", motion), clean("attitude", motion)
    velocity, sonar = clean("velocity", motion), clean("sonar", motion)
    state = motion.at(imu.stamps_s)
    assert np.allclose(imu.gyro_rad_s, state.b_rate_rad_s, atol=1e-12)
    assert np.allclose(imu.accel_m_s2, state.b_specific_force_m_s2, atol=1e-12)
    assert np.array_equal(attitude.roll_pitch_yaw_rad, motion.at(attitude.stamps_s).roll_pitch_yaw_rad)
    assert np.allclose(velocity.v_m_s, motion.at(velocity.stamps_s).h_v_m_s, atol=1e-12)
    pose = motion.at(sonar.stamps_s).w_T_b
    echo = pose[:, :3, 3] - sonar.range_m[:, None] * pose[:, :3, 2]
    assert np.abs(echo[:, 2]).max() < 1e-12


@pytest.mark.parametrize("kind", ["imu", "attitude", "velocity", "sonar"])
@pytest.mark.parametrize("rate_hz", [50.0, 200.0])
def test_noise_has_its_size_at_any_rate_and_no_mean(motion, kind, rate_hz):
    part = {kind: replace(getattr(Model(), kind), rate_hz=rate_hz)}
    silent = {kind: replace(getattr(CLEAN, kind), rate_hz=rate_hz)}
    noisy, quiet = (
        clean(kind, motion, replace(Model(), **part)),
        clean(kind, motion, replace(CLEAN, **silent)),
    )
    noises = {
        "imu": lambda: [
            (noisy.gyro_rad_s - quiet.gyro_rad_s, 1.5e-3 * np.sqrt(rate_hz)),
            (noisy.accel_m_s2 - quiet.accel_m_s2, 5e-2 * np.sqrt(rate_hz)),
        ],
        "attitude": lambda: [(noisy.roll_pitch_yaw_rad - quiet.roll_pitch_yaw_rad, np.radians(0.3))],
        "velocity": lambda: [(noisy.v_m_s - quiet.v_m_s, 0.03)],
        "sonar": lambda: [((noisy.range_m - quiet.range_m)[np.isfinite(noisy.range_m)], 0.01)],
    }
    for noise, std in noises[kind]():
        assert noise.std() == pytest.approx(std, rel=4 / np.sqrt(2 * noise.size))
        assert abs(noise.mean()) < 4 * std / np.sqrt(noise.size)


@pytest.mark.parametrize("correlation", [0.3, 0.8])
def test_ar1_noise_keeps_its_variance_and_has_its_correlation(correlation):
    white = np.random.default_rng(3).normal(0.0, 0.2, (40_000, 2))
    noise = sensors.autoregressive(white, correlation)
    chance = 5 / np.sqrt(len(noise) * (1 - correlation) / (1 + correlation))
    assert np.allclose(noise.std(axis=0) / 0.2, 1.0, atol=chance)
    for apart in (1, 3):
        alike = [np.corrcoef(column[apart:], column[:-apart])[0, 1] for column in noise.T]
        assert np.allclose(alike, correlation**apart, atol=chance)
    assert sensors.autoregressive(white, 0.0) is white


@pytest.mark.parametrize("kind", ["imu", "attitude", "velocity", "sonar"])
def test_each_instrument_has_the_noise_correlation_of_its_model(motion, kind):
    names = ("gyro_noise_correlation", "accel_noise_correlation") if kind == "imu" else ("noise_correlation",)
    own = replace(getattr(Model(), kind), rate_hz=500.0, **dict.fromkeys(names, 0.6))
    quiet = replace(getattr(CLEAN, kind), rate_hz=500.0)
    read = clean(kind, motion, replace(Model(), **{kind: own}))
    true = clean(kind, motion, replace(CLEAN, **{kind: quiet}))
    fields = {
        "imu": ("gyro_rad_s", "accel_m_s2"),
        "attitude": ("roll_pitch_yaw_rad",),
        "velocity": ("v_m_s",),
    }
    for name in fields.get(kind, ("range_m",)):
        noise = (getattr(read, name) - getattr(true, name)).reshape(len(read.stamps_s), -1)
        alike = (noise[1:] * noise[:-1]).sum() / (noise**2).sum()
        assert alike == pytest.approx(0.6, abs=5 * np.sqrt((1 - 0.6**2) / noise.size))


def test_out_of_range_is_missing(motion):
    model = replace(CLEAN, sonar=SonarModel(noise_std_m=0, max_range_m=1.2))
    sonar = clean("sonar", motion, model)
    missing = np.isnan(sonar.range_m)
    state = motion.at(sonar.stamps_s)
    slant = state.w_p_m[:, 2] / np.cos(state.roll_pitch_yaw_rad[:, :2]).prod(1)
    assert 0 < missing.mean() < 1
    assert np.array_equal(missing, slant > 1.2)


def imu_pair(motion, term, **values):
    return clean("imu", motion, CLEAN.with_term(term, **values)), clean("imu", motion)


def test_imu_terms_do_what_their_equations_say(motion):
    bias, plain = imu_pair(motion, "gyro_bias", x=0.01, z=-0.02)
    assert np.allclose(bias.gyro_rad_s - plain.gyro_rad_s, [0.01, 0, -0.02])
    scale, _ = imu_pair(motion, "gyro_scale", eps=0.03)
    assert np.allclose(scale.gyro_rad_s, 1.03 * plain.gyro_rad_s)
    offset, _ = imu_pair(motion, "accel_bias", y=0.2)
    assert np.allclose(offset.accel_m_s2 - plain.accel_m_s2, [0, 0.2, 0])
    gain, _ = imu_pair(motion, "accel_scale", eps=-0.02)
    assert np.allclose(gain.accel_m_s2, 0.98 * plain.accel_m_s2)
    turned, _ = imu_pair(motion, "imu_misalignment", y=0.05)
    # A unit turned nose down feels a part of gravity along its -x, as a vehicle that pitches does.
    expected = Rotation.from_rotvec([0, 0.05, 0]).as_matrix().T @ [0, 0, GRAVITY_M_S2]
    still = simulate_motion(Stick(np.zeros(1), np.zeros((1, 4)), 1.0), CLEAN, at_rest(0, 0, 1, 0))
    hover = clean("imu", still, CLEAN.with_term("imu_misalignment", y=0.05))
    assert np.allclose(hover.accel_m_s2, expected)
    assert expected[0] < 0
    assert np.allclose(np.linalg.norm(turned.gyro_rad_s, axis=1), np.linalg.norm(plain.gyro_rad_s, axis=1))


def test_imu_random_walks_grow_with_the_root_of_time(motion):
    model = replace(CLEAN, imu=replace(CLEAN.imu, gyro_random_walk=0.01, rate_hz=50.0))
    ends = []
    for seed in range(150):
        walk = clean("imu", motion, model, seed).gyro_rad_s - clean("imu", motion, CLEAN_50, seed).gyro_rad_s
        ends.append(walk[[len(walk) // 4, -1]])
    spread = np.std(np.array(ends), axis=(0, 2))
    assert spread[1] == pytest.approx(0.01 * np.sqrt(20), rel=0.12)
    assert spread[1] / spread[0] == pytest.approx(2.0, rel=0.15)


CLEAN_50 = replace(CLEAN, imu=replace(CLEAN.imu, rate_hz=50.0))


def sonar_with(motion, term, **values):
    return clean("sonar", motion, CLEAN.with_term(term, **values)).range_m


def test_sonar_terms_do_what_their_equations_say(motion):
    plain = clean("sonar", motion)
    state = motion.at(plain.stamps_s)
    roll, pitch, _ = state.roll_pitch_yaw_rad.T
    z, r = state.w_p_m[:, 2], plain.range_m
    assert np.allclose(sonar_with(motion, "sonar_bias", b=0.03), r + 0.03)
    assert np.allclose(sonar_with(motion, "sonar_scale", eps=0.04), 1.04 * r)
    slanted = z * (1 + 0.3 * (1 / (np.cos(roll) * np.cos(pitch)) - 1))
    assert np.allclose(sonar_with(motion, "sonar_slant", c=0.3), slanted, atol=1e-9)
    tilted = r + z * (0.02 * np.tan(roll) - 0.03 * np.tan(pitch))
    assert np.abs(sonar_with(motion, "sonar_tilt", x=0.02, y=-0.03) - tilted).max() < 2e-3
    assert np.abs(sonar_with(motion, "sonar_tilt", x=0.02, y=-0.03) - r).max() > 4e-3
    warm = 343.42 / (331.3 + 0.606 * (20 + 10 * plain.stamps_s / 20))
    assert np.allclose(sonar_with(motion, "sonar_temperature", rise=10.0), r * warm, rtol=1e-5)
    steps = sonar_with(motion, "sonar_quantisation", step=0.03) / 0.03
    assert np.allclose(steps, np.round(steps))
    assert np.abs(0.03 * steps - r).max() <= 0.015 + 1e-12
    late = motion.at(plain.stamps_s - 0.1)
    slant = late.w_p_m[:, 2] / np.cos(late.roll_pitch_yaw_rad[:, :2]).prod(1)
    assert np.allclose(sonar_with(motion, "sonar_lag", T=0.1), slant)


def test_a_blind_zone_is_reported_as_its_limit():
    low = simulate_motion(Stick(np.zeros(1), np.array([[0, 0, -0.2, 0]]), 4.0), CLEAN, at_rest(0, 0, 0.8, 0))
    blind = clean("sonar", low, CLEAN.with_term("sonar_dead_zone", limit=0.3)).range_m
    open_ = clean("sonar", low).range_m
    assert np.isnan(open_).any()
    assert not np.isnan(blind).any()
    assert np.array_equal(blind[~(open_ >= 0.3)], np.full(np.sum(~(open_ >= 0.3)), 0.3))


def test_spikes_come_in_their_share_near_twice_the_range(motion):
    model = replace(CLEAN, sonar=replace(CLEAN.sonar, rate_hz=200.0))
    plain = clean("sonar", motion, model).range_m
    spiky = clean("sonar", motion, model.with_term("sonar_spikes", share=0.05)).range_m
    hit = spiky != plain
    assert hit.mean() == pytest.approx(0.05, abs=4 * np.sqrt(0.05 / len(hit)))
    assert np.all(np.abs(spiky[hit] / plain[hit] - 2) < 0.3)


def test_flow_terms_do_what_their_equations_say(motion):
    plain = clean("velocity", motion)
    state = motion.at(plain.stamps_s)
    scaled = clean("velocity", motion, CLEAN.with_term("flow_scale", eps=-0.2))
    assert np.allclose(scaled.v_m_s, 0.8 * plain.v_m_s)
    leaking = clean("velocity", motion, CLEAN.with_term("flow_derotation", kappa=0.1))
    turning = state.b_rate_rad_s[:, [1, 0]] * [1, -1] * state.w_p_m[:, 2:]
    assert np.allclose(leaking.v_m_s - plain.v_m_s, 0.1 * turning)


def test_clocks_drift_and_jitter_but_stamps_increase(motion):
    plain = clean("imu", motion)
    drift = clean("imu", motion, CLEAN.with_term("clock_drift", ppm=500.0))
    assert np.allclose(drift.stamps_s, plain.stamps_s * 1.0005, atol=2e-9)
    assert np.array_equal(drift.gyro_rad_s, plain.gyro_rad_s)
    jitter = clean("imu", motion, CLEAN.with_term("timestamp_jitter", sigma=0.003))
    off = jitter.stamps_s - plain.stamps_s
    assert np.all(np.diff(jitter.stamps_s) > 0)
    assert 0.002 < off.std() < 0.0035
    command = sensors.log_command(motion.stick, CLEAN.with_term("clock_drift", ppm=500.0))
    assert np.array_equal(command.stamps_s, sensors.log_command(motion.stick, CLEAN).stamps_s)


def test_the_sonar_measures_boxes_and_slopes(motion):
    x, y = motion.states[-1, :2]
    box = replace(WORLD, boxes=(Box((x, y), (0.6, 0.6, 0.3)),))
    range_m = clean("sonar", motion, world=box).range_m
    assert range_m[-1] < clean("sonar", motion).range_m[-1] - 0.2
    slope = replace(WORLD, slope=(0.05, 0.0))
    assert np.abs(clean("sonar", motion, world=slope).range_m - clean("sonar", motion).range_m).max() > 0.05


@pytest.mark.parametrize(
    "name",
    sorted(n for n, t in CATALOGUE.items() if t.acts_on in ("sensor", "clock") and t.family != "camera"),
)
def test_a_sensor_term_changes_readings_and_its_neutral_value_nothing(motion, name):
    def all_readings(model):
        imu, attitude = clean("imu", motion, model), clean("attitude", motion, model)
        velocity, sonar = clean("velocity", motion, model), clean("sonar", motion, model)
        low = replace(model, sonar=replace(model.sonar, min_range_m=0.0))
        return np.concatenate([
            imu.stamps_s, imu.gyro_rad_s.ravel(), imu.accel_m_s2.ravel(), attitude.stamps_s,
            velocity.v_m_s.ravel(), sonar.range_m, clean("sonar", motion, low).range_m,
        ])  # fmt: skip

    term = CATALOGUE[name]
    plain = all_readings(CLEAN)
    neutral = all_readings(CLEAN.with_term(name, **term.neutral))
    assert np.array_equal(plain, neutral, equal_nan=True)
    sizes = {p.name: p.low if p.neutral == p.high else p.high for p in term.parameters}
    if name == "sonar_dead_zone":
        sizes = {"limit": 1.5}
    assert not np.array_equal(plain, all_readings(CLEAN.with_term(name, **sizes)), equal_nan=True)


def test_the_battery_falls_and_dips_with_the_current():
    stick = Stick(np.array([0.0, 5.0, 5.5]), np.array([[0, 0, 0, 0], [0.5, 0, 0.5, 0], [0, 0, 0, 0.0]]), 60.0)
    motion = simulate_motion(stick, CLEAN, at_rest(0, 0, 5, 0))
    model = replace(CLEAN, battery=replace(CLEAN.battery, rate_hz=50.0))
    battery = read_battery(motion, model, 0)
    t, v = battery.stamps_s, battery.value
    assert v[-1] < v[0] - 0.05
    dip = np.interp(5.25, t, v)
    assert dip < np.interp(4.9, t, v) - 0.05
    assert np.interp(5.6, t, v) > dip + 0.05
    charge = np.linspace(0, 1, 100)
    assert np.all(np.diff(open_circuit_v(charge)) > 0)
    slope = np.gradient(open_circuit_v(charge), charge)
    assert slope[0] > 5 * slope[50]
    assert 12.0 < open_circuit_v(np.array([1.0]))[0] < 12.7


def test_the_command_log_has_each_change_and_twenty_rows_a_second():
    stick = Stick(np.array([0.0, 1.013, 1.02, 3.0]), np.array([[0.1, 0, 0, 0], [0, 0.1, 0, 0]] * 2), 4.0)
    log = sensors.log_command(stick, Model())
    assert set(np.round([0.0, 1.013, 1.02, 3.0], 9)) <= set(log.stamps_s)
    assert np.diff(log.stamps_s).max() <= 0.05 + 1e-9
    assert np.all(np.diff(log.stamps_s) > 1e-7)
    held = Stick(log.stamps_s, log.stick, 4.0)
    t = np.linspace(0, 3.999, 4001) + 1e-7
    assert np.array_equal(held.at(t), stick.at(t))
    slow = sensors.log_command(stick, replace(Model(), command=CommandModel(rate_hz=1.0)))
    assert len(slow.stamps_s) < 10


def test_a_stream_draws_from_its_own_generator():
    a = generator(0, "imu").standard_normal(1000)
    b = generator(0, "sonar").standard_normal(1000)
    c = generator(1, "imu").standard_normal(1000)
    assert np.array_equal(a, generator(0, "imu").standard_normal(1000))
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.15
    assert abs(np.corrcoef(a, c)[0, 1]) < 0.15
    assert HoldNoise().tilt_std_deg == 0.4
