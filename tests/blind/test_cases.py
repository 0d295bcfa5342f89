"""Hidden effects: each one shows, as strongly as stated, and the folders give nothing away."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from tests.blind.cases import (
    CHANCE,
    CONTACT,
    KINDS,
    Outing,
    go_together,
    nuisances_of,
    plans_for,
    sized,
    suite,
)
from tests.blind.faults import (
    BY_NAME,
    FAULTS,
    FURTHER,
    SEEN,
    SEEN_STRANGE,
    STRANGE,
    STRANGER,
    UNTELLABLE,
    Blind,
)
from tests.blind.instruments import (
    NOISE,
    RATE_HZ,
    STUCK,
    attitude,
    heard,
    moments,
    noisier,
    noisy,
    streams,
    stuck,
)
from tests.blind.settling import unexplained
from tests.blind.strength import NUISANCES, STEP_S, outputs, strengths, whitened
from tests.blind.vehicle import HEALTHY

ALL = tuple(RATE_HZ)
SHORT = Outing(3, 0, ("reversing_steps", "vertical_square"), 12.0)


@pytest.mark.slow
def test_the_whitening_makes_hold_noise_and_instruments_white():
    """What is left of a restless hover has unit variance and no memory."""
    outing = Outing(5, 0, ("hover",) * 2, 45.0)
    restless = outing.fly([(f, HEALTHY) for f in range(2)], STEP_S / 8, restless=True)
    still = outputs(outing.fly([(0, HEALTHY)], STEP_S / 8, restless=False), 0, ALL)
    rng = np.random.default_rng(1)
    std = {
        name: NOISE[name] * np.sqrt(1.0 / (RATE_HZ[stream] * STEP_S))
        for name, stream in (
            ("gyro", "imu0"), ("accel", "imu0"), ("attitude", "attitude0"), ("velocity", "velocity0"),
            ("sonar", "sonar0"),
        )
    }  # fmt: skip
    level = ("gyro", "attitude", "velocity", "accel")
    channels = {"ahead": level, "left": level, "up": ("sonar", "accel"), "turn": ("gyro", "attitude")}
    for f in range(2):
        seen = outputs(restless, f, ALL)
        # Start height and heading are each flight's own.
        seen["up"][:, 0] -= seen["up"][0, 0] - still["up"][0, 0]
        seen["turn"][:, 1] -= seen["turn"][0, 1] - still["turn"][0, 1]
        rough = {
            axis: (
                seen[axis] - still[axis] + rng.standard_normal(seen[axis].shape) * [std[c] for c in names]
            )[..., None]
            for axis, names in channels.items()
        }
        left = whitened(rough, HEALTHY)[50:, :, 0]
        np.testing.assert_allclose(left.var(axis=0), 1.0, atol=0.11)
        memory = np.mean(left[1:] * left[:-1], axis=0)
        assert np.abs(memory).max() < 0.08


def test_strength_grows_as_the_amplitude_and_nuisances_explain_themselves():
    base = nuisances_of(np.random.default_rng(2))
    steps = [{**base, n: base[n] + step} for n, (step, _) in NUISANCES.items()]
    halves = [half / step for step, half in NUISANCES.values()]
    others = [{**base, "cd_area": 0.002}, {**base, "cd_area": 0.004}, {**base, "gain": base["gain"] * 1.05}]
    trace = SHORT.traces(base, [*steps, *others], ALL)
    d = strengths(trace[:, 4:], trace[:, :4], halves)
    assert d[1] / d[0] == pytest.approx(2.0, rel=0.03)
    alone = np.sqrt(np.sum(trace[:, 4:] ** 2, axis=0))
    assert np.all(d <= alone)
    assert d[2] < 2.0 < 7.0 < alone[2]


def test_what_turns_the_vehicle_shows_in_its_turning_alone():
    outing = Outing(3, 0, ("yaw_repeat",), 12.0)
    path = outing.fly([(0, HEALTHY), (0, {**HEALTHY, "spin_drag": 0.1})], STEP_S / 8, restless=False)
    healthy, slower = outputs(path, 0, ALL), outputs(path, 1, ALL, beside=0)
    assert np.abs(slower["turn"] - healthy["turn"]).max() > 0.05
    for axis in ("ahead", "left"):
        np.testing.assert_allclose(slower[axis], healthy[axis], atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["climb_asymmetry", "sonar_tilt", "accel_bias", "flow_scale"])
def test_an_effect_is_sized_to_its_strength(name):
    base = nuisances_of(np.random.default_rng(4))
    _, hidden, _ = sized(SHORT, base, BY_NAME[name], 7.0, ALL)
    assert hidden.d == pytest.approx(7.0, rel=0.06)


OUTINGS = (
    Outing(3, 0, ("reversing_steps", "vertical_square"), 12.0),
    Outing(3, 1, ("touchdown", "yaw_repeat"), 20.0),
    Outing(3, 2, ("tilt_pulses",), 12.0),
)


def strongest(name: str) -> dict[str, float]:
    fault = BY_NAME[name]
    amplitude = fault.low if name in ("tilt_limit", "flow_saturation", "lazy_servo") else fault.high
    return {**HEALTHY, **fault.apply(amplitude, dict(HEALTHY), np.random.default_rng(1))}


@pytest.mark.parametrize(
    "outing",
    [OUTINGS[0], *(pytest.param(outing, marks=pytest.mark.slow) for outing in OUTINGS[1:])],
    ids=lambda outing: outing.plans[0],
)
def test_every_effect_changes_what_is_read(outing):
    """At its largest far beyond the noise, where a plan that shows it is flown."""
    shown = [
        f.name for f in (*FAULTS, *FURTHER, *STRANGE, *STRANGER)
        if f.name not in (*CHANCE, *CONTACT) and (set(f.needs) & set(outing.plans) or not f.needs)
    ]  # fmt: skip
    traces = outing.traces(HEALTHY, [strongest(name) for name in shown], ALL)
    alone = dict(zip(shown, np.sqrt(np.sum(traces**2, axis=0)), strict=True))
    # A sonar that warms drifts no faster than the height may: weak at best.
    assert {n: d for n, d in alone.items() if d < (1.0 if n == "sonar_temperature" else 6.0)} == {}


def test_every_effect_is_shown_by_some_outing():
    flown = {plan for outing in OUTINGS for plan in outing.plans}
    assert [f.name for f in BY_NAME.values() if f.needs and not set(f.needs) & flown] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", [*CHANCE, *CONTACT])
def test_effects_of_chance_change_the_streams(name):
    outing = OUTINGS[0]
    paths = [outing.fly([(0, k)], 0.005, restless=True) for k in (HEALTHY, strongest(name))]
    read = [streams(path, 0, outing.stick(0), np.random.default_rng(8)) for path in paths]
    same = [
        np.array_equal(a, b, equal_nan=True) for s in ALL for a, b in zip(*(r[s] for r in read), strict=True)
    ]
    assert not all(same)


ALIKE = 2.0
"""Sigmas of a difference of two nats: half of what two causes must differ by to be separated."""


def left_by_the_rival(blind: Blind, seed: int) -> float:
    """Sigmas of an effect that the other cause of its set, at its best size, does not explain."""
    rng = np.random.default_rng(seed)
    outing = Outing(seed, 0, tuple(str(rng.choice(blind.plans)) for _ in range(4)), 40.0, one_heading=True)
    base = nuisances_of(rng)
    hidden = replace(BY_NAME[blind.fault], scaled=True)
    _, what, trace = sized(outing, base, hidden, blind.strength, blind.streams)
    assert what.d == pytest.approx(blind.strength, rel=0.1)
    rivals = [n for n in blind.equivalents if n != blind.fault]
    return min(unexplained(outing, base, trace, rival, blind.streams) for rival in rivals)


@pytest.mark.slow
@pytest.mark.parametrize("blind", [b for b in UNTELLABLE if b.strength], ids=lambda b: b.fault)
def test_what_cannot_be_separated_leaves_the_same_trace(blind):
    """By the generator's own whitening, whatever a critic says."""
    assert left_by_the_rival(blind, 5) < ALIKE


