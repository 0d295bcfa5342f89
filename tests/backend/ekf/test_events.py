"""Sorting of the readings: no instrument is forgotten on the way into the filter."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from backend.ekf.events import sort_events
from backend.ekf.inputs import READINGS, Readings, Series
from backend.ekf.readings import CHANNELS


def test_every_instrument_has_a_channel_and_the_other_way_round():
    assert sorted(READINGS.values()) == sorted(f.name for f in fields(Readings) if f.name != "steps")
    assert {*READINGS, "pictures"} == set(CHANNELS)


@pytest.mark.parametrize("channel", READINGS)
def test_the_readings_of_each_channel_become_events(channel):
    three = Series(np.array([0.1, 0.2, 0.3]), np.ones((3, 1)), np.ones(1))
    events = sort_events(Readings(**{READINGS[channel]: three}), np.array([0.4]), "none")
    assert (events.kind == CHANNELS[channel]).sum() == 3


def test_a_gap_of_a_day_takes_few_steps():
    two = Series(np.array([0.0, 10.0, 86_400.0]), np.ones((3, 1)), np.ones(1))
    events = sort_events(Readings(range_m=two), np.array([0.0]), "none")
    assert 1300 < len(events.kind) < 1500
    assert np.diff(events.stamps_s[events.stamps_s <= 10.0]).max() == pytest.approx(0.05)
