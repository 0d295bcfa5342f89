"""Landmarks on, and scale bar and directions below the picture of a mosaic."""

from __future__ import annotations

import numpy as np
import pytest

from slam.report.pictures.mosaic_marks import Mark, bar_length, with_marks, with_points


@pytest.mark.parametrize(("longest", "bar"), [(3.0, 2.0), (0.99, 0.5), (5.0, 5.0), (73.0, 50.0), (1.0, 1.0)])
def test_a_bar_has_a_round_length_that_fits(longest, bar):
    assert bar_length(longest) == pytest.approx(bar)


@pytest.mark.parametrize("width", [300, 900, 2000])
@pytest.mark.parametrize("shape", [(), (3,)])
def test_the_bar_is_as_long_as_it_says(width, shape):
    """The longest dark run of the strip, without its thickness, is the bar."""
    picture, pixel_m = np.zeros((200, width, *shape), np.uint8), 0.0137
    marked = with_marks(picture, pixel_m, "m", on_earth=False)
    assert (marked[:200] == 0).all()
    dark = (marked[200:, : width // 2] < 128).all(axis=2)
    runs = [len(run) for row in dark for run in "".join(".#"[int(x)] for x in row).split(".")]
    bar = bar_length(0.3 * width * pixel_m) / pixel_m
    assert max(runs) == pytest.approx(bar, abs=2 + width / 100)


def test_the_arrows_are_east_and_north_on_earth():
    picture = np.zeros((100, 800, 3), np.uint8)
    local, earth = (with_marks(picture, 0.1, "m", on_earth=on_earth) for on_earth in (False, True))
    assert (local[100:, :400] == earth[100:, :400]).all()
    assert (local[100:, 400:] != earth[100:, 400:]).any()


@pytest.mark.parametrize("surveyed", [False, True])
def test_a_point_is_where_its_coordinates_say(surveyed):
    picture = np.full((300, 500, 3), 128, np.uint8)
    marked = with_points(picture, 0.01, (2.0, 7.0), [Mark("A", 4.0, 5.5, surveyed)])
    rows, cols = np.nonzero((marked != 128).any(axis=2))
    assert (marked[150, 200] == 128).all(), "the mark leaves its middle free"
    ring = rows[cols < 200]  # the name stands at the right
    assert (ring.min() + ring.max()) / 2 == pytest.approx(150, abs=3 if surveyed else 1), (
        "the middle of a triangle is nearer its base"
    )
    assert cols.min() == pytest.approx(200, abs=15)
    assert (picture == 128).all()


def test_a_name_that_would_be_cut_off_stands_at_the_left():
    picture = np.full((300, 500, 3), 128, np.uint8)
    names = [Mark("long name", 4.9, 1.5, True), Mark("long name", 0.1, 1.5, True)]
    at_right, at_left = (with_points(picture, 0.01, (0.0, 3.0), [mark]) != 128 for mark in names)
    assert np.count_nonzero(at_right[:, :480]) == pytest.approx(np.count_nonzero(at_left[:, 20:]), rel=0.1)


def test_names_of_marks_side_by_side_do_not_cover_each_other():
    """Each of two marks near each other adds as much ink as it has alone."""
    picture = np.full((300, 500, 3), 128, np.uint8)
    a, b = Mark("A", 2.5, 1.5), Mark("B", 2.7, 1.58)
    alone = [np.count_nonzero(with_points(picture, 0.01, (0.0, 3.0), [mark]) != 128) for mark in (a, b)]
    both = np.count_nonzero(with_points(picture, 0.01, (0.0, 3.0), [a, b]) != 128)
    assert both == pytest.approx(sum(alone), rel=0.05)


def test_a_picture_has_coordinates_at_its_edges():
    """Ticks stand at round places: here x = 0, 0.5 to 2 and y = 1 to 2 of a picture of 2.5 x 2 m."""
    pixels = np.full((400, 500, 3), 200, np.uint8)
    marked = with_marks(pixels, 0.005, "m", False, (-0.25, 2.5))
    left = marked.shape[1] - 500
    assert left > 0
    below = marked[402:404].min(axis=(0, 2))
    ticks = np.flatnonzero(below[left + 5 : left + 495] < 100) + 5
    for x in (0.0, 0.5, 1.0, 1.5, 2.0):
        assert np.abs(ticks - (x + 0.25) / 0.005).min() <= 1
    beside = marked[:395, left - 3].min(axis=1)
    for y in (1.0, 1.5, 2.0):
        assert np.abs(np.flatnonzero(beside < 100) - (2.5 - y) / 0.005).min() <= 1


def test_rings_that_would_cover_each_other_are_drawn_smaller():
    pixels = np.full((1000, 1000, 3), 200, np.uint8)
    apart, crowded = (
        with_points(pixels, 0.01, (0.0, 10.0), [Mark("A", 5.0, 5.0), Mark("E", 5.0 + d, 5.0)])
        for d in (3.0, 0.2)
    )
    black = [(marked < 60).all(axis=2).sum() for marked in (apart, crowded)]
    assert black[1] < 0.6 * black[0]
