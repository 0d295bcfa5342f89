"""Velocities by neighbours: on strips, and at their ends, turns and pauses."""

import numpy as np
import pytest

from backend.measurements.straight_flight import continued_velocities, straight_velocities

STRIP = np.arange(6.0)[:, None] * [12.0, 5.0, 0.0]
STAMPS_S = 2.0 * np.arange(6)


def known(stamps_s: np.ndarray, place: np.ndarray) -> list[int]:
    return np.flatnonzero(np.isfinite(straight_velocities(stamps_s, place)).all(axis=1)).tolist()


def test_on_a_strip_the_velocity_is_that_between_both_neighbours():
    found = straight_velocities(STAMPS_S, STRIP)
    np.testing.assert_allclose(found[1:-1], [[6.0, 2.5, 0.0]] * 4)
    assert np.isnan(found[[0, -1]]).all()


def test_stamps_of_whole_seconds_belong_to_one_strip():
    assert known(np.floor(2.4 * np.arange(6)), STRIP) == [1, 2, 3, 4]


def test_at_a_turn_it_is_not_known():
    there_and_back = np.concatenate([STRIP, STRIP[::-1] + [0.0, 20.0, 0.0]])
    assert known(2.0 * np.arange(12), there_and_back) == [1, 2, 3, 4, 7, 8, 9, 10]


def test_after_a_pause_it_is_not_known():
    assert known(np.array([0.0, 2.0, 4.0, 30.0, 32.0, 34.0]), STRIP) == [1, 4]
    lacking = np.array([0, 1, 3, 4, 5])  # one photograph is missing
    assert known(STAMPS_S[lacking], STRIP[lacking]) == [1, 2, 3]


def test_where_the_vehicle_brakes_it_is_not_known():
    slower = np.array([0.0, 12.0, 24.0, 36.0, 40.0, 41.0])[:, None] * [1.0, 0.0, 0.0]
    assert known(STAMPS_S, slower) == [1, 2]


def test_a_vehicle_at_rest_has_none():
    assert known(STAMPS_S, np.zeros((6, 3))) == []


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_pictures_have_none(count: int):
    assert known(STAMPS_S[:count], STRIP[:count]) == []


def test_at_the_ends_of_strips_the_vehicle_may_fly_on():
    there_and_back = np.concatenate([STRIP, STRIP[::-1] + [0.0, 20.0, 0.0]])
    stamps_s = 2.0 * np.arange(12)
    velocity = straight_velocities(stamps_s, there_and_back)
    found = continued_velocities(stamps_s, there_and_back, velocity)
    np.testing.assert_allclose(found[:6], [[6.0, 2.5, 0.0]] * 6)
    np.testing.assert_allclose(found[6:], [[-6.0, -2.5, 0.0]] * 6)


def test_nothing_is_continued_without_a_strip():
    assert not continued_velocities(STAMPS_S, STRIP, np.full((6, 3), np.nan)).any()


def test_a_reported_velocity_across_the_strip_is_not_continued():
    velocity = np.full((6, 3), np.nan)
    velocity[2] = -2.5, 6.0, 0.0
    assert not continued_velocities(STAMPS_S, STRIP, velocity)[[1, 3]].any()
