"""The questions a pilot asks of a report, answered from the page alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frontend.keyframes import TOO_FEW
from frontend.views import SAME_PICTURE
from slam.core.flight import GeoOrigin
from slam.core.lost_pictures import SHOW_NOTHING
from slam.core.summary import summarise
from slam.report.answers import limit, limit_sentence, pilots_answers
from slam.report.facts import gather
from slam.report.optimize_report import render
from tests.slam.made_estimate import made_estimate, made_flight

SHARES = {"x": {"range": 0.7, "pictures": 0.3}, "y": {"range": 0.5, "pictures": 0.5}, "scale": {"range": 1.0}}


def answers(estimate, flight):
    found = pilots_answers(estimate, summarise(estimate), gather(estimate, flight))
    return {item.label: item.value for item in found}


def test_ten_questions_have_their_answers_on_the_page():
    estimate, flight = made_estimate(), made_flight()
    estimate = replace(estimate, information_shares=SHARES)
    found = answers(estimate, flight)
    assert len(found) == 10
    html = render(estimate, summarise(estimate), flight)
    assert all(question in html for question in found)
    assert limit_sentence(SHARES) in html


def test_the_limit_is_the_instrument_with_the_largest_share_of_both_axes():
    assert limit(SHARES) == ("range", pytest.approx(0.6))
    assert "height sensor" in limit_sentence(SHARES)
    assert limit({}) is None
    assert limit_sentence({}) == ""


def test_answers_follow_the_map():
    estimate, flight = made_estimate(), made_flight()
    assert answers(replace(estimate, status="ok"), flight)["Can I use this map?"].startswith("Yes")
    assert answers(replace(estimate, status="two parts"), flight)["Can I use this map?"].startswith("Only")
    no_loops = replace(estimate, loops=())
    assert "repeat an earlier part" in answers(no_loops, flight)["How do I make the next map better?"]
    assert answers(no_loops, flight)["Was a place recognised again?"].startswith("No")
    on_earth = replace(estimate, origin=GeoOrigin(52.1, 4.3, 10.0))
    assert "52.100000" in answers(on_earth, flight)["Where on Earth is it?"]
    no_metres = replace(estimate, metric=False, scale_std=None)
    assert answers(no_metres, flight)["How accurate is a distance on it?"].startswith("In metres not at all")
    unknown = replace(estimate, covariances=np.full_like(estimate.covariances, np.nan))
    assert answers(unknown, flight)["How accurate is a place on it?"].startswith("Not known")


def test_pictures_that_show_too_little_are_missing_ground():
    """All keyframes may have a place although a sixth of the pictures shows none."""
    estimate, flight = made_estimate(), made_flight()
    rejected = {
        TOO_FEW: estimate.frames // 6 + 1,
        "loop: too few matches": 7,
        "view of a floor point far off": 3,
    }
    found = answers(replace(estimate, rejected=rejected), flight)
    assert found["Is everything on it?"].startswith(f"No: {rejected[TOO_FEW]} of {estimate.frames} pictures")
    assert "7 matches of places (most often “too few matches”)" in found["What was left out?"]
    assert "3 single views" in found["What was left out?"]
    assert set(SHOW_NOTHING) == {TOO_FEW, SAME_PICTURE}


def test_an_instrument_that_nothing_checks_is_no_plain_yes():
    estimate, flight = replace(made_estimate(), status="ok"), made_flight()
    alone = replace(estimate, accuracy_basis="Lengths and their accuracy rest on one height sensor alone.")
    assert "no second instrument checks" in answers(alone, flight)["Can I use this map?"]
    assert "no second instrument checks" not in answers(estimate, flight)["Can I use this map?"]
