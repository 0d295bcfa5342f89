"""The questions a pilot asks of a report, answered from the page alone."""

from __future__ import annotations

import html
import re
from dataclasses import replace

import numpy as np
import pytest

from backend.measurements.rejection import LinkCheck, Rejection
from frontend.camera import Camera
from frontend.keyframes import TOO_FEW
from frontend.views import SAME_PICTURE
from slam.core.flight import AttitudeSeries, GeoOrigin
from slam.core.instrument_errors import AttitudeErrors
from slam.core.lost_pictures import REDUNDANT, SHOW_NOTHING, TRACKING_LOST
from slam.core.messages import CHECKED_BY_ONE_DISTANCE
from slam.core.summary import summarise
from slam.core.units import length, percent
from slam.report.answers.advice import limit, limit_sentence, next_steps
from slam.report.answers.headline import sentence
from slam.report.answers.questions import pilots_answers
from slam.report.facts import gather
from slam.report.gaps import gaps
from slam.report.mosaic_facts import MosaicFacts
from slam.report.optimize_report import Accuracy, render
from slam.report.tables.evaluation import Evaluated
from tests.slam.made_estimate import made_estimate, made_flight
from tests.slam.report.answers.asked import AGAIN, answers

SHARES = {"x": {"range": 0.7, "pictures": 0.3}, "y": {"range": 0.5, "pictures": 0.5}, "scale": {"range": 1.0}}


ASKED = (
    "How accurate is a place on it?",
    "Where is it least certain?",
    "How far can I trust a distance or an area?",
    "Is the scale right, and by which instrument?",
    "What limits the accuracy?",
    "How do I make the next map better?",
    "Is any of the ground missing?",
    "What failed?",
    "What was left out, and do I have to act?",
    "Which way do x and y point, and where is north?",
)


def test_ten_questions_have_their_answers_on_the_page():
    estimate, flight = made_estimate(), made_flight()
    estimate = replace(estimate, information_shares=SHARES)
    found = answers(estimate, flight)
    assert set(ASKED) <= set(found)
    told = Accuracy(evaluated=Evaluated("Typically 3 mm by the truth."))
    page = html.unescape(render(estimate, summarise(estimate), flight, accuracy=told))
    page = re.sub("</?b>|<!--.*?-->", "", page.replace("<br>", " "))
    assert all(question in page and answer in page for question, answer in found.items())
    assert "How far is it from the truth?" in page
    assert told.evaluated.words in page
    assert limit_sentence(SHARES) in page


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
    assert answers(no_loops, flight)[AGAIN].startswith("No")
    on_earth = replace(estimate, origin=GeoOrigin(52.1, 4.3, 10.0))
    assert "52.10000000° N, 4.30000000° E" in answers(on_earth, flight)["Where on Earth is it?"]
    no_metres = replace(estimate, metric=False, scale_std=None)
    distance, scale = ASKED[2:4]
    assert answers(no_metres, flight)[distance].startswith("In metres not at all")
    assert "map.html measures any distance" in answers(estimate, flight)[distance]
    by_gps = replace(on_earth, information_shares={"x": {"position": 0.9, "pictures": 0.1}})
    assert "moves the whole map" in answers(by_gps, flight)[distance]
    mosaic, facts = MosaicFacts(0.004, 800, 600, 0.05, 0.09, 3.0, -1.5), gather(by_gps, flight)
    rows = pilots_answers(replace(by_gps, middle_std_m=0.03), summarise(by_gps), facts, mosaic)
    told = next(row.value for row in rows if row.label == distance)
    both_ends = length(np.sqrt(2) * 0.04)
    assert f"known to about ±\N{NO-BREAK SPACE}{both_ends}" in told, "the shift of the ground is not counted"
    assert answers(no_metres, flight)[scale].startswith("Not known")
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
    assert "You may have to act on" in left_out
    damaged = answers(replace(estimate, rejected={**rejected, "damaged": 1}), flight)
    assert "Act on “Pictures whose file cannot be used" in damaged["What was left out, and do I have to act?"]
    assert set(SHOW_NOTHING) == {TOO_FEW, SAME_PICTURE}
    few = answers(replace(estimate, rejected={"loop: too few matches": 7}), flight)
    assert "No need to act" in few["What was left out, and do I have to act?"]
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


