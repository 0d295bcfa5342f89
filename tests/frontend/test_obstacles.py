"""Things on an elevation map: where they are, how high and large, and which of two lists are the same."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.elevation import Elevation
from frontend.obstacles import Obstacle, ObstacleList, standing_on


def made(height: np.ndarray) -> Elevation:
    return Elevation(west_m=10.0, north_m=20.0, gsd_m=0.1, height_m=height.astype(np.float32))


def test_each_thing_has_place_height_and_area():
    height = np.full((60, 80), np.nan)
    height[5:, :] = 0.01
    height[20:30, 40:60] = 0.4
    height[20:22, 40:42] = 5.0  # four of 200 cells
    height[40:50, 10:15] = 0.2
    by_sonar = np.zeros(height.shape, bool)
    by_sonar[:, :20] = True
    found = standing_on(made(height), 0.06, {"pictures": ~by_sonar, "sonar": by_sonar})
    assert [one.measured_by for one in found.found] == [("pictures",), ("sonar",)]
    large, small = found.found
    assert (large.x_m, large.y_m) == pytest.approx((15.0, 17.5))
    assert (large.height_m, large.area_m2) == pytest.approx((0.4, 2.0))
    assert (small.x_m, small.y_m, small.height_m, small.area_m2) == pytest.approx((11.25, 15.5, 0.2, 0.5))
    assert found.by_pictures == (large,)


def test_what_is_lower_than_asked_for_or_less_wide_than_that_is_none():
    height = np.zeros((30, 30))
    height[5:15, 5:15] = 0.29
    height[20:22, 20:24] = 0.5  # 0.08 m2
    assert standing_on(made(height), 0.3, {}).found == ()
    assert len(standing_on(made(height), 0.25, {}).found) == 2


def test_two_lists_are_one_with_each_thing_once():
    """The discs of house and echo overlap, and the middle of neither lies in the other."""
    house, echo = Obstacle(0.0, 0.0, 3.0, 20.0, ("pictures",)), Obstacle(3.0, 0.5, 2.8, 4.0, ("sonar",))
    far = Obstacle(9.0, 0.0, 1.0, 30.0, ("sonar",))
    found = ObstacleList(0.1, (house,)).joined(ObstacleList(0.2, (far, echo)))
    assert found.above_m == 0.1
    assert [(one.x_m, one.measured_by) for one in found.found] == [
        (9.0, ("sonar",)),
        (0.0, ("pictures", "sonar")),
    ]
    assert found.found[1].height_m == 3.0


def scattered(count: int, by: str, seed: int) -> ObstacleList:
    """One large thing, and others that are denser where there are more."""
    rng, side_m = np.random.default_rng(seed), 30.0
    places, areas = rng.uniform(0, side_m, (count, 2)), rng.uniform(0.1, 1.0, count)
    areas[0] = 100.0
    found = [Obstacle(x, y, 1.0, area, (by,)) for (x, y), area in zip(places, areas, strict=True)]
    return ObstacleList(0.1, tuple(found))


def test_discs_of_any_size_are_the_same_where_they_overlap():
    ours, theirs = scattered(60, "pictures", 0), scattered(60, "sonar", 1)
    overlaps = [
        [np.hypot(a.x_m - b.x_m, a.y_m - b.y_m) < a.radius_m + b.radius_m for b in theirs.found]
        for a in ours.found
    ]
    by_both, of_theirs = np.any(overlaps, axis=1).sum(), np.any(overlaps, axis=0).sum()
    found = ours.joined(theirs).found
    assert sum(one.measured_by == ("pictures", "sonar") for one in found) == by_both > 10
    assert len(found) == 120 - of_theirs < 110


def test_a_list_meets_an_empty_one():
    some, none = scattered(3, "sonar", 2), ObstacleList(0.2, ())
    assert len(some.joined(none).found) == len(none.joined(some).found) == 3
    assert some.joined(none).above_m == none.joined(some).above_m == 0.1


def test_thousands_are_joined_without_comparing_each_with_each(monkeypatch):
    """Only pairs that are near each other are measured: some ten for each thing here."""
    compared = []
    monkeypatch.setattr(np, "hypot", lambda a, b: compared.append(len(a)) or (a**2 + b**2) ** 0.5)
    scattered(2000, "pictures", 3).joined(scattered(2000, "sonar", 4))
    assert 2000 < sum(compared) < 0.1 * 2000**2
