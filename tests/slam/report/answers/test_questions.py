"""The questions a pilot asks of a report, answered from the page alone."""

from __future__ import annotations

import html
import re
from dataclasses import replace

import numpy as np

from slam.core.geodesy import GeoOrigin
from slam.core.messages import CHECKED_BY_ONE_DISTANCE
from slam.core.streams import AttitudeSeries
from slam.core.summary import summarise
from slam.core.units import error_length
from slam.report.answers.advice import limit_sentence
from slam.report.answers.checked_lengths import as_html
from slam.report.answers.questions import pilots_answers
from slam.report.facts import gather
from slam.report.mosaic_facts import MosaicFacts
from slam.report.optimize_report import Accuracy, render
from slam.report.tables.evaluation import Evaluated
from tests.slam.made_estimate import made_estimate, made_flight, saying
from tests.slam.report.answers.asked import AGAIN, SHARES, answers

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
    page = re.sub("</?(b|code|details|summary)>|<!--.*?-->", "", page.replace("<br>", " "))
    assert all(question in page and answer in page for question, answer in found.items())
    assert "How far is it from the truth?" in page
    assert told.evaluated.words in page
    assert limit_sentence(SHARES) in page


def test_answers_follow_the_map():
    estimate, flight = made_estimate(), made_flight()
    assert answers(estimate, flight)["Can I use this map?"].startswith("Yes")
    assert answers(saying(estimate, reasons=("two parts",)), flight)["Can I use this map?"].startswith("Only")
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
    both_ends = error_length(np.sqrt(2) * 0.04)
    assert f"known to about ±\N{NO-BREAK SPACE}{both_ends}" in told, "the shift of the ground is not counted"
    assert answers(no_metres, flight)[scale].startswith("Not known")
    unknown = replace(estimate, covariances=np.full_like(estimate.covariances, np.nan))
    assert answers(unknown, flight)["How accurate is a place on it?"].startswith("Not known")


def test_heights_without_an_altitude_are_none_on_earth():
    question = "Are the heights true?"
    estimate, flight = made_estimate(), made_flight()
    on_earth = answers(replace(estimate, origin=GeoOrigin(52.1, 4.3, 10.0)), flight)[question]
    assert "only as the GPS counts them" in on_earth
    assert "altitude of the ground on Earth" in on_earth
    unknown = answers(replace(estimate, origin=GeoOrigin(52.1, 4.3, 0.0, altitude_known=False)), flight)[
        question
    ]
    assert "As altitudes, no, because none is recorded" in unknown
    assert "nothing tells where that lies above the sea" in unknown
    assert "on Earth" not in unknown


def test_the_axes_are_told():
    question = "Which way do x and y point, and where is north?"
    estimate, flight = made_estimate(), made_flight()
    assert "nose pointed" in answers(estimate, flight)[question]
    assert "North is not known" in answers(estimate, flight)[question]
    headed = replace(flight, attitude=AttitudeSeries(np.arange(4.0), np.zeros((4, 3))))
    assert "recorded heading (yaw) is zero" in answers(estimate, headed)[question]
    on_earth = answers(replace(estimate, origin=GeoOrigin(52.1, 4.3, 10.0)), flight)
    assert on_earth[question] == "x points east, y north and z up."


def test_whether_coordinates_can_be_handed_on():
    question = "Can I hand its coordinates to others?"
    estimate, flight = made_estimate(), made_flight()
    assert answers(estimate, flight)[question].startswith("Only together with this map")
    assert answers(replace(estimate, metric=False), flight)[question].startswith("No")
    on_earth = replace(estimate, origin=GeoOrigin(52.1, 4.3, 10.0))
    facts = replace(gather(on_earth, flight), gps_std_m=3.0)
    told = {item.label: item.value for item in pilots_answers(on_earth, summarise(on_earth), facts)}[question]
    assert told.startswith("Yes, if you tell")
    assert error_length(3.0) in told
    controlled = replace(facts, controlled=True)
    told = {item.label: item.value for item in pilots_answers(on_earth, summarise(on_earth), controlled)}
    assert "GPS" not in told[question], "control points hold the map"


def test_an_instrument_that_nothing_checks_is_no_plain_yes():
    estimate, flight = made_estimate(), made_flight()
    alone = replace(estimate, accuracy_basis="Lengths and their accuracy rest on one height sensor alone.")
    assert "no second instrument checks" in answers(alone, flight)["Can I use this map?"]
    assert "no second instrument checks" not in answers(estimate, flight)["Can I use this map?"]


def test_known_distances_that_were_compared_are_not_asked_for():
    estimate, flight = made_estimate(), made_flight()
    alone = replace(estimate, accuracy_basis=f"Lengths rest on one sensor. {CHECKED_BY_ONE_DISTANCE}")
    summary = summarise(alone)

    def shown(checks_lengths):
        told = Accuracy(evaluated=Evaluated("3 mm", checks_lengths=checks_lengths))
        return re.sub("<!--.*?-->", "", html.unescape(render(alone, summary, flight, accuracy=told)))

    assert CHECKED_BY_ONE_DISTANCE in shown(False)
    assert "no second instrument checks its accuracy" in shown(False)
    assert CHECKED_BY_ONE_DISTANCE not in shown(True)
    assert "known distances on the ground have checked the lengths" in shown(True)
    assert "no second instrument checks its accuracy" not in shown(True)


def test_a_graph_has_no_pictures():
    estimate = replace(made_estimate(), rejected={"edge without information": 2})
    page = render(estimate, summarise(estimate, graph_alone=True))
    text = " ".join(f"{name} {value}" for name, value in answers(estimate, None).items())
    assert not re.search(r"picture|keyframe|GPS", text)
    assert "Position of a pose" in page


def test_streams_that_a_message_names_are_explained():
    flight = made_flight()
    estimate = saying(made_estimate(), "attitude0 is tilted by 4.8 degrees")
    page = html.unescape(render(estimate, summarise(estimate), flight))
    assert "attitude0 is the attitude sensor" in page
    assert "imu0 is" not in page


def test_a_status_that_is_not_ok_stands_beside_every_figure():
    flight = made_flight()
    basis = f"Lengths rest on one sensor. {CHECKED_BY_ONE_DISTANCE}"
    estimate = replace(saying(made_estimate(), reasons=("sonar0: stuck; repair it",)), accuracy_basis=basis)
    found = answers(estimate, flight)
    for question in (
        "Can I use this map?", "How accurate is a place on it?", "How far can I trust a distance or an area?",
        "Is the scale right, and by which instrument?", "How do I make the next map better?", "What failed?",
        "Are the heights true?", "Can I hand its coordinates to others?",
    ):  # fmt: skip
        assert "Check this first" in found[question], question


def test_a_line_break_divides_no_option_of_a_command():
    told = as_html("give it by --model; <a--b> is no option")
    assert told == "give it by <code>--model</code>; &lt;a--b&gt; is no option"