def test_the_axes_are_told():
    question = "Which way do x and y point, and where is north?"
    estimate, flight = made_estimate(), made_flight()
    assert "nose pointed" in answers(estimate, flight)[question]
    assert "north is, is not known" in answers(estimate, flight)[question]
    headed = replace(flight, attitude=AttitudeSeries(np.arange(4.0), np.zeros((4, 3))))
    assert "recorded heading (yaw) is zero" in answers(estimate, headed)[question]
    on_earth = answers(replace(estimate, origin=GeoOrigin(52.1, 4.3, 10.0)), flight)
    assert on_earth[question] == "x points east, y north and z up."


def test_advice_follows_from_what_limits_and_from_what_is_at_hand():
    question = "How do I make the next map better?"
    estimate, flight = replace(made_estimate(), status="ok"), made_flight()
    by_gps = replace(estimate, information_shares={"x": {"position": 0.9, "pictures": 0.1}})
    facts, summary = gather(by_gps, flight), summarise(by_gps)

    def advice(facts, estimate=by_gps, summary=summary):
        rows = pilots_answers(estimate, summary, facts)
        return next(row.value for row in rows if row.label == question)

    plain, corrected = replace(facts, gps_std_m=3.0), replace(facts, gps_std_m=0.01)
    assert "use a GPS with corrections (RTK)" in advice(plain)
    assert "already has corrections" in advice(corrected)
    assert "measure control points" in advice(corrected)
    assert "mark more control points" in advice(replace(corrected, controlled=True))
    by_range = replace(estimate, information_shares=SHARES)
    by_hand = advice(facts, by_range)
    assert "state how sure these are as scale_std and datum_std in sonar0/sensor.yaml" in by_hand
    assert "slam optimize --gcp FILE" in by_hand, "a measured distance can be given"
    assert "slam evaluate" not in by_hand
    assert "slam evaluate OUT --truth FLIGHT" in advice(replace(facts, has_truth=True), by_range)
    exact = advice(replace(facts, range_exact=True), by_range)
    assert "sensor.yaml" not in exact, "what is taken as exact is stated there already"
    bare = replace(by_gps, warnings=("bare ground: 40 of 200 pictures are left out; fly higher",))
    missing = replace(plain, frames=200)
    lost = replace(summarise(bare), rejected={"too few features": 40})
    assert advice(missing, bare, lost).startswith("If you need the ground that is missing, cross it higher")
    assert "First act on" not in advice(missing, bare, lost)
    doubted = replace(by_gps, status="gps0: off")
    assert advice(plain, doubted, summarise(doubted)).startswith("First do what “Check this first” says")


def test_the_gain_of_loop_closures_is_told_where_there_are_any():
    estimate, flight = made_estimate(), made_flight()
    moved = estimate.w_T_b.copy()
    moved[:, 1, 3] += np.linspace(0, 0.4, 60)
    found = answers(replace(estimate, odometry_w_T_b=moved), flight)
    assert (
        f"{length(0.2)} away from here typically, and {length(0.4)} at most"
        in found["What did loop closures change?"]
    )
    none = replace(estimate, odometry_w_T_b=moved, loops=(), relative_poses=())
    assert "What did loop closures change?" not in answers(none, flight)


def test_contradicted_matches_are_counted_apart_from_unproven_ones():
    estimate, flight = made_estimate(), made_flight()
    first, second, third = estimate.loops
    loops = (
        replace(third, rejection=Rejection(LinkCheck.GRAPH, "9 sigma")),
        replace(third, rejection=Rejection(LinkCheck.TOO_FEW_INLIERS)),
        first,
        second,
    )
    found = answers(replace(estimate, loops=loops), flight)[AGAIN]
    assert "2 others were rejected: the rest of the map contradicts 1" in found
    assert "1 shows too little to tell whether it is right" in found
    page = html.unescape(render(replace(estimate, loops=loops), summarise(estimate), flight))
    assert re.search(r"<td>contradicted</td><td>they contradict the other links", page)
    assert re.search(r"<td>unproven</td><td>they have too few points", page)
    assert page.index("<td>contradicted</td>") < page.index("<td>unproven</td>")


