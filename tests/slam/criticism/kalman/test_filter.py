"""The filter against the simulator: white under the truth; its tangents are the simulator's own changes."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from slam.criticism.kalman import record as record_module
from slam.criticism.kalman.filter import USED
from slam.criticism.kalman.filter_parameters import filter_parameters_of, slot
from slam.criticism.kalman.innovations import Run, whole
from slam.criticism.kalman.kernel_inputs import Perturbation, workspace_for
from slam.criticism.kalman.readings import CHANNEL_AT, CHANNELS, IMU, place_of
from slam.criticism.kalman.record import record_of
from slam.criticism.search import effects as effects_module
from slam.criticism.search.effects import PICTURES, effects_for
from slam.criticism.search.fitted_parameters import MEAN_NUISANCES, fitted_parameter
from slam.criticism.search.information import SEGMENT_S
from slam.simulation.dynamics import YAW
from slam.simulation.healthy.flights import at_lower_rates, draw_vehicle, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model
from slam.simulation.terms import CATALOGUE

TILTS = [f"short pulses of 0.2 s {way} at half stick" for way in ("forward", "to the side")] * 2
PLAN = ["tilts of 15 deg to all four sides", "yaw on the spot while climbing", "reversing forward at 0.2"]


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_innovations_are_white_under_the_truth(seed):
    vehicle = draw_vehicle(at_lower_rates(load_model("nominal")), np.random.default_rng(seed))
    record = record_of(simulate_flight(vehicle, stick_for(PLAN * 2), seed))
    run = whole(record, filter_parameters_of(vehicle))
    for channel, name in enumerate(CHANNELS):
        kind, c = place_of(channel)
        rows = record.kinds == kind
        white = run.white[rows, c][run.status[rows, c] == USED]
        n = len(white)
        assert n > 300, name
        assert abs(white.mean()) * np.sqrt(n) < 4, name
        assert abs(white.var() - 1) * np.sqrt(n / 2) < 4.5, name
        assert abs((white[1:] * white[:-1]).sum()) / np.sqrt(n) < 4.5, name


@pytest.mark.parametrize("lag_s", [0.03, 0.1])
def test_a_late_sonar_is_not_less_late_in_quick_tilts(lag_s):
    """About the true lag its score is chance: tilts that begin and end within it are no less late."""
    vehicle = at_lower_rates(load_model("nominal")).with_term("sonar_lag", T=lag_s)
    record = record_of(simulate_flight(vehicle, stick_for(TILTS), 5))
    lag = Perturbation("sonar_lag.T", *slot("sonar_lag.T"), 1e-3)
    score = information = 0.0
    for rows in Run(record, filter_parameters_of(vehicle), [lag]).segments(SEGMENT_S):
        score += float(rows.white @ rows.sensitivity[:, 0])
        information += float(rows.sensitivity[:, 0] @ rows.sensitivity[:, 0])
    assert information**-0.5 < 0.1 * lag_s
    assert abs(score) / information < max(3.0 * information**-0.5, 0.05 * lag_s)


def test_jitter_makes_gyros_scatter_no_more_than_modelled():
    vehicle = at_lower_rates(load_model("nominal")).with_term("timestamp_jitter", sigma=0.006)
    record = record_of(simulate_flight(vehicle, stick_for(TILTS), 6))
    run = whole(record, filter_parameters_of(vehicle))
    rows = record.kinds == IMU
    for c in range(3):
        white = run.white[rows, c][run.status[rows, c] == USED]
        assert 0.8 < float(np.mean(white**2)) < 1.25, CHANNELS[c]


@pytest.mark.parametrize("shown", [True, False])
def test_a_heading_that_no_instrument_shows_is_held(shown):
    """A speed ahead alone tells nothing of left and right: rounding errors must not decide between them."""
    vehicle = at_lower_rates(load_model("nominal"))
    flight = simulate_flight(vehicle, stick_for(TILTS), 7)
    assert flight.velocity is not None
    ahead = flight.velocity.v_m_s * np.array([1.0, np.nan])
    flight = replace(
        flight, imu=None, sonar=None, attitude=flight.attitude if shown else None,
        velocity=replace(flight.velocity, v_m_s=ahead),
    )  # fmt: skip
    record = record_of(flight)
    assert record.shows_heading == shown
    turned = whole(record, filter_parameters_of(vehicle)).states[:, YAW]
    assert (np.ptp(turned) > 0.0) == shown


def test_a_wrong_noise_is_seen():
    vehicle = at_lower_rates(load_model("nominal"))
    record = record_of(simulate_flight(vehicle, stick_for(PLAN), 3))
    parameters = filter_parameters_of(vehicle)
    right = whole(record, parameters).log_likelihood
    for factor in (0.9, 1.1):
        wrong = replace(parameters, noise_factor=np.full(len(CHANNELS), factor))
        assert whole(record, wrong).log_likelihood < right - 20


def silent(model):
    """A vehicle that neither jitters nor errs, with the noise that it might have had as its stated noise."""
    hold = replace(
        model.hold_noise,
        tilt_std_deg=0.0,
        yaw_rate_std_deg_s=0.0,
        velocity_std_m_s=0.0,
        velocity_up_std_m_s=0.0,
    )
    return replace(
        model,
        hold_noise=hold,
        imu=replace(model.imu, gyro_noise_density=0.0, accel_noise_density=0.0),
        attitude=replace(model.attitude, noise_std_deg=0.0),
        velocity=replace(model.velocity, noise_std_m_s=0.0),
        sonar=replace(model.sonar, noise_std_m=0.0),
    )


COLUMNS = [
    (t.name, p.name, np.sqrt(p.step) if p.squared else p.step)
    for t in CATALOGUE.values()
    if t.stream not in PICTURES
    for p in t.smooth
]
SMOOTH = {"ground_effect": ["slow descent to 0.3 m and back"], "sonar_lag": ["climb and descend by 0.6 m"]}
LOOSE = {"sonar_lag", "control_latency", "ground_effect", "command_nonlinearity", "yaw_drag"}
"""To first order only, or at stick jumps that are not judged."""


def far_from_jumps(record):
    """Events that are not within 6 ms after a jump of the stick."""
    jumps = record.stick.stamps_s[1:][np.any(np.diff(record.stick.values, axis=0) != 0, axis=1)]
    since = record.times_s - jumps[np.maximum(np.searchsorted(jumps, record.times_s) - 1, 0)]
    return (since < 0) | (since > 0.006)


@lru_cache
def healthy_record(*plan):
    """A flight of a plan without noise."""
    model = at_lower_rates(load_model("nominal"))
    return record_of(simulate_flight(silent(model), stick_for(plan), 5, maker=model))


@lru_cache
def healthy_pass(*plan):
    """What the filter makes of that flight."""
    return whole(healthy_record(*plan), filter_parameters_of(at_lower_rates(load_model("nominal"))))


@lru_cache
def known_directions():
    """Directions of all effects on that flight of the plan, by name."""
    parameters = filter_parameters_of(at_lower_rates(load_model("nominal")))
    return {d.name: d for e in effects_for([healthy_record(*PLAN)], parameters) for d in e.perturbations}


def miss_of(ill, direction, times, plan=PLAN, near_jumps=True):
    """Noise-free flights with and without: how far the innovations' change is from so often the trace."""
    model = at_lower_rates(load_model("nominal"))
    healthy = healthy_record(*plan)
    changed = record_of(simulate_flight(silent(ill), stick_for(plan), 5, maker=model))
    # The first guess is taken from the readings; here it shall be the same.
    changed = replace(changed, start=healthy.start)
    parameters = filter_parameters_of(model)
    trace = np.full(healthy.values.shape, np.nan)
    for part in Run(healthy, parameters, [direction]).segments(SEGMENT_S):
        c = part.channels - CHANNEL_AT[healthy.kinds[part.events], 0]
        trace[part.events, c] = part.sensitivity[:, 0]
    before, after = healthy_pass(*plan), whole(changed, parameters)
    used = (before.status == USED) & (after.status == USED)
    if not near_jumps:
        used &= far_from_jumps(healthy)[:, None]
    done, expected = (after.white - before.white)[used], times * trace[used]
    assert np.linalg.norm(expected) > 0
    return np.linalg.norm(done - expected) / np.linalg.norm(expected)


