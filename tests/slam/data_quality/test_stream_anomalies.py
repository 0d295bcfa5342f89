"""Anomalies of whole streams in made readings: a slow motion with white noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.data_quality.channels import InstrumentReadings
from slam.data_quality.frozen import frozen
from slam.data_quality.oscillation import strongest_line
from slam.data_quality.rounding import rounding

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
