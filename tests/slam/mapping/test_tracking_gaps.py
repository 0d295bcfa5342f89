"""The first picture behind a stretch without features may match the last one before it a tile off."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from backend.measurements import LinkCheck, Rejection, RelativePose
from frontend.registration import Registration
from frontend.store import FeatureStore
from frontend.tracked import IntermediateFrame
from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.mapping.front_end import Observations
from slam.mapping.pipeline import optimize
from slam.mapping.tracking_gaps import contradicted, remove_links, tracking_gaps
from tests.slam.small_flight import flown, seeing

GREY = np.full((144, 176, 3), 120, np.uint8)
TILE_M, SPEED_M_S, BEGIN_S = 0.8, 0.5, 4.0


def over_a_floor(tiles: float) -> Flight:
    """Straight on over one tile again and again, so many of them blind."""
    flight = flown(
        maneuver={"way_points": [[0.3, 0.3], [4.3, 0.3]], "cruise_m_s": SPEED_M_S},
        landmarks={"A": [0.3, 0.3], "B": [4.3, 0.3]},
        world={"extent_m": [0, 0, 4.8, 1.6], "tile_m": TILE_M, "repeat": True, "mark_diameter_m": 0.0},
    )
    end_s = BEGIN_S + tiles * TILE_M / SPEED_M_S
    stamps_s, load = flight.frames.stamps_s, flight.frames.load
    blind = seeing(flight, lambda k: GREY if BEGIN_S <= stamps_s[k] < end_s else load(k))
    return replace(blind, velocity=replace(flight.velocity, scale_std=0.0))


@pytest.mark.slow
@pytest.mark.parametrize("tiles", [0.8, 1.0])
def test_a_floor_that_repeats_does_not_shorten_the_way_over_a_break(tiles: float):
    """A whole tile on, the first pictures pass for a hover over the last keyframe."""
    flight = over_a_floor(tiles)
    estimate = optimize(flight)
    found = evaluate(estimate, flight)
    # 80 cm, and a NEES beyond 20 000, before the instruments were asked.
    assert found.ate_m.max < 0.05
    assert found.nees.pose.mean < 12
    assert [edge.kind for edge in estimate.relative_poses].count("inertial") == 1


def observations(break_s: float, rate_hz: float = 10.0, passed_s: float | None = None) -> Observations:
    """Three keyframes, a second apart and ``break_s`` later; a picture between the last two at ``passed_s``
    before the third."""
    stamps_s = np.arange(100) / rate_hz
    third = 10 + round(break_s * rate_hz)
    index = np.array([0, 10, third])
    matches = np.zeros((30, 2), np.int32)
    links = (
        None,
        *(Registration(k, k + 1, None, matches, np.eye(3), np.eye(8), 0.2, 0.5) for k in range(2)),
    )
    between = [IntermediateFrame(k, 0, np.eye(3), np.eye(8)) for k in range(1, 10)]
    if passed_s is not None:
        between.append(IntermediateFrame(third - round(passed_s * rate_hz), 1, np.eye(3), np.eye(8)))
    return Observations(
        FeatureStore(), index, stamps_s[index], links, links[1:], (), 100, Counter(),
        frame_stamps_s=stamps_s, passed=tuple(between),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("given", "before"),
    [
        (observations(2.0), [10]),
        (observations(0.4), []),
        (observations(2.0, passed_s=0.3), [10]),
        (observations(2.0, passed_s=1.6), [14]),
        (observations(0.9, passed_s=0.45), []),
        (observations(2.0, rate_hz=1.0), []),
    ],
    ids=["blind", "a moment", "seen behind it", "seen before it", "seen within", "one picture a second"],
)
def test_a_break_is_a_long_time_without_a_picture(given: Observations, before: list[int]):
    found = tracking_gaps(given)
    assert [broken.before for broken in found] == before
    assert all(broken.pair == (1, 2) for broken in found)


def test_a_link_is_refuted_by_more_than_both_are_uncertain_by():
    (broken,) = tracking_gaps(observations(2.0))
    way = RelativePose(1, 2, np.eye(4), 0.1**2 * np.eye(6), "inertial")
    near, far = (replace(way, i_T_j=np.eye(4), kind="odometry") for _ in range(2))
    near.i_T_j[0, 3], far.i_T_j[0, 3] = 0.3, 0.9
    assert not contradicted([broken], [near], [way])
    assert list(contradicted([broken], [far], [way])) == [broken]
    assert not contradicted([broken], [far], [replace(way, covariance=0.5**2 * np.eye(6))])
    assert not contradicted([broken], [far], [])


def test_behind_a_refuted_link_tracking_starts_anew():
    given = observations(2.0, passed_s=0.3)
    (broken,) = tracking_gaps(given)
    without = remove_links(given, {broken: Rejection(LinkCheck.PLACE)})
    assert without.links == (None, given.links[1], None)
    assert without.registrations == given.links[1:2]
    assert [refused.reason for refused in without.refused] == [Rejection(LinkCheck.PLACE)]
    assert without.passed == given.passed[:-1]
    assert remove_links(given, {}) == given