@pytest.mark.slow
def test_pulses_that_every_instrument_sees_do_tell():
    """Brakes lean, drag does not."""
    known = next(b for b in UNTELLABLE if b.fault == "asymmetric_drag")
    seen = replace(known, plans=("pulse_and_coast",), streams=ALL, strength=12.0)
    assert left_by_the_rival(seen, 5) > 2.0 * ALIKE


def test_a_flow_that_sticks_repeats_its_share_of_readings():
    flow = np.arange(40000.0)[:, None] * np.ones(2)
    held = stuck(flow, 0.1, np.random.default_rng(1))
    repeats = held[1:, 0] == held[:-1, 0]
    assert np.mean(repeats) == pytest.approx(0.1, abs=0.015)
    assert np.array_equal(held[:, 0], held[:, 1])
    assert np.all(held[1:, 0] >= held[:-1, 0])
    ends = np.flatnonzero(np.diff(np.concatenate([[0], repeats.astype(int), [0]])) == -1)
    begins = np.flatnonzero(np.diff(np.concatenate([[0], repeats.astype(int), [0]])) == 1)
    assert np.median(ends - begins) == STUCK - 1


def test_the_catalogue_is_covered():
    """Every term is hidden by some case, but what holds no nominal vehicle's place."""
    from slam.simulation.terms import CATALOGUE

    assert {f.name for f in (*FAULTS, *FURTHER, *SEEN)} == set(CATALOGUE) - {"position_hold"}
    assert not {f.name for f in (*STRANGE, *STRANGER, *SEEN_STRANGE)} & set(CATALOGUE)
    assert len(STRANGE) >= 5
    assert len(SEEN_STRANGE) >= 5


