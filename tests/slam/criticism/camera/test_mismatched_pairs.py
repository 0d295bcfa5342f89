"""Pairs of pictures that show another place than the vehicle can have been at are left out and reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.camera.reprojection import without_mismatched_pairs
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import referred
from slam.criticism.kalman.record import Record
from slam.criticism.prepare import usable_records
from slam.simulation.camera.optics import CameraModel
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

NOMINAL = load_model("nominal")


@pytest.fixture(scope="module")
def record() -> Record:
    flight = simulate_flight(
        NOMINAL, stick_for(["yaw on the spot while climbing"]), 2, camera=CameraModel(rate_hz=4.0)
    )
    ((record,), _) = usable_records([flight])
    return referred(record, filter_parameters_of(NOMINAL))


def displaced(record: Record, pairs: list[tuple[int, int]], by_px: float) -> Record:
    """Some pairs matched with another place."""
    matches = record.matches
    pixel = matches.pixel_i.copy()
    for i, j in pairs:
        pixel[(matches.earlier == i) & (matches.later == j), 0] += by_px
    return replace(record, matches=replace(matches, pixel_i=pixel))


def pairs_of(record: Record) -> list[tuple[int, int]]:
    return sorted(set(zip(record.matches.earlier.tolist(), record.matches.later.tolist(), strict=True)))


def test_a_healthy_flight_keeps_all(record: Record) -> None:
    kept, reported = without_mismatched_pairs(record, filter_parameters_of(NOMINAL))
    assert kept is record
    assert reported == ""


def test_a_pair_with_an_error_of_half_a_picture_is_left_out_and_reported(record: Record) -> None:
    pairs = pairs_of(record)
    wrong = pairs[len(pairs) // 2 :: len(pairs) // 3][:2]
    kept, reported = without_mismatched_pairs(displaced(record, wrong, 88.0), filter_parameters_of(NOMINAL))
    assert set(pairs_of(kept)) == set(pairs) - set(wrong)
    assert f": {len(wrong)} of " in reported
    assert len(kept.matches.pixel_i) == len(kept.matches.tone_j) == len(kept.matches.later)


def test_what_a_bad_camera_makes_is_left_to_be_judged(record: Record) -> None:
    pairs = pairs_of(record)
    off = displaced(record, pairs[::3], 15.0)
    assert without_mismatched_pairs(off, filter_parameters_of(NOMINAL))[0] is off


def test_where_most_are_off_none_is_left_out(record: Record) -> None:
    off = displaced(record, pairs_of(record)[::2], 88.0)
    kept, reported = without_mismatched_pairs(off, filter_parameters_of(NOMINAL))
    assert kept is off
    assert np.array_equal(kept.matches.pixel_i, off.matches.pixel_i)
    assert reported == ""