@pytest.mark.parametrize(("term", "parameter", "step"), COLUMNS, ids=lambda x: str(x))
def test_the_sensitivity_to_a_term_is_that_of_the_simulator(term, parameter, step):
    model = at_lower_rates(load_model("nominal"))
    size = step if term != "active_braking" else 0.05
    ill = model.with_term(term, **{parameter: (1.0 if term == "sonar_slant" else 0.0) + size})
    direction = known_directions()[f"{term}.{parameter}"]
    times = size**2 if term == "ground_effect" else size / fitted_parameter(direction.name).factor
    miss = miss_of(ill, direction, times, SMOOTH.get(term, PLAN), near_jumps=term not in LOOSE)
    assert miss < (0.15 if term in LOOSE else 0.04)


def vehicle_with(**more):
    model = at_lower_rates(load_model("nominal"))
    return replace(model, vehicle=replace(model.vehicle, **more))


def term_with(name, **parameters):
    return at_lower_rates(load_model("nominal")).with_term(name, **parameters)


@pytest.mark.parametrize(
    ("name", "ill", "times"),
    [
        ("vehicle.gain", vehicle_with(gain=1.01), 0.01),
        ("vehicle.drag_1_s", vehicle_with(drag_1_s=0.564), 5e-3),
        ("vehicle.attitude_time_s", vehicle_with(attitude_time_s=0.101), 1e-3),
        ("vehicle.attitude_time_s", term_with("attitude_lag", tau=0.101), 1e-3),
        ("sonar.datum_m", term_with("sonar_bias", b=2e-3), 2e-3),
    ],
    ids=["gain", "drag", "attitude time", "attitude_lag", "datum"],
)
def test_the_sensitivity_to_a_nuisance_is_that_of_the_simulator(name, ill, times):
    nuisance = next(n for n in MEAN_NUISANCES if n.name == name)
    assert miss_of(ill, nuisance.perturbation, times) < 0.02


