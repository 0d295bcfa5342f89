"""Parts of a chain without ranges, scaled to metres by the heights that the filter tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.pose_graph.heights import HeightEstimate
from slam.evaluation import evaluate
from slam.mapping.inertial.metres import scaled
from slam.mapping.map import Map
from slam.mapping.pipeline import optimize
from tests.benchmarks.instrument_flights import KINDS, flown
from tests.slam.mapping.made_map import made_map

RATIO = np.array([2.0, 2.0, 2.0, 0.5, 0.5, 0.5])


def in_heights() -> Map:
    """Two parts of three poses, one unit high and one apart."""
    w_T_b = np.tile(np.eye(4), (6, 1, 1))
    w_T_b[:, 0, 3], w_T_b[:, 2, 3] = [0, 1, 2, 0, 1, 2], 1.0
    chain = made_map(w_T_b, np.array([0, 0, 0, 1, 1, 1]))
    heights = HeightEstimate(np.ones(6), np.zeros(6), np.zeros(6, bool))
    edges = replace(chain.edges, heights=heights)
    return replace(chain, edges=edges, covariances=np.tile(0.01**2 * np.eye(6), (6, 1, 1)))


def test_each_part_gets_its_own_heights_and_the_error_of_its_scale():
    height_m = RATIO.copy()
    height_m[0] = np.nan  # before the readings begin
    found = scaled(in_heights(), height_m, np.full(6, 0.03), 0.04)
    assert found is not None
    assert found.w_T_b[:, 0, 3] == pytest.approx([0, 2, 4, 0, 0.5, 1])
    assert found.edges.heights.height_m == pytest.approx(RATIO)
    assert found.edges.heights.metric.all()
    std = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))
    assert std[:, 0] == pytest.approx(0.01)
    # 5 % of the way from the part's first pose, which 3 and 4 % make, besides a hundredth of a height.
    assert std[:, 3] == pytest.approx(RATIO * np.hypot(0.01, [0, 0.05, 0.1, 0, 0.05, 0.1]))


def test_a_part_without_a_known_height_cannot_be_scaled():
    assert scaled(in_heights(), np.where(RATIO < 1, np.nan, RATIO), np.zeros(6), 0.0) is None


@pytest.mark.slow
def test_without_ranges_a_look_alike_behind_a_gap_does_not_join_the_halves():
    """The floor repeats after 3.2 m; joined there, the map was 4 m off, and its covariances a centimetre."""
    flight = replace(flown(KINDS["gap of 5 s"], 1), sonar=None)
    estimate = optimize(flight)
    found = evaluate(estimate, flight)
    assert set(estimate.component.tolist()) == {0, 1}
    assert found.ate_m.max < 0.1
    assert found.loops.false_kept == 0
    assert found.nees.pose.mean < 12
