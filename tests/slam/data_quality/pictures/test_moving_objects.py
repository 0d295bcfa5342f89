"""What moves over the floor is seen to, and what only stands on it is not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slam.criticism.kalman.record import record_of
from slam.criticism.residuals.reading_anomalies import _moving_objects
from slam.data_quality.pictures.moving_objects import _moves_apart
from tests.slam.criticism.camera.camera_flight import matched_flight


def found(terms, seed):
    """Oddities of one flight, and how many of its pictures show one."""
    flight, matches = matched_flight(terms, seed)
    return _moving_objects([replace(record_of(flight), matches=matches)]), len(matches.moving_s)


@pytest.mark.slow
def test_things_that_go_through_the_pictures_are_moving_objects():
    (oddity,), pictures = found({"moving_objects": {"count": 40.0}}, 5)
    assert oddity.name == "moving_objects"
    assert oddity.parameters["count"].value >= 1.0
    assert 3 <= pictures < 40
    assert oddity.probability > 0.95


@pytest.mark.parametrize(
    "terms", [{}, pytest.param({"floor_steps": {"height": 0.2, "share": 0.15}}, marks=pytest.mark.slow)]
)
def test_a_floor_is_not_whatever_stands_on_it(terms):
    assert found(terms, 6)[0] == []


def test_pictures_by_themselves_are_accidents():
    flight, matches = matched_flight({}, 6)
    record = record_of(flight)
    alone = replace(record, matches=replace(matches, moving_s=np.array([1.0, 4.0, 4.2, 8.0])))
    assert _moving_objects([alone]) == []
    together = replace(record, matches=replace(matches, moving_s=np.array([1.0, 4.0, 4.2, 4.5, 8.0])))
    assert [o.name for o in _moving_objects([together])] == ["moving_objects"]


def test_what_goes_with_the_camera_is_on_the_lens():
    """Laid over each other, pictures that moved over the floor show dirt to go back by the same."""
    rows, columns = np.mgrid[:30, :40].astype(np.float32)
    was_px = np.dstack([columns, rows])
    laid = SimpleNamespace(was_px=was_px, is_px=was_px + np.float32([6.0, 2.0]))

    def odd(*flow_px: float) -> bool:
        off = _moves_apart(np.full((30, 40, 2), flow_px, np.float32), laid, 1.0)
        assert off.all() == off.any()
        return bool(off.all())

    assert not odd(-6.0, -2.0)
    assert not odd(-6.4, -2.3)
    assert not odd(-3.0, -1.0)
    assert odd(-9.0, -3.0)
    assert odd(2.0, -6.0)