def test_a_suite_holds_every_kind_and_cause():
    drawn = suite(500, KINDS)
    assert {kind for kind, _ in drawn} == set(KINDS)
    assert {fault for kind, fault in drawn if kind == "single"} == {f.name for f in FAULTS}
    assert {fault for kind, fault in drawn if kind == "seen_single"} == {f.name for f in SEEN}
    assert {fault for kind, fault in drawn if kind == "untellable"} == {b.fault for b in UNTELLABLE}
    assert suite(40, KINDS) == drawn[:40]


def test_new_kinds_change_no_case_of_the_seeds_that_were_run():
    """Kinds, effects, nuisances and plans of the suites that docs/blind.md counts."""
    old = KINDS[:11]
    assert old[-1] == "seen_strange"
    drawn = [repr(suite(500, old[:count])) for count in (8, 11)]
    for seed, kind in ((7104, "null"), (5502, "null_edge"), (7104, "null_heavy"), (7105, "null_coloured")):
        rng = np.random.Generator(np.random.Philox(np.random.SeedSequence((seed, 3))))
        flags = [kind == f"null_{what}" for what in ("edge", "heavy", "coloured")]
        knobs = nuisances_of(rng, *flags)
        rng.uniform()
        changed = {name: f"{value:.9g}" for name, value in sorted(knobs.items()) if value != HEALTHY[name]}
        drawn.append(repr((seed, changed, plans_for([], 4, rng))))
    digest = hashlib.sha256("\n".join(drawn).encode()).hexdigest()
    assert digest[:16] == "6c369f4c275d303c"


@pytest.mark.parametrize(
    ("f", "stream", "true"),
    [(0, "sonar0", heard), pytest.param(1, "attitude0", None, marks=pytest.mark.slow)],
)
def test_uneven_noise_grows_within_the_flight_and_stays_within_what_is_healthy(f, stream, true):
    knobs = nuisances_of(np.random.default_rng(3), uneven=True)
    outing = Outing(3, 2, ("two_heights", "reversing_steps"), 20.0)
    path = outing.fly([(f, knobs), (f, {**knobs, "uneven": 0.0})], 0.005, restless=True)
    uneven, even = (streams(path, m, outing.stick(f), np.random.default_rng(8))[stream] for m in range(2))
    np.testing.assert_array_equal(uneven[0], even[0])
    there = moments(path, 0, even[0])
    values = attitude(there)[:, :2] if true is None else true(path, 0, even[0])[:, None]
    noise = [read[1][:, : values.shape[1]] - values for read in (uneven, even)]
    times = noisier(there, stream)
    np.testing.assert_allclose(noise[0], times * noise[1], atol=2e-4)
    assert 0.8 <= times.min() < times.max() - 0.15 <= 1.05


def test_a_plan_that_shows_an_effect_is_flown():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        for fault in FAULTS:
            plans = plans_for([fault], 3, rng)
            assert len(plans) == 3
            assert not fault.needs or set(fault.needs) & set(plans)


def test_any_two_effects_that_go_together_are_both_shown_and_nobody_lands_on_a_slope():
    rng = np.random.default_rng(5)
    pairs = [(a, b) for a in FAULTS for b in FAULTS if go_together(a, b)]
    assert len(pairs) > 500
    for pair in pairs:
        plans = plans_for(pair, 4, rng)
        assert all(not fault.needs or set(fault.needs) & set(plans) for fault in pair)
        assert "touchdown" not in plans or all(fault.family != "place" for fault in pair)


def test_coloured_noise_spreads_as_white_noise_does_and_remembers():
    rng = np.random.default_rng(1)
    draws = noisy(np.zeros((20_000, 2)), 0.3, {"tails": 0.0, "colour": 0.5}, rng)
    assert draws.std() == pytest.approx(0.3, rel=0.03)
    for column in draws.T:
        assert np.corrcoef(column[1:], column[:-1])[0, 1] == pytest.approx(0.5, abs=0.03)
    assert abs(np.corrcoef(draws.T)[0, 1]) < 0.03
