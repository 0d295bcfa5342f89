"""Pairs of pictures that show another place than the vehicle can have been at are left out and told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.camera.strays import without_strays
from slam.criticism.flight_checks import usable_records
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.reference import referred
from slam.criticism.kalman.setting import setting_of
from slam.criticism.manoeuvres import stick_for
from slam.criticism.simulated_flights import simulate_flight
from slam.simulation.camera.optics import CameraModel
from slam.simulation.model import load_model

NOMINAL = load_model("nominal")


@pytest.fixture(scope="module")
def record() -> Record:
    flight = simulate_flight(
        NOMINAL, stick_for(["yaw on the spot while climbing"]), 2, camera=CameraModel(rate_hz=4.0)
    )
    ((record,), _) = usable_records([flight])
    return referred(record, setting_of(NOMINAL))


def displaced(record: Record, pairs: list[tuple[int, int]], by_px: float) -> Record:
    """Some pairs matched with another place."""
    sights = record.sights
    pixel = sights.pixel_i.copy()
    for i, j in pairs:
        pixel[(sights.earlier == i) & (sights.later == j), 0] += by_px
    return replace(record, sights=replace(sights, pixel_i=pixel))


def pairs_of(record: Record) -> list[tuple[int, int]]:
    return sorted(set(zip(record.sights.earlier.tolist(), record.sights.later.tolist(), strict=True)))


def test_a_healthy_flight_keeps_all(record: Record) -> None:
    kept, told = without_strays(record, setting_of(NOMINAL))
    assert kept is record
    assert told == ""


def test_what_is_half_a_picture_off_is_left_out_and_told(record: Record) -> None:
    pairs = pairs_of(record)
    wrong = pairs[len(pairs) // 2 :: len(pairs) // 3][:2]
    kept, told = without_strays(displaced(record, wrong, 88.0), setting_of(NOMINAL))
    assert set(pairs_of(kept)) == set(pairs) - set(wrong)
    assert f": {len(wrong)} of " in told
    assert len(kept.sights.pixel_i) == len(kept.sights.tone_j) == len(kept.sights.later)


def test_what_a_bad_camera_makes_is_left_to_be_judged(record: Record) -> None:
    pairs = pairs_of(record)
    off = displaced(record, pairs[::3], 15.0)
    assert without_strays(off, setting_of(NOMINAL))[0] is off


def test_where_most_are_off_none_is_left_out(record: Record) -> None:
    off = displaced(record, pairs_of(record)[::2], 88.0)
    kept, told = without_strays(off, setting_of(NOMINAL))
    assert kept is off
    assert np.array_equal(kept.sights.pixel_i, off.sights.pixel_i)
    assert told == ""