def test_what_failed_is_told():
    estimate, flight = replace(made_estimate(), status="ok", warnings=()), made_flight()
    purpose, none = "What was left out (below) was left out on purpose.", "No instrument is doubted."
    assert answers(estimate, flight)["What failed?"] == f"Nothing. {none} {purpose}"
    assert answers(replace(estimate, rejected={}), flight)["What failed?"] == f"Nothing. {none}"
    noted = replace(estimate, warnings=("attitude0 is tilted by 4.8 degrees",))
    found = answers(noted, flight)["What failed?"]
    assert found.startswith("No part of the map, but a warning below doubts an instrument.")
    assert "The attitude sensor (roll, pitch and heading) is tilted by 4.8 degrees." in found
    off = AttitudeErrors((0.08, 0.06), (0.01, 0.01), 0.1, 0.1, None)
    known = replace(noted, instruments=replace(estimate.instruments, attitude=off))
    told = answers(known, flight)["What failed?"]
    assert "Its roll and pitch differ from the map by 5.7° on average, and were trusted no better" in told
    bare = replace(estimate, frames=100, rejected={SHOW_NOTHING[1]: 60})
    assert answers(bare, flight)["What failed?"].startswith(
        "60 of 100 pictures showed too little to be used."
    )
    other = replace(estimate, warnings=("one picture is damaged",))
    told = answers(other, flight)["What failed?"]
    assert told == f"Nothing; the warnings name what to check. {none} {purpose}"
    question = "How accurate is a place on it?"
    assert "does not count" not in answers(noted, flight)[question]
    assert (
        "does not count what “Check this first” above"
        in answers(replace(noted, status="x"), flight)[question]
    )
    lost = replace(
        estimate,
        status="two parts",
        rejected={TRACKING_LOST: 2},
        not_drawn={"a.png": "why", "b.png": REDUNDANT},
    )
    found = answers(lost, flight)["What failed?"]
    assert "Check this first" in found
    assert "twice" in found
    assert "1 keyframe is not in the mosaic" in found


def test_an_instrument_that_nothing_checks_is_no_plain_yes():
    estimate, flight = replace(made_estimate(), status="ok"), made_flight()
    alone = replace(estimate, accuracy_basis="Lengths and their accuracy rest on one height sensor alone.")
    assert "no second instrument checks" in answers(alone, flight)["Can I use this map?"]
    assert "no second instrument checks" not in answers(estimate, flight)["Can I use this map?"]


def test_whole_percents_have_no_exponent():
    assert [percent(x).replace("\N{NO-BREAK SPACE}", " ") for x in (0.999, 0.996, 0.0312, 1.0, 0.00063)] == [
        "100 %", "100 %", "3.1 %", "100 %", "0.063 %",
    ]  # fmt: skip


def test_a_graph_has_no_pictures():
    estimate = replace(made_estimate(), rejected={"edge without information": 2})
    page = render(estimate, summarise(estimate, graph_alone=True))
    text = " ".join(f"{name} {value}" for name, value in answers(estimate, None).items())
    assert not re.search(r"picture|keyframe|GPS", text)
    assert "Position of a pose" in page


def test_streams_that_a_message_names_are_explained():
    flight = made_flight()
    estimate = replace(made_estimate(), warnings=("attitude0 is tilted by 4.8 degrees",))
    page = html.unescape(render(estimate, summarise(estimate), flight))
    assert "attitude0 is the attitude sensor" in page
    assert "imu0 is" not in page


def test_places_and_lengths_have_limits_of_their_own():
    shares = {
        "x": {"position": 0.9, "pictures": 0.1},
        "scale": {"position": 0.2, "pictures": 0.8},
        "ground": {"position": 0.3, "pictures": 0.7},
    }
    told = limit_sentence(shares)
    assert told.index("the GPS") < told.index("the pictures")
    assert "pictures" not in limit_sentence(shares, metric=False)
    estimate, flight = replace(made_estimate(), status="ok", information_shares=shares), made_flight()
    facts, summary = gather(estimate, flight), summarise(estimate)

    def advice(mosaic):
        rows = pilots_answers(estimate, summary, facts, mosaic)
        return next(row.value for row in rows if row.label == "How do I make the next map better?")

    assert "control points" in advice(None)
    mosaic = MosaicFacts(0.004, 800, 600, 0.02, 0.04, 3.0, -1.5)
    assert "fly lower" in advice(mosaic), "the ground has a limit of its own"


