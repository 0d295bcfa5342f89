"""What a map lacks: what failed, and which ground is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from frontend.camera import Camera
from frontend.keyframes import TOO_FEW
from frontend.views import SAME_PICTURE
from slam.core.estimate import GroundFacts
from slam.core.instrument_errors import AttitudeErrors
from slam.core.lost_pictures import REDUNDANT, SHOW_NOTHING, TRACKING_LOST
from slam.core.messages import reason
from slam.core.summary import summarise
from slam.core.units import length
from slam.report.answers.headline import sentence
from slam.report.answers.questions import pilots_answers
from slam.report.facts import gather
from slam.report.gaps import gaps
from slam.report.mosaic_facts import MosaicFacts
from tests.slam.made_estimate import made_estimate, made_flight, saying
from tests.slam.report.answers.asked import answers


def test_what_failed_is_told():
    estimate, flight = replace(made_estimate(), messages=()), made_flight()
    purpose, none = "What was left out (below) was left out on purpose.", "No instrument is doubted."
    assert answers(estimate, flight)["What failed?"] == f"Nothing. {none} {purpose}"
    assert answers(replace(estimate, rejected={}), flight)["What failed?"] == f"Nothing. {none}"
    noted = saying(estimate, "attitude0 is tilted by 4.8 degrees")
    found = answers(noted, flight)["What failed?"]
    assert found.startswith("No part of the map, but a warning below doubts an instrument.")
    assert "The attitude sensor (roll, pitch and heading) is tilted by 4.8 degrees." in found
    off = AttitudeErrors((0.08, 0.06), (0.01, 0.01), 0.1, 0.1, None)
    known = replace(noted, instruments=replace(estimate.instruments, attitude=off))
    told = answers(known, flight)["What failed?"]
    assert (
        "The map trusts its roll and pitch no better than to 5.7°, their mean difference from the map."
        in told
    )
    bare = replace(estimate, frames=100, rejected={SHOW_NOTHING[1]: 60})
    assert answers(bare, flight)["What failed?"].startswith(
        "60 of 100 pictures showed too little to be used."
    )
    other = saying(estimate, "one picture is damaged")
    told = answers(other, flight)["What failed?"]
    assert told == f"Nothing; the warnings name what to check. {none} {purpose}"
    question = "How accurate is a place on it?"
    assert "does not count" not in answers(noted, flight)[question]
    assert (
        "does not count what “Check this first” above"
        in answers(saying(noted, reasons=("x",)), flight)[question]
    )
    lost = replace(
        estimate,
        messages=(reason("two parts"),),
        rejected={TRACKING_LOST: 2},
        not_drawn={"a.png": "why", "b.png": REDUNDANT},
    )
    found = answers(lost, flight)["What failed?"]
    assert "Check this first" in found
    assert "twice" in found
    assert "1 keyframe is not in the mosaic" in found


def test_doubted_heights_are_among_what_is_not_believed():
    ground = GroundFacts(
        misregistration_px=(0.1, 0.4), over_floor_px=(0.4, 2.0), relief_share=0.5, doubted_share=0.04
    )
    estimate = replace(made_estimate(), messages=(), ground=ground)
    found = answers(estimate, made_flight())["What failed?"].replace("\N{NO-BREAK SPACE}", " ")
    assert found.startswith("No part of the map, and no warning doubts an instrument, but some")
    assert "Heights of 2 %" in found
    assert "No instrument is doubted" not in found


def test_a_keyframe_that_the_mosaic_does_not_show_is_named_with_the_reason():
    estimate = made_estimate()
    name = estimate.frame_names[18]
    told = answers(replace(estimate, not_drawn={name: "it borders a gap"}), made_flight())["What failed?"]
    assert f"1 keyframe is not in the mosaic (keyframe 18, {name}: it borders a gap)" in told


def test_far_ground_that_the_mosaic_lacks_is_told_by_keyframe():
    estimate = made_estimate()
    cut = {name: "40 % of its ground is far away" for name in estimate.frame_names[:7]}
    one = replace(estimate, partly_drawn=dict([*cut.items()][:1]))
    question = "Is any of the ground missing?"
    assert (
        "On purpose, 1 keyframe shows more ground than the mosaic (keyframe 0"
        in (answers(one, made_flight())[question])
    )
    told = answers(replace(estimate, partly_drawn=cut), made_flight())[question]
    assert "On purpose, 7 keyframes show more ground than the mosaic" in told
    assert "and 2 more)" in told
    assert "On purpose" not in answers(estimate, made_flight())[question]
    assert summarise(one).to_json()["partly_drawn"] == one.partly_drawn


def test_pictures_that_show_too_little_are_missing_ground():
    """All keyframes may have a place although a sixth of the pictures shows none."""
    estimate, flight = made_estimate(), made_flight()
    rejected = {
        TOO_FEW: estimate.frames // 6 + 1,
        "loop: too few matches": 7,
        "view of a floor point far off": 3,
    }
    found = answers(replace(estimate, rejected=rejected), flight)
    missing, left_out = (
        found["Is any of the ground missing?"],
        found["What was left out, and do I have to act?"],
    )
    assert missing.startswith(f"Yes: {rejected[TOO_FEW]} of {estimate.frames} pictures")
    assert "with more light" in found["How do I make the next map better?"]
    assert left_out.startswith(
        f"7 matches of places (7 unproven), 3 single views of points of the ground, {rejected[TOO_FEW]} pict"
    )
    assert f"nothing to recognise” ({rejected[TOO_FEW]}): only if you need what lies below" in left_out
    assert "you may have to act on" in left_out
    damaged = answers(replace(estimate, rejected={**rejected, "damaged": 1}), flight)
    assert "act on “Pictures whose file cannot be used" in damaged["What was left out, and do I have to act?"]
    assert set(SHOW_NOTHING) == {TOO_FEW, SAME_PICTURE}
    few = answers(replace(estimate, rejected={"loop: too few matches": 7}), flight)
    assert "no need to act" in few["What was left out, and do I have to act?"]
    assert few["Is any of the ground missing?"].startswith("No")


def test_a_stretch_without_pictures_is_named_with_its_place():
    estimate, flight = made_estimate(), made_flight()
    apart = tuple(edge for edge in estimate.relative_poses if (edge.i, edge.j) != (20, 21))
    found = answers(replace(estimate, relative_poses=apart), flight)["Is any of the ground missing?"]
    (x, y), length_m = (
        estimate.w_T_b[20, :2, 3],
        np.linalg.norm(np.diff(estimate.w_T_b[20:22, :3, 3], axis=0)),
    )
    assert f"({x:.3g}, {y:.3g})" in found
    assert length(length_m) in found
    (gap,) = gaps(replace(estimate, relative_poses=apart), flight)
    assert (gap.i, gap.j) == (20, 21)
    assert gap.shows_nothing
    vague = estimate.covariances.copy()
    vague[20] *= 4
    least = replace(estimate, relative_poses=apart, covariances=vague)
    least_certain = answers(least, flight)["Where is it least certain?"]
    assert "no usable picture lies on one side of it" in least_certain
    mosaic = MosaicFacts(0.004, 800, 600, 0.05, 0.09, 3.0, -1.5, gap_area_m2=1.25)
    told = sentence(gather(replace(estimate, relative_poses=apart), flight), "ok", mosaic)
    missing = (
        f"1 stretch of the path, {length(length_m)} in all, and with it 1.2\N{NO-BREAK SPACE}m² of ground"
    )
    assert missing in told
    hover = next(e for e in estimate.relative_poses if (e.i, e.j) not in {(a.i, a.j) for a in apart})
    assert not gaps(replace(estimate, relative_poses=(*apart, replace(hover, kind="loop"))), flight)
    assert gaps(replace(estimate, relative_poses=(*apart, replace(hover, kind="inertial"))), flight) == (gap,)
    assert not gaps(replace(estimate, relative_poses=apart), None)
    assert not gaps(replace(estimate, relative_poses=apart), replace(flight, all_keyframes=True))
    camera = Camera((100.0, 100.0), (159.5, 119.5), (320, 240))
    (gap,) = gaps(replace(estimate, relative_poses=apart, camera=camera), flight)
    assert not gap.shows_nothing, "1.9 m of ground in a picture, 0.4 m to the next"
    short = answers(replace(estimate, relative_poses=apart, camera=camera), flight)
    assert short["Is any of the ground missing?"].endswith("are shorter than a picture.")


def test_a_hole_in_a_mosaic_is_missing_ground_and_its_edge_is_told():
    question = "Is any of the ground missing?"
    estimate, flight = made_estimate(), made_flight()
    whole = MosaicFacts(0.004, 800, 600, 0.02, 0.04, 3.0, -1.5, covered_share=0.7)

    def told(mosaic):
        rows = pilots_answers(estimate, summarise(estimate), gather(estimate, flight), mosaic)
        return next(row.value for row in rows if row.label == question).replace("\N{NO-BREAK SPACE}", " ")

    assert told(whole).startswith("No: all")
    assert "the mosaic has no hole" in told(whole)
    assert "70 % of the rectangle" in told(whole)
    torn = replace(whole, holes=2, hole_area_m2=0.25, hole_beside_m2=0.25, hole_x_m=1.5, hole_y_m=-2.0)
    assert told(torn).startswith(
        "Yes: the mosaic has 2 holes, 0.25 m² in all, the largest around x = 1.50 m, y"
    )
