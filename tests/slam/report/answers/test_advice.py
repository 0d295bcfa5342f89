"""What limits the accuracy of a map, and what makes the next one better."""

from __future__ import annotations

from dataclasses import replace

import pytest

from slam.core.lost_pictures import BARE_GROUND
from slam.core.messages import about
from slam.core.summary import summarise
from slam.report.answers.advice import limit, limit_sentence, next_steps
from slam.report.answers.questions import pilots_answers
from slam.report.facts import gather
from slam.report.mosaic_facts import MosaicFacts
from tests.slam.made_estimate import made_estimate, made_flight, saying
from tests.slam.report.answers.asked import SHARES


def test_the_limit_is_the_instrument_with_the_largest_share_of_both_axes():
    assert limit(SHARES) == ("range", pytest.approx(0.6))
    assert "height sensor" in limit_sentence(SHARES)
    assert limit({}) is None
    assert limit_sentence({}) == ""


def test_advice_follows_from_what_limits_and_from_what_is_at_hand():
    question = "How do I make the next map better?"
    estimate, flight = made_estimate(), made_flight()
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
    bare = replace(by_gps, messages=(about(BARE_GROUND, "40 of 200 pictures are left out", "fly higher"),))
    missing = replace(plain, frames=200)
    lost = replace(summarise(bare), rejected={"too few features": 40})
    assert advice(missing, bare, lost).startswith("If you need the ground that is missing, cross it higher")
    assert "First act on" not in advice(missing, bare, lost)
    doubted = saying(by_gps, reasons=("gps0: off",))
    assert advice(plain, doubted, summarise(doubted)).startswith("First do what “Check this first” says")


def test_places_and_lengths_have_limits_of_their_own():
    shares = {
        "x": {"position": 0.9, "pictures": 0.1},
        "scale": {"position": 0.2, "pictures": 0.8},
        "ground": {"position": 0.3, "pictures": 0.7},
    }
    told = limit_sentence(shares)
    assert told.index("the GPS") < told.index("the pictures")
    assert "pictures" not in limit_sentence(shares, metric=False)
    estimate, flight = replace(made_estimate(), information_shares=shares), made_flight()
    facts, summary = gather(estimate, flight), summarise(estimate)

    def advice(mosaic):
        rows = pilots_answers(estimate, summary, facts, mosaic)
        return next(row.value for row in rows if row.label == "How do I make the next map better?")

    assert "control points" in advice(None)
    mosaic = MosaicFacts(0.004, 800, 600, 0.02, 0.04, 3.0, -1.5)
    assert "fly lower" in advice(mosaic), "the ground has a limit of its own"


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
    estimate, flight = saying(made_estimate(), *warnings), made_flight()
    facts, summary = gather(estimate, flight), summarise(estimate)
    assert next_steps(estimate, facts, summary, ground_missing=False).startswith(step)
