"""A pose graph keyframe by keyframe: the batch's answer in the end, and what was known before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.measurements import Measurements
from slam.evaluation.keyframe_by_keyframe import KeyframeByKeyframe, replay
from slam.report.tables.evaluation import keyframe_by_keyframe_table
from tests.backend.pose_graph.incremental.test_inertial_link import flown
from tests.backend.synthetic import falsified, flight


def test_the_end_is_that_of_the_batch_and_the_way_to_it_is_not():
    """Half of the flight is odometry alone: until the loops come, keyframes lie where it has drifted to."""
    found = replay(flight(1, n=40, loops=10).measurements, budget_s=np.inf)
    assert found.rejected_in_flight == found.rejected_by_batch == 0
    assert found.settled < 1e-3 < found.when_added
    assert found.in_flight < found.when_added
    assert (len(found.seconds), found.loops) == (40, 10)


@pytest.mark.slow  # the graph by itself: tests/backend/pose_graph/test_incremental.py
def test_false_loops_are_rejected_in_flight_too():
    made, false = falsified(flight(6, n=40, loops=12), 4, seed=1)
    found = replay(made.measurements, budget_s=np.inf)
    assert found.rejected_in_flight >= np.count_nonzero(false)
    assert found.rejected_by_batch >= np.count_nonzero(false)
    assert found.waiting == 0
    assert found.settled < 1e-3


def test_a_keyframe_waits_for_an_edge_to_an_earlier_one():
    """Keyframe 10 is joined to keyframe 30 alone, and keyframe 35 to none."""
    measured = flight(2, n=36, loops=0).measurements
    edges = [e for e in measured.relative_poses if not {10, 35} & {e.i, e.j}]
    bridge = replace(measured.relative_poses[8], i=9, j=11)
    late = replace(measured.relative_poses[8], i=10, j=30)
    found = replay(replace(measured, relative_poses=(*edges, bridge, late)))
    assert len(found.seconds) == 35
    assert found.settled < 1e-3


@pytest.mark.parametrize("gyro_turned", [False, True])
def test_readings_of_an_imu_join_what_lies_behind_a_gap_unless_they_contradict_the_pictures(gyro_turned):
    made = flown(5, gyro_turned)
    found = replay(made.measurements)
    whole = len(made.truth)
    assert (found.bridged, len(found.seconds)) == ((0, made.gap + 1) if gyro_turned else (1, whole))
    assert found.settled < 0.05


def test_the_table_names_the_unit():
    found: KeyframeByKeyframe = replay(without_heights(flight(3, n=8, loops=1).measurements))
    shown = keyframe_by_keyframe_table(found)
    assert all(len(row) == 2 for row in shown.rows)
    assert "heights" in shown.rows[-1][1]


def without_heights(measured: Measurements) -> Measurements:
    return replace(measured, ranges=(), length_unit="heights")
