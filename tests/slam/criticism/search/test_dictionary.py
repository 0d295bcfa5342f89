"""Shapes: what acts ahead acts to the left as well, unless it minds which way is ahead."""

from __future__ import annotations

from slam.criticism.healthy import flown
from slam.criticism.kalman.record import record_of
from slam.criticism.manoeuvres import stick_for
from slam.criticism.search.dictionary import LEVEL_SIGNALS, LEVEL_TARGETS, dictionary, shapes_of
from slam.simulation.model import load_model


def test_each_direction_has_its_shape_and_level_ones_one_together():
    flight = flown(load_model("nominal"), stick_for(["yaw on the spot while climbing"]), 1)
    directions = dictionary([record_of(flight)])
    shapes = shapes_of(directions)
    names = {d.name for d in directions}
    alone = [s for s in shapes if len(s.columns) == 1]
    together = [s for s in shapes if len(s.columns) == 2]
    assert {s.name for s in alone} == names
    assert len(alone) + len(together) == len(shapes)
    # Sticks are not led into instruments.
    assert len(together) == len(LEVEL_TARGETS) * len(LEVEL_SIGNALS) - 4
    assert all(set(s.columns) <= names for s in together)
    assert len({s.name for s in shapes}) == len(shapes)
    # One column ahead, the other to the left, of the same kind.
    columns = {s.columns for s in together}
    assert ("force ahead ~ pitch", "force left ~ roll") in columns
    assert ("gyro_y ~ ahead", "gyro_x ~ left") in columns
    assert not any(s.columns[0] == s.columns[1] for s in together)
