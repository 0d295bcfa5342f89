"""What moves over the floor is seen to, and what only stands on it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.camera.pictures import look
from slam.criticism.kalman.record import record_of
from slam.criticism.residuals.oddities import _movers
from tests.slam.criticism.camera.seen_flight import seen_flight


def found(terms, seed):
    """Oddities of one flight, and how many of its pictures show one."""
    flight = seen_flight(terms, seed)
    sights = look(flight)
    assert sights is not None
    return _movers([replace(record_of(flight), sights=sights)]), len(sights.moving_s)


def test_things_that_go_through_the_pictures_are_moving_objects():
    (oddity,), pictures = found({"moving_objects": {"count": 40.0}}, 5)
    assert oddity.name == "moving_objects"
    assert oddity.parameters["count"].value >= 1.0
    assert 3 <= pictures < 40
    assert oddity.cause().probability > 0.95


@pytest.mark.parametrize(
    "terms", [{}, pytest.param({"floor_steps": {"height": 0.2, "share": 0.15}}, marks=pytest.mark.slow)]
)
def test_a_floor_is_not_whatever_stands_on_it(terms):
    assert found(terms, 6)[0] == []


def test_pictures_by_themselves_are_accidents():
    flight = seen_flight({}, 7)
    sights = look(flight)
    assert sights is not None
    record = record_of(flight)
    alone = replace(record, sights=replace(sights, moving_s=np.array([1.0, 4.0, 4.2, 8.0])))
    assert _movers([alone]) == []
    together = replace(record, sights=replace(sights, moving_s=np.array([1.0, 4.0, 4.2, 4.5, 8.0])))
    assert [o.name for o in _movers([together])] == ["moving_objects"]
