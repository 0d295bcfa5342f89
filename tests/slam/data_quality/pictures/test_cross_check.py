"""Registrations that agree with no way round are not believed."""

from __future__ import annotations

import numpy as np

from frontend.camera import Camera
from slam.data_quality.pictures.cross_check import confirmed

CAMERA = Camera((140.8, 140.8), (87.5, 71.5), (176, 144))


def shift(x: float, y: float = 0.0) -> np.ndarray:
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def registrations(count: int = 9) -> dict[tuple[int, int], np.ndarray]:
    """A camera that goes on by 5 px a picture."""
    return {(j - step, j): shift(5.0 * step) for step in (1, 2, 4) for j in range(step, count)}


def test_right_ones_are_all_kept() -> None:
    right = registrations()
    assert confirmed(right, CAMERA) == set(right)


def test_a_wrong_one_is_not_and_its_halves_are() -> None:
    pairs = registrations()
    pairs[0, 4] = shift(20.0, 60.0)
    assert confirmed(pairs, CAMERA) == set(pairs) - {(0, 4)}


def test_a_wrong_neighbour_is_found_by_both_ways_over_it() -> None:
    pairs = registrations()
    pairs[3, 4] = shift(-40.0)
    kept = confirmed(pairs, CAMERA)
    assert (3, 4) not in kept
    assert {(2, 3), (4, 5)} <= kept


def test_an_unchecked_pair_is_accepted_only_between_neighbours() -> None:
    pairs = registrations()
    pairs[10, 11], pairs[20, 24] = shift(5.0), shift(20.0)
    kept = confirmed(pairs, CAMERA)
    assert (10, 11) in kept
    assert (20, 24) not in kept


def test_consistent_wrong_registrations_are_refuted_by_their_halves() -> None:
    """A floor that repeats: three pairs have the same wrong copy of it."""
    pairs = {(j - step, j): shift(5.0 * step) for step in (1, 2, 4, 8) for j in range(step, 17)}
    wrong = {(4, 8), (0, 8), (4, 12)}
    for i, j in wrong:
        pairs[i, j] = shift(5.0 * (j - i) + 80.0)
    assert confirmed(pairs, CAMERA) == set(pairs) - wrong