def test_the_sensitivity_to_a_tilt_limit_is_that_of_the_simulator(monkeypatch):
    """Over the whole step from no limit at all to one that cuts a little: more would be outliers at first."""
    monkeypatch.setattr(effects_module, "TILT_LIMITS", (0.98,))
    model = vehicle_with()
    record = healthy_record(*PLAN)
    known = [
        d
        for e in effects_for([record], filter_parameters_of(model))
        if e.name == "tilt_limit"
        for d in e.perturbations
    ]
    (limit,) = known
    ill = term_with("tilt_limit", limit=float(limit.name.partition("@")[2]))
    assert miss_of(ill, limit, 1.0, near_jumps=False) < 0.08


def test_the_sensitivity_to_clock_drift_is_that_of_the_simulator():
    record = record_of(simulate_flight(vehicle_with(), stick_for(TILTS[:1]), 5))
    known = [d for e in effects_for([record], filter_parameters_of(vehicle_with())) for d in e.perturbations]
    drift = next(d for d in known if d.name == "clock_drift.ppm")
    assert miss_of(term_with("clock_drift", ppm=20.0), drift, 20e-6, near_jumps=False) < 0.06


def test_gusts_of_the_simulator_have_the_variance_of_the_filter():
    """Under their true size and time innovations are white; with more or less of either less likely."""
    blown = {"sigma": 0.15, "tau": 1.0}
    vehicle = term_with("gusts", **blown)
    record = record_of(simulate_flight(vehicle, stick_for(PLAN * 3), 4))
    run = whole(record, filter_parameters_of(vehicle))
    for channel, name in enumerate(CHANNELS):
        kind, c = place_of(channel)
        rows = record.kinds == kind
        white = run.white[rows, c][run.status[rows, c] == USED]
        assert abs(white.var() - 1) * np.sqrt(len(white) / 2) < 4.5, name
    for wrong in ({"sigma": 0.0}, {"sigma": 0.09}, {"sigma": 0.25}, {"tau": 0.2}, {"tau": 5.0}):
        other = filter_parameters_of(term_with("gusts", **{**blown, **wrong}))
        assert whole(record, other).log_likelihood < run.log_likelihood - 8.0, wrong


def test_steps_half_as_long_change_nothing(monkeypatch):
    """Over a flight of half a minute, all innovations together, by far less than what is judged."""
    vehicle = draw_vehicle(at_lower_rates(load_model("nominal")), np.random.default_rng(1))
    flight = simulate_flight(vehicle, stick_for(PLAN * 2), 1)
    usual = record_of(flight)
    run = whole(usual, filter_parameters_of(vehicle))
    monkeypatch.setattr(record_module, "LONGEST_STEP_S", record_module.LONGEST_STEP_S / 2)
    finer = record_of(flight)
    again = whole(finer, filter_parameters_of(vehicle))
    assert len(finer.steps[1]) > 1.5 * len(usual.steps[1])
    np.testing.assert_array_equal(run.status, again.status)
    change = (again.white - run.white)[run.status == USED]
    assert np.abs(change).max() < 0.03
    assert np.linalg.norm(change) < 0.3


def test_a_late_vehicle_is_known_less_well_just_after_the_stick_jumps():
    model = at_lower_rates(load_model("nominal")).with_term("control_latency", T=0.1)
    record = record_of(simulate_flight(model, stick_for(["pulse of 1 s forward at 0.25 and coast"]), 3))
    sure = whole(record, replace(filter_parameters_of(model), latency_s=0.0))
    unsure = whole(record, filter_parameters_of(model))
    pitch = (record.kinds == 1) & (unsure.status[:, 1] == USED)
    wider = unsure.log_variance[pitch, 1] - sure.log_variance[pitch, 1]
    jumps = np.flatnonzero(np.any(np.diff(record.stick.values, axis=0) != 0, axis=1))
    since = record.times_s[pitch] - (record.stick.stamps_s[jumps[0] + 1] + 0.1)
    assert wider[(since > 0.0) & (since < 0.05)].max() > 0.05
    # Gyro readings beside the jump itself are left out, which the pitch hardly feels.
    assert abs(wider[since < 0.0]).max() < 0.02


def test_the_process_noise_near_the_floor_shows_no_height():
    from slam.criticism.kalman.transition import jacobian

    parameters = filter_parameters_of(load_model("nominal"))
    state = np.zeros(19)
    state[2], state[10:19] = 0.1, 0.05
    rate, slopes = np.empty(12), np.empty((10, 19))
    jacobian(state, np.zeros(6), parameters.dynamics, rate, slopes, workspace_for(19, 0, 1)[3])
    assert not slopes[[0, 1, 2, 3, 4, 6, 7, 8, 9], 2].any()


def test_joined_terms_are_of_a_module_so_that_another_process_can_load_them_from_the_cache():
    from slam.criticism.kalman import readings

    assert readings.reading_terms("imu").py_func.__module__ == readings.__name__
