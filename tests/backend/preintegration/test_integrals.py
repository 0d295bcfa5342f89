"""Integrals of readings that are slow, or have gaps."""

from __future__ import annotations

import numpy as np
import pytest

from backend.preintegration.integrals import dense, integrate_twice

LEAST_GAP_S = 0.1


def test_readings_of_a_slow_sensor_follow_fast_motion():
    """Straight lines between 25 readings a second cut 4 % off a force of 2.5 Hz."""
    stamps_s, omega = np.arange(0.0, 4.0, 0.04), 2 * np.pi * 2.5
    force = np.sin(omega * stamps_s + 0.3)[:, None]
    at_s = np.array([0.6, 1.2, 1.9, 2.7, 3.3])
    place = integrate_twice(*dense(stamps_s, force, LEAST_GAP_S), at_s)[:, 0]
    # Less initial place and velocity, which are no part of the force.
    begin = np.column_stack([np.ones_like(at_s), at_s])
    true = -np.sin(omega * at_s + 0.3) / omega**2
    seen, expected = (x - begin @ np.linalg.lstsq(begin, x, rcond=None)[0] for x in (place, true))
    assert seen @ expected / (expected @ expected) == pytest.approx(1.0, abs=0.01)


def test_readings_are_added_between_slow_ones_alone():
    fast_s = np.arange(0.0, 1.0, 0.005)
    assert dense(fast_s, fast_s[:, None], LEAST_GAP_S)[0] is fast_s
    slow_s = np.array([0.0, 0.02, 0.04, 0.06, 0.5, 0.52])
    times_s, values = dense(slow_s, slow_s[:, None], LEAST_GAP_S)
    assert np.isin(slow_s, times_s).all()
    assert sorted(set(np.diff(times_s).round(6))) == [0.005, 0.44]
    assert values[:, 0] == pytest.approx(times_s, abs=0.01)


def test_stamps_that_scatter_amplify_no_noise():
    """Two readings of a burst are a tenth of a millisecond apart."""
    stamps_s = np.arange(0.0, 4.0, 0.02)
    stamps_s[1::2] -= 0.0199
    noise = np.random.default_rng(0).normal(size=(len(stamps_s), 1))
    assert np.abs(dense(stamps_s, noise, LEAST_GAP_S)[1]).max() < 1.2 * np.abs(noise).max()
