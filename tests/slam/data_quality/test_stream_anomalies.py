"""Anomalies of whole streams in made readings: a slow motion with white noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.streams import Sonar
from slam.data_quality.channels import InstrumentReadings
from slam.data_quality.frozen import frozen, never
from slam.data_quality.in_motion import others_move
from slam.data_quality.oscillation import strongest_line
from slam.data_quality.rounding import rounding
from slam.data_quality.silent import silent

RATE_HZ, STD = 50.0, 0.02


def stream(seed: int = 0, repeats: int = 1) -> InstrumentReadings:
    """Readings of a minute, each logged several times."""
    t = np.arange(3000) / RATE_HZ
    slow = np.column_stack([np.sin(0.5 * t), np.cos(0.3 * t)])
    values = slow + np.random.default_rng(seed).normal(0.0, STD, slow.shape)
    values = values[np.arange(len(t)) // repeats * repeats]
    return InstrumentReadings("velocity", t, values, ("ahead", "left"), "m/s", np.full(2, STD))


def freeze(healthy: InstrumentReadings, lasts_s: float, every_s: float = 5.0) -> InstrumentReadings:
    since = np.mod(healthy.stamps_s, every_s)
    begin = np.searchsorted(healthy.stamps_s, healthy.stamps_s - since)
    held = np.where(since[:, None] < lasts_s, healthy.values[begin], healthy.values)
    return replace(healthy, values=held)


@pytest.mark.parametrize("seed", range(20))
def test_healthy_readings_have_no_anomaly(seed: int):
    for repeats in (1, 4):
        healthy = stream(seed, repeats)
        assert frozen(healthy) is None
        assert rounding(healthy) is None
        assert strongest_line(healthy) is None


@pytest.mark.parametrize(("lasts_s", "repeats"), [(0.3, 1), (0.6, 1), (1.5, 4)])
def test_frozen_runs_are_counted_with_their_length(lasts_s: float, repeats: int):
    found = frozen(freeze(stream(repeats=repeats), lasts_s))
    assert found is not None
    assert len(found.begin_s) == pytest.approx(12, abs=1)
    assert np.median(found.lasts_s) == pytest.approx(lasts_s, abs=0.1)
    assert found.share == pytest.approx(lasts_s / 5.0, abs=0.03)
    assert "velocity repeats its reading" in str(found)


def test_few_equal_readings_of_a_slow_stream_are_a_freeze_where_none_equals_the_last_otherwise():
    healthy = stream()
    slow = replace(healthy, stamps_s=healthy.stamps_s[::5], values=healthy.values[::5])
    found = frozen(freeze(slow, 0.6))
    assert found is not None
    assert len(found.begin_s) == pytest.approx(12, abs=1)
    assert np.median(found.lasts_s) == pytest.approx(0.5, abs=0.11)


@pytest.mark.parametrize("seed", range(10))
def test_readings_that_often_equal_the_last_are_not_frozen(seed: int):
    """A vehicle moves by turns: readings in coarse steps repeat for long where it stands still."""
    healthy = stream(seed)
    slow = np.sin(0.5 * healthy.stamps_s[:, None]) ** 3
    for step in (0.02, 0.1):
        noise = np.random.default_rng(seed).normal(0.0, 0.3 * step, healthy.values.shape)
        assert frozen(replace(healthy, values=step * np.round((slow + noise) / step))) is None


@pytest.mark.parametrize(
    ("begin_s", "lasts_s", "told"), [(20.0, 5.0, True), (20.0, 0.5, False), (0.0, 5.0, False)]
)
def test_a_single_long_freeze_counts_between_other_readings(begin_s: float, lasts_s: float, told: bool):
    healthy = stream()
    at = np.searchsorted(healthy.stamps_s, begin_s)
    stuck = (healthy.stamps_s >= begin_s) & (healthy.stamps_s < begin_s + lasts_s)
    found = frozen(replace(healthy, values=np.where(stuck[:, None], healthy.values[at], healthy.values)))
    assert (found is not None) == told
    if found is not None:
        assert str(found) == "the velocity repeats its reading for 5 s, at 20 s (8 % of its readings)"
    at_rest = replace(healthy, values=np.where(stuck[:, None], 0.0, healthy.values))
    assert frozen(at_rest) is None


def test_an_instrument_at_its_limit_is_not_frozen():
    healthy = stream()
    assert frozen(replace(healthy, values=np.maximum(healthy.values, 0.0))) is None


def test_readings_that_are_not_numbers_are_no_repetition():
    torn = freeze(stream(), 0.6)
    values = torn.values.copy()
    values[::7] = np.nan
    found = frozen(replace(torn, values=values))
    assert found is not None
    assert not found.repeated[::7].any()


@pytest.mark.parametrize(("step", "told"), [(0.01, False), (0.1, True), (0.5, True)])
def test_rounding_is_told_where_it_exceeds_the_noise(step: float, told: bool):
    healthy = stream()
    found = rounding(replace(healthy, values=step * np.round(healthy.values / step)))
    assert (found is not None) == told
    if found is not None:
        assert found.step == pytest.approx(step)


@pytest.mark.parametrize(("amplitude", "told"), [(0.002, False), (0.1, True)])
def test_a_line_is_told_with_frequency_and_amplitude(amplitude: float, told: bool):
    healthy = stream()
    shaken = healthy.values + amplitude * np.sin(2.0 * np.pi * 7.0 * healthy.stamps_s)[:, None]
    found = strongest_line(replace(healthy, values=shaken))
    assert (found is not None) == told
    if found is not None:
        assert found.frequency_hz == pytest.approx(7.0, abs=0.05)
        assert found.amplitude == pytest.approx(amplitude, rel=0.1)


def half_way(change):
    """Return a change of readings that begins half-way."""

    def changed(healthy: InstrumentReadings) -> InstrumentReadings:
        late = np.arange(len(healthy.values)) >= len(healthy.values) // 2
        return replace(healthy, values=np.where(late[:, None], change(healthy.values), healthy.values))

    return changed


def always(begin_s: float, end_s: float) -> bool:
    return True


@pytest.mark.parametrize("value", [0.0, None])
def test_a_stream_that_freezes_to_the_end_is_told_where_the_others_show_a_motion(value: float | None):
    at = len(stream().values) // 2
    ended = half_way(lambda x: 0.0 * x + (x[at] if value is None else value))(stream())
    found = frozen(ended, always)
    assert found is not None
    assert found.begin_s[0] == pytest.approx(30.0)
    assert found.share == pytest.approx(0.5, abs=0.01)
    # It may stand on the floor, or hover for a moment.
    assert frozen(ended) is None
    kept = ended.stamps_s < 34.5
    assert frozen(replace(ended, stamps_s=ended.stamps_s[kept], values=ended.values[kept]), always) is None


def test_a_rounding_that_begins_is_told_with_its_moment():
    found = rounding(half_way(lambda x: 0.05 * np.round(x / 0.05))(stream()))
    assert found is not None
    assert (found.begin_s, found.lasts_s) == (pytest.approx(30.0, abs=0.2), pytest.approx(30.0, abs=0.2))
    assert found.step == pytest.approx(0.05)
    assert str(found).endswith("from 30 s on, for 30 s")
    # A cause of the catalogue is a rounding of the whole flight.
    assert not replace(found, channel="range").is_shown_otherwise


@pytest.mark.parametrize("begin_s", [20.0, 40.0])
def test_a_stream_without_readings_is_told_with_begin_and_duration(begin_s: float):
    healthy = stream()
    gone = (healthy.stamps_s > begin_s) & (healthy.stamps_s < begin_s + 20.0)
    broken = replace(healthy, values=np.where(gone[:, None], np.nan, healthy.values))
    found = silent(broken, 60.0, always, None)
    assert found is not None
    assert (found.begin_s, found.lasts_s) == (pytest.approx(begin_s), pytest.approx(20.0, abs=0.1))
    assert found.is_last == (begin_s == 40.0)
    assert silent(healthy, 64.0, always, None) is None
    # It may be switched off on the floor.
    assert silent(broken, 60.0, never, None) is None


def test_a_sonar_at_its_limit_may_lose_the_echo():
    healthy = stream()
    range_m = 2.0 + np.sin(2.0 * np.pi * healthy.stamps_s / 60.0)  # highest at 15 s, in the middle at 30 s
    for begin_s, told in ((14.0, False), (29.0, True)):
        gone = (healthy.stamps_s > begin_s) & (healthy.stamps_s < begin_s + 8.0)
        values = np.where(gone, np.nan, range_m)[:, None]
        sonar = replace(healthy, name="sonar", values=values, channels=("range",))
        found = silent(sonar, 60.0, always, Sonar(healthy.stamps_s, values[:, 0], max_range_m=3.2))
        assert (found is not None) == told


@pytest.mark.parametrize(("min_range_m", "told"), [(0.9, False), (0.2, True)])
def test_a_sonar_below_its_least_range_may_lose_the_echo(min_range_m: float, told: bool):
    healthy = stream()
    range_m = 2.0 - np.sin(2.0 * np.pi * healthy.stamps_s / 60.0)  # lowest at 15 s
    gone = (healthy.stamps_s > 14.0) & (healthy.stamps_s < 22.0)
    values = np.where(gone, np.nan, range_m)[:, None]
    sonar = replace(healthy, name="sonar", values=values, channels=("range",))
    stated = Sonar(healthy.stamps_s, values[:, 0], min_range_m=min_range_m, max_range_m=6.0)
    assert (silent(sonar, 60.0, always, stated) is not None) == told


@pytest.mark.parametrize(("climb_m", "told"), [(0.1, True), (2.0, False)])
def test_a_sonar_without_a_stated_limit_that_ceases_in_level_flight_is_told(climb_m: float, told: bool):
    healthy = stream()
    t = healthy.stamps_s
    range_m = 1.5 + climb_m * np.exp(-(((t - 30.0) / 5.0) ** 2))
    values = np.where((t > 30.0) & (t < 38.0), np.nan, range_m)[:, None]
    sonar = replace(healthy, name="sonar", values=values, channels=("range",))
    found = silent(sonar, 60.0, always, Sonar(t, values[:, 0], max_range_m=np.inf))
    assert (found is not None) == told


def test_readings_that_are_rounded_throughout_do_not_begin_to_be():
    """A step below the noise that would be told of whole flights is one of the rest of the flight, too."""
    healthy = stream()
    step = 2.0 * STD
    values = step * np.round(healthy.values / step)
    other = half_way(lambda x: x + 0.3 * step)(replace(healthy, values=values))
    assert rounding(other) is None


def test_few_readings_show_no_motion():
    times_s = np.arange(60.0)
    gyro = InstrumentReadings("gyro", times_s, np.ones((60, 1)), (), "rad/s", np.ones(1))
    sonar = replace(gyro, name="sonar", values=np.full((60, 1), 2.0))
    assert not others_move([gyro, sonar], "gyro", 40.5, 59.0)
    assert others_move([gyro, sonar], "gyro", 30.5, 59.0)


def test_what_rests_while_the_others_show_no_motion_is_no_failure():
    flying, resting = stream(), replace(stream(), name="gyro")
    late = resting.stamps_s > 40.0
    resting = replace(resting, values=np.where(late[:, None], 0.01 * resting.values, resting.values))
    assert others_move([flying, resting], "gyro", 40.0, 60.0)
    assert not others_move([flying, resting], "velocity", 40.0, 60.0)


def test_a_sonar_off_the_floor_shows_a_flight_however_still():
    still = replace(stream(), name="sonar", channels=("range",))
    for range_m, flies in ((1.0, True), (0.05, False)):
        sonar = replace(still, values=np.full((len(still.stamps_s), 1), range_m))
        assert others_move([sonar], "gyro", 40.0, 60.0) == flies


def test_rest_in_a_record_that_is_mostly_rest_is_no_motion():
    rng = np.random.default_rng(0)
    t = np.arange(0, 60, 0.02)
    std = np.where((t > 15) & (t < 35), 0.3, 0.002)
    gyro = InstrumentReadings("gyro", t, std[:, None] * rng.normal(size=(len(t), 3)), (), "rad/s", np.ones(3))
    assert not others_move([gyro], "velocity", 36.0, 60.0)
    assert not others_move([gyro], "velocity", 0.0, 14.0)
    assert others_move([gyro], "velocity", 16.0, 34.0)