def test_whether_coordinates_can_be_handed_on():
    question = "Can I hand its coordinates to others?"
    estimate, flight = made_estimate(), made_flight()
    assert answers(estimate, flight)[question].startswith("Only together with this map")
    assert answers(replace(estimate, metric=False), flight)[question].startswith("No")
    on_earth = replace(estimate, origin=GeoOrigin(52.1, 4.3, 10.0))
    facts = replace(gather(on_earth, flight), gps_std_m=3.0)
    told = {item.label: item.value for item in pilots_answers(on_earth, summarise(on_earth), facts)}[question]
    assert told.startswith("Yes, if you tell")
    assert length(3.0) in told
    controlled = replace(facts, controlled=True)
    told = {item.label: item.value for item in pilots_answers(on_earth, summarise(on_earth), controlled)}
    assert "GPS" not in told[question], "control points hold the map"


def test_white_ground_inside_of_a_mosaic_is_missing_and_its_edge_is_told():
    question = "Is any of the ground missing?"
    estimate, flight = replace(made_estimate(), status="ok"), made_flight()
    whole = MosaicFacts(0.004, 800, 600, 0.02, 0.04, 3.0, -1.5, covered_share=0.7)

    def told(mosaic):
        rows = pilots_answers(estimate, summarise(estimate), gather(estimate, flight), mosaic)
        return next(row.value for row in rows if row.label == question).replace("\N{NO-BREAK SPACE}", " ")

    assert told(whole).startswith("No: all")
    assert "the mosaic has no hole" in told(whole)
    assert "70 % of the rectangle" in told(whole)
    torn = replace(whole, holes=2, hole_area_m2=0.25, hole_x_m=1.5, hole_y_m=-2.0)
    assert told(torn).startswith(
        "Yes: the mosaic has 2 holes, 0.25 m² in all, the largest around x = 1.50 m, y"
    )


def test_known_distances_that_were_compared_are_not_asked_for():
    estimate, flight = replace(made_estimate(), status="ok"), made_flight()
    alone = replace(estimate, accuracy_basis=f"Lengths rest on one sensor. {CHECKED_BY_ONE_DISTANCE}")
    summary = summarise(alone)

    def shown(checks_lengths):
        told = Accuracy(evaluated=Evaluated("3 mm", checks_lengths=checks_lengths))
        return re.sub("<!--.*?-->", "", html.unescape(render(alone, summary, flight, accuracy=told)))

    assert CHECKED_BY_ONE_DISTANCE in shown(False)
    assert "no second instrument checks its accuracy" in shown(False)
    assert CHECKED_BY_ONE_DISTANCE not in shown(True)
    assert "Known distances on the ground have checked the lengths" in shown(True)
    assert "no second instrument checks its accuracy" not in shown(True)


def test_a_status_that_is_not_ok_stands_beside_every_figure():
    flight = made_flight()
    basis = f"Lengths rest on one sensor. {CHECKED_BY_ONE_DISTANCE}"
    estimate = replace(made_estimate(), status="sonar0: stuck; repair it", accuracy_basis=basis)
    found = answers(estimate, flight)
    for question in (
        "Can I use this map?", "How accurate is a place on it?", "How far can I trust a distance or an area?",
        "Is the scale right, and by which instrument?", "How do I make the next map better?", "What failed?",
        "Are the heights true?", "Can I hand its coordinates to others?",
    ):  # fmt: skip
        assert "Check this first" in found[question], question


@pytest.mark.parametrize(
    ("warnings", "step"),
    [
        (
            ("imu0 reads (at rest; 9.9 m/s²) too much; calibrate its gain",),
            "First act on the warning below: calibrate its gain.",
        ),
        (("one picture is damaged",), "First act on the warning below."),
        (("one picture is damaged", "another is"), "First act on the 2 warnings below."),
    ],
)
def test_the_first_step_is_what_the_only_warning_advises(warnings, step):
    estimate, flight = replace(made_estimate(), status="ok", warnings=warnings), made_flight()
    facts, summary = gather(estimate, flight), summarise(estimate)
    assert next_steps(estimate, facts, summary, ground_missing=False).startswith(step)


def test_a_keyframe_that_the_mosaic_does_not_show_is_named_with_the_reason():
    estimate = made_estimate()
    name = estimate.frame_names[18]
    told = answers(replace(estimate, not_drawn={name: "it borders a gap"}), made_flight())["What failed?"]
    assert f"1 keyframe is not in the mosaic (keyframe 18, {name}: it borders a gap)" in told
