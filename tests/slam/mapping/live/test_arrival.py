"""A flight folder that grows: which pictures are given, at which times, and what is said about the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.streams import Frames, Sonar
from slam.mapping.live.arrival import follow_flight, replay_flight

EPOCH_NS = 1_600_000_000_000_000_000
IDLE_S = 0.25


class Given:
    """It stands in for `LiveMapper`: the pictures, their times, and the last state of the flight."""

    def __init__(self) -> None:
        self.pictures: list[tuple[int, float]] = []
        self.flight: Flight | None = None

    def add(self, image: np.ndarray, stamp_s: float, wait: bool = False) -> None:
        assert not self.pictures or stamp_s > self.pictures[-1][1]
        self.pictures.append((int(image[0, 0]), stamp_s))

    def skip(self, stamp_s: float) -> None:
        pass

    def refresh(self, flight: Flight) -> None:
        self.flight = flight


def state(numbers: Sequence[int], first: int = 0) -> Flight:
    """Return a flight with some of the pictures, one a second, whose epoch is the stamp of number ``first``.

    Its sonar has all readings.
    """
    stamps_s = np.array(sorted(numbers), dtype=float) - first

    def load(k: int) -> np.ndarray:
        return np.full((2, 2), sorted(numbers)[k], np.uint8)

    sonar = Sonar(np.arange(20.0) - first, 1.0 + 0.1 * np.arange(20.0))
    frames = Frames(stamps_s, tuple(f"{number}.png" for number in sorted(numbers)), load)
    return Flight("grown", epoch_ns=EPOCH_NS + first * 10**9, frames=frames, sonar=sonar)


def follow(*states: Flight | InputError) -> Given:
    given, looks = Given(), iter(states)
    now: list[Flight | InputError] = []

    def read() -> Flight:
        now[:] = [next(looks, *now)]
        if isinstance(now[0], InputError):
            raise now[0]
        return now[0]

    follow_flight(given, read, IDLE_S)
    return given


def test_pictures_are_given_once_in_order():
    given = follow(state(range(3)), state(range(3)), state(range(5)))
    assert given.pictures == [(k, float(k)) for k in range(5)]
    assert given.flight.warnings == ()


def test_a_picture_whose_row_comes_late_is_left_out_and_counted():
    given = follow(state([0, 1, 2, 4]), state([0, 1, 2, 3, 4, 5]), state([0, 1, 2, 3, 4, 5, 6]))
    assert given.pictures == [(k, float(k)) for k in (0, 1, 2, 4, 5, 6)]
    (line,) = given.flight.warnings
    assert "1 picture came after one of a later time and was left out" in line


def test_a_table_that_is_started_anew_is_followed_on_the_clock_of_the_first():
    """The epoch of the second state is a later one, as its first picture is."""
    given = follow(state(range(6)), state(range(6, 9), first=6))
    assert given.pictures == [(k, float(k)) for k in range(9)]
    assert given.flight.epoch_ns == EPOCH_NS
    assert given.flight.sonar.stamps_s == pytest.approx(np.arange(20.0))
    (line,) = given.flight.warnings
    assert "6 pictures that were mapped are no longer in it" in line


def test_a_state_that_cannot_be_read_is_waited_for():
    given = follow(state(range(3)), InputError("data.csv does not exist"), state(range(5)))
    assert [number for number, _ in given.pictures] == list(range(5))
    assert given.flight.warnings == ()
    given = follow(state(range(3)), InputError("data.csv does not exist"))
    assert [number for number, _ in given.pictures] == list(range(3))
    assert any("data.csv does not exist" in line for line in given.flight.warnings)


def test_a_flight_that_is_ended_keeps_what_was_given():
    given = Given()
    follow_flight(given, lambda: state(range(9)), 600.0, is_ended=lambda: len(given.pictures) == 4)
    replayed = Given()
    replay_flight(replayed, state(range(9)), 100.0, is_ended=lambda: len(replayed.pictures) == 4)
    for each in (given, replayed):
        assert [number for number, _ in each.pictures] == [0, 1, 2, 3]
