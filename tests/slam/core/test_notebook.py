"""Estimates, flights and criticisms print as one line; notebooks show a small table and the trajectory."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from slam.core.flight import Flight
from slam.core.notebook import trajectory_svg
from slam.core.streams import Sonar
from slam.criticism.verdict.criticism import Criticism
from tests.slam.made_estimate import made_estimate

FLIGHT = Flight("pond", sonar=Sonar(np.arange(50) / 10, np.ones(50)))


def test_each_repr_is_one_short_line():
    estimate = replace(made_estimate(), name="two\nlines")
    for value in (estimate, FLIGHT, Criticism("unusable", "Nothing to judge.")):
        assert "\n" not in repr(value)
        assert 20 < len(repr(value)) < 300
        assert repr(value).startswith(type(value).__name__)


def test_the_html_of_an_estimate_is_small_and_shows_every_loop():
    estimate = replace(made_estimate(), name="<eight>")
    html = estimate._repr_html_()
    assert len(html) < 20_000
    assert "&lt;eight&gt;" in html
    tree = ElementTree.fromstring(f"<div>{html}</div>")
    svg = next(child for child in tree if child.tag.endswith("svg"))
    chords = next(child for child in svg if child.tag.endswith("path")).attrib["d"]
    route = next(child for child in svg if child.tag.endswith("polyline")).attrib["points"]
    kept = [loop for loop in estimate.loops if loop.verdict == "kept"]
    assert chords.count("M") == sum(estimate.placed[loop.i] and estimate.placed[loop.j] for loop in kept)
    assert len(route.split()) == estimate.placed.sum()


def test_the_html_of_a_flight_names_its_streams():
    html = FLIGHT._repr_html_()
    assert "sonar0" in html
    assert len(html) < 5_000
    ElementTree.fromstring(html)
    assert "warnings" in Flight("nothing")._repr_html_()


@pytest.mark.parametrize("count", [1, 5, 20_000])
def test_a_long_trajectory_stays_a_small_picture_within_its_frame(count):
    angle = np.linspace(0, 2 * np.pi, count)
    xy = np.column_stack([3 * np.cos(angle), np.sin(angle)])
    loops = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    svg = trajectory_svg(xy, loops)
    assert len(svg) < 12_000
    tree = ElementTree.fromstring(svg)
    points = next(child for child in tree if child.tag.endswith("polyline")).attrib["points"]
    drawn = np.array([point.split(",") for point in points.split()], dtype=float)
    assert drawn.min() >= 0
    assert (drawn <= [float(tree.attrib["width"]), float(tree.attrib["height"])]).all()


def test_nothing_is_drawn_where_nothing_is_placed():
    assert trajectory_svg(np.full((3, 2), np.nan), np.zeros((0, 2), np.int64)) == ""
