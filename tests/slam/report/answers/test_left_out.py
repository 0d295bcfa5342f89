"""Words for data that a map was made without."""

from dataclasses import replace

import pytest

from backend.measurements import CONTRADICTED, UNPROVEN, LinkCheck, Rejection
from slam.core.estimate import GroundFacts, LoopVerdict
from slam.core.summary import summarise
from slam.core.units import length
from slam.report.answers.left_out import left_out, reason_in_words
from slam.report.answers.left_out_here import left_out_here
from slam.report.facts import gather
from tests.slam.made_estimate import made_estimate, made_flight


def in_words(reason: str) -> str:
    return reason_in_words(Rejection.read(reason))


def test_lengths_of_a_reason_are_metres_once_they_are_known():
    of_map = Rejection.read("disagrees by 8.6 sigma (limit 4.7): 0.014 heights, 1.2 deg")
    assert reason_in_words(of_map, 50.0).endswith(f"{length(0.7)}, 1.2°)")
    searched = Rejection.read(
        "implausible: 0.27 heights from where the poses put it, at most 0.20 heights allowed"
    )
    told = reason_in_words(searched, 50.0)
    assert f"{length(13.5)} from where the poses put it, at most {length(10.0)} allowed" in told


def test_the_words_of_a_match_keep_all_figures_of_its_reason():
    out_of_reach = in_words("out of reach: 2.85 m apart by the poses so far, at most 1.91 m allowed")
    assert out_of_reach.endswith("(2.85 m apart by the poses so far, at most 1.91 m allowed)")
    before_metres = in_words("disagrees by 8.6 sigma (limit 4.7): 0.014 heights, 1.2 deg")
    assert before_metres.endswith("0.014 of the camera's height, 1.2°)"), (
        "no unit that the page does not define"
    )
    disagrees = in_words("disagrees by 8.6 sigma (limit 4.7): 0.14 m, 1.2 deg")
    assert disagrees.endswith("(8.6 standard deviations, limit 4.7: 0.14 m, 1.2°)")


@pytest.mark.parametrize(
    "check",
    [LinkCheck.GRAPH, LinkCheck.PLACE, LinkCheck.REACH, LinkCheck.CHAIN, LinkCheck.OVERLAP, LinkCheck.SCALE],
)
def test_a_match_that_the_map_contradicts_is_no_unproven_one(check):
    rejection = Rejection(check, "3.4 m")
    assert LoopVerdict(0, 9, rejection).finding == CONTRADICTED
    assert left_out({f"loop: {rejection.kind}": 2})[0].verdict == CONTRADICTED


@pytest.mark.parametrize(
    "check",
    [
        LinkCheck.TOO_FEW_INLIERS,
        LinkCheck.NO_PLANE,
        LinkCheck.OUTLIER_SHARE,
        LinkCheck.KNOWN_PLACE,
        LinkCheck.INFORMATION,
    ],
)
def test_a_match_that_shows_too_little_is_unproven(check):
    rejection = Rejection(check)
    assert LoopVerdict(0, 9, rejection).finding == UNPROVEN
    assert left_out({f"loop: {rejection.kind}": 2})[0].verdict == UNPROVEN
    assert left_out({"too few features": 2})[0].verdict == ""


@pytest.mark.parametrize(
    "reason",
    [
        "too few features", "same picture as the one before", "tracking started anew", "damaged",
        "unreadable", "view of a floor point far off", "too few matches", "too few inliers",
        "no plane fits the matches",
        "outlier share above gamma_1", "folded or no overlap", "implausible change of scale", "implausible",
        "inliers crowded in one place", "homography poorly determined", "loop: out of reach",
        "loop: disagrees", "late: it arrived while earlier pictures were processed",
        "loop: elsewhere than the pictures between",
        "loop: agrees, but too little is known of where it lies to trust it", "loop: too few matches",
        "edge without information", "edge disagrees with the rest of the graph", "line without an end",
    ],
)  # fmt: skip
def test_each_reason_has_plain_words_and_says_whether_to_act(reason):
    (row,) = left_out({reason: 5})
    assert not row.what.startswith("Left out")
    assert row.act.startswith(("No", "Only if", "Yes", "Look", "Write"))
    assert row.act.endswith(".")
    assert (row.reason, row.count) == (reason, 5)


def test_a_change_of_scale_is_no_place_that_the_map_excludes():
    (scale,), (place,) = (
        left_out({"loop: implausible change of scale": 1}),
        left_out({"loop: implausible": 1}),
    )
    assert "scales" in scale.what
    assert "the rest of the map" in place.what


def test_what_may_need_an_action_comes_first():
    rows = left_out({"loop: too few inliers": 90, "damaged": 1, "too few features": 20})
    assert [row.count for row in rows] == [1, 20, 90], "what is certain stands before what depends"
    assert left_out({"a new reason": 1})[0].what == "Left out: a new reason"


def test_reasons_that_are_the_same_in_plain_words_are_one_row():
    rows = left_out({"loop: too few inliers": 2, "loop: too few matches": 3, "too few matches": 4})
    assert sorted((row.kind, row.count) for row in rows) == [("link", 4), ("match", 5)]


@pytest.mark.parametrize(
    ("shift_px", "act"), [(0.9, "No: the map does not use them, and at the seams"), (3.0, "Only if you see")]
)
def test_advice_for_a_case_says_which_case_the_map_is(shift_px, act):
    ground = GroundFacts(misregistration_px=(0.1, shift_px), over_floor_px=(0.1, shift_px))
    rejected = {"loop: disagrees": 3, "too few features": 1, "tracking started anew": 1}
    estimate = replace(made_estimate(), ground=ground, rejected=rejected)
    rows = left_out_here(estimate, gather(estimate, made_flight()), summarise(estimate))
    acts = {row.reason: row.act for row in rows}
    assert acts["loop: disagrees"].startswith(act)
    assert acts["too few features"] == "No: no stretch of the path is without other pictures."
    assert acts["tracking started anew"].startswith("No: the map is in one piece")


def test_brackets_within_a_reason_are_no_brackets_within_brackets():
    told = in_words(
        "agrees, but too little is known of where it lies to trust it: 3.1 sigma (each 1.4 of one)"
    )
    assert told.endswith("(3.1 standard deviations, each 1.4 of one)")
